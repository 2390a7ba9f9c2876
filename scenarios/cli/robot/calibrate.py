"""Calibration of the sensor's mount by poses that a person brings the arm into."""

from __future__ import annotations

import sys
from contextlib import ExitStack
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from scenarios.cli.robot.sensor import reading
from testbed.errors import HeftError
from testbed.robot.calibration.file import save_calibration
from testbed.robot.calibration.static_poses import (
    CalibrationError,
    StaticPose,
    calibrate,
    in_words,
    static_pose,
)
from testbed.robot.config import load_robot_file, sensor_port
from testbed.robot.interfaces import Arm, RobotError, WrenchSensor
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.validation import check_positive

_LEAST = 6
_STILL = 0.01, np.radians(0.3)
"""Joint speed, rad/s, and turn while measuring, rad, at which the hand stands."""


def calibrate_sensor(config: Path, seconds: float) -> None:
    """Take poses until a person has had enough, then say and save what they mean.

    Raises:
        InvalidValueError: a time that is not above 0.
        RobotError: sensor or arm cannot be reached, or the poses do not settle it.
    """
    check_positive("--seconds", seconds)
    file = load_robot_file(config)
    where = config.parent / file.sensor.calibration
    with ExitStack() as stack:
        sensor = stack.enter_context(Ft300s(sensor_port(file)))
        arm = stack.enter_context(KortexArm(file.kortex()))
        print("Bring the arm into a pose by its joystick, wait until it stands, press Enter; q and Enter when done.")
        poses = _poses(arm, sensor, seconds)
        found = calibrate(poses)
        for sentence in in_words(found):
            print(sentence)
        save_calibration(where, found, sensor.identity.serial, f"{datetime.now(UTC):%Y-%m-%d}")
    print(where)


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
    before = arm.state()
    if np.abs(before.joint_velocity).max() > _STILL[0]:
        raise RobotError("the arm still moves: wait, and press Enter again")
    samples = reading(sensor, seconds)
    hands = [Rotation.from_quat(s.tcp_pose.orientation, scalar_first=True) for s in (before, arm.state())]
    if (hands[0].inv() * hands[1]).magnitude() > _STILL[1]:
        raise RobotError("the arm moved while it was measured: press Enter again")
    return static_pose(before.tcp_pose.orientation, samples)


def _so_far(poses: list[StaticPose]) -> str:
    try:
        found = calibrate(poses)
    except CalibrationError as error:
        return str(error)
    turn = np.degrees(found.sensor_in_hand_std.max())
    tool = f"tool {found.mass:.3f} +- {found.mass_std:.2g} kg"
    return f"enough: rotation to {turn:.2g} deg, {tool}, misfit {found.misfit:.1f}"
