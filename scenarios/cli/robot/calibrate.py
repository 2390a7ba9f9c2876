"""`heft robot calibrate` and `hand-eye`: the sensor by static poses, and a tracker by touched points."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from testbed.errors import HeftError, InvalidValueError

if TYPE_CHECKING:
    from testbed.robot.calibration.static_poses import StaticPose
    from testbed.robot.interfaces import Arm, WrenchSensor

_LEAST = 6
MOST_RESIDUAL = 0.05
"""Residual of touched points beyond which they are not the seen ones [m]."""
_STILL_SPEED, _STILL_DEG = 0.01, 0.3
"""Joint speed [rad/s], and turn while measuring [deg], of a hand at rest."""
COLUMNS = ("seen_x", "seen_y", "seen_z", "touched_x", "touched_y", "touched_z")
"""Columns of the points of `hand_eye`."""


def calibrate(
    *,
    config: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("robot.toml"),
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 3.0,
) -> None:
    """Estimate the sensor's rotation and sign, and the tool's mass. Moves nothing: you move the arm by its joystick.

    Move the arm to six or more poses, tilted by at least 30 degrees about two axes and in both directions, one of them
    upside down or level; wait at each until the arm stands still, and press Enter. From the sixth pose on, the errors
    of the result are shown. It is written to calibration.toml beside the robot file and holds for this sensor and tool.

    Args:
        config: robot file; names the file to write ([sensor] calibration).
        seconds: duration of the measurement in each pose.
    """
    from testbed.robot.calibration.file import save_calibration
    from testbed.robot.calibration.static_poses import calibrate as fit
    from testbed.robot.calibration.static_poses import sentences
    from testbed.robot.registry import build_arm, build_sensor, load_robot_file
    from testbed.validation import check_positive

    check_positive("--seconds", seconds)
    file = load_robot_file(config)
    path = config.parent / file.sensor.calibration
    with ExitStack() as stack:
        sensor = stack.enter_context(build_sensor(file))
        arm = stack.enter_context(build_arm(file))
        print("Bring the arm into a pose by its joystick, wait until it stands, press Enter; q and Enter when done.")
        found = fit(_poses(arm, sensor, seconds))
        for sentence in sentences(found):
            print(sentence)
        save_calibration(path, found, sensor.identity.serial, f"{datetime.now(UTC):%Y-%m-%d}")
    print(path)


def _poses(arm: Arm, sensor: WrenchSensor, seconds: float) -> list[StaticPose]:
    poses: list[StaticPose] = []
    while True:
        print(f"{len(poses)} poses > ", end="", flush=True)
        answer = sys.stdin.readline()
        if not answer or answer.strip() == "q":
            return poses
        try:
            poses.append(_pose(arm, sensor, seconds))
        except HeftError as error:  # a pose that failed can be tried again
            print(error)
            continue
        tilt = np.degrees(np.arccos(np.clip(-poses[-1].up[2], -1, 1)))
        print(f"tool {tilt:.0f} deg from straight down")
        if len(poses) >= _LEAST:
            print(_so_far(poses))


def _pose(arm: Arm, sensor: WrenchSensor, seconds: float) -> StaticPose:
    from scipy.spatial.transform import Rotation

    from scenarios.cli.robot.sensor import reading
    from testbed.robot.calibration.static_poses import static_pose
    from testbed.robot.interfaces import RobotError

    before = arm.state()
    if np.abs(before.joint_velocity).max() > _STILL_SPEED:
        raise RobotError("the arm still moves: wait, and press Enter again")
    samples = reading(sensor, seconds)
    hands = [Rotation.from_quat(s.tcp_pose.orientation, scalar_first=True) for s in (before, arm.state())]
    if (hands[0].inv() * hands[1]).magnitude() > np.radians(_STILL_DEG):
        raise RobotError("the arm moved while it was measured: press Enter again")
    return static_pose(before.tcp_pose.orientation, samples)


def _so_far(poses: list[StaticPose]) -> str:
    from testbed.robot.calibration.static_poses import CalibrationError
    from testbed.robot.calibration.static_poses import calibrate as fit

    try:
        found = fit(poses)
    except CalibrationError as error:
        return str(error)
    turn = np.degrees(found.sensor_in_hand_std.max())
    tool = f"tool {found.mass:.3f} +- {found.mass_std:.2g} kg"
    return f"enough: rotation to {turn:.2g} deg, {tool}, misfit {found.misfit:.1f}"


def hand_eye(
    points: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="POINTS.csv")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("hand_eye.toml"),
) -> None:
    """Estimate a tracker's pose in the arm's base frame from points touched by the tool and seen by the tracker.

    POINTS.csv has one row per point, in meters: seen_x, seen_y, seen_z in the tracker's frame and touched_x, touched_y,
    touched_z of the tool center point in the arm's base frame; at least 4 points, not on one line. Moves nothing.
    Exit code: 1 if the points do not fit each other.

    Example: heft robot hand-eye points.csv --out hand_eye.toml

    Args:
        points: CSV file.
        out: TOML file to write; testbed.robot.calibration.load_hand_eye reads it.
    """
    import pandas as pd
    from scipy.spatial.transform import Rotation

    from testbed.robot.calibration.file import save_hand_eye
    from testbed.robot.calibration.hand_eye import align

    if not points.is_file():
        raise InvalidValueError("POINTS.csv", str(points), "a path to an existing .csv file")
    try:
        table = pd.read_csv(points, skipinitialspace=True)
    except ValueError as error:  # empty, ragged, or of another coding
        allowed = f"a table of numbers in UTF-8 ({str(error).strip()})"
        raise InvalidValueError("POINTS.csv", str(points), allowed) from None
    if missing := [name for name in COLUMNS if name not in table]:
        raise InvalidValueError("columns", list(table), f"{', '.join(missing)} as well", file=points)
    seen, touched = (table[list(part)].to_numpy() for part in (COLUMNS[:3], COLUMNS[3:]))
    found = align(seen, touched)
    pose = found.tracker_in_base
    x, y, z = pose.position
    turn = Rotation.from_quat(pose.orientation, scalar_first=True).as_rotvec(degrees=True)
    about = ", ".join(f"{angle:.2f}" for angle in turn)
    print(f"tracker at ({x:.4f}, {y:.4f}, {z:.4f}) m, turned by ({about}) deg, base frame of the arm")
    off = np.linalg.norm(touched - found.to_base(seen), axis=1)
    print("residuals, mm: " + ", ".join(f"{1e3 * value:.2f}" for value in off))
    print(f"residual {1e3 * found.residual:.2f} mm; positions near the points to {1e3 * found.standard_error:.2f} mm")
    if found.residual > MOST_RESIDUAL:
        allowed = f"{1e3 * MOST_RESIDUAL:g} mm; are both frames in meters, and does each row have one point?"
        print(f"no file is written: a residual of {1e3 * found.residual:.3g} mm; allowed: {allowed}")
        sys.exit(1)
    save_hand_eye(out, found, f"{datetime.now(UTC):%Y-%m-%d}")
    print(out)
