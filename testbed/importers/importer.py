"""A log and its mapping made into a trajectory: resampled, compensated, its drift judged."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from testbed.actions.base import Accelerate, Rotate, Slide
from testbed.errors import InvalidValueError
from testbed.frames import perpendicular, pose_from_point, rotation_2d
from testbed.importers.logs import Log, LogError, Series, all_of, open_log
from testbed.importers.mapping import HandMap, JointMap, Mapping, TimeMap, VelocityMap, factor
from testbed.importers.phases import (
    RATE,
    Phases,
    common_base,
    found_phases,
    given_phases,
    resampled,
    resampled_rotation,
)
from testbed.objects.files import load_object, load_toml
from testbed.objects.model import Grasp, ObjectModel
from testbed.sensing.drift import DriftLimit, judge_drift
from testbed.sensing.presets import compensate
from testbed.trajectory import Tool, Trajectory

_SLOPE_WINDOW = 0.15
"""Time over which a logged pose is differentiated, s."""
_SINCE_1970 = 1e9, 4e9
"""Clocks between these count seconds since 1970: from 2001 to 2096."""


def import_trajectory(log: Path, mapping: Path, limit: DriftLimit | None = None) -> Trajectory:
    """Read a log of another bench as a trajectory.

    Args:
        log: a .csv or .mcap file.
        mapping: a TOML file that says what its columns are; see docs/formats.md.
        limit: drift beyond which it is no data, where it ends with a second tare.

    Raises:
        InvalidFileError: the mapping does not fit its schema; a line for each error.
        InvalidValueError: a column, topic, object or grasp that is not there; the message names the nearest.
        LogError: numbers or times that are none, gaps, or phases that cannot be told; or several errors, a line each.
    """
    asked = load_toml(mapping, Mapping).of(log, mapping.parent)
    source = open_log(log, asked.separator)
    (action, model), wrench, pose, joints, velocity = all_of(
        lambda: _held(asked, mapping),
        lambda: _wrench(source, asked),
        lambda: _pose(source, asked),
        lambda: _joints(source, asked.joints, asked.time) if asked.joints else None,
        lambda: _velocity(source, asked.velocity, asked.time) if asked.velocity else None,
    )
    base = common_base([s for s in (wrench, pose[0], joints, velocity) if s is not None], asked.longest_gap_s)
    time, count = np.arange(len(base)) / RATE, len(base)
    hand = resampled_rotation(pose[0].time_s, pose[1], base)
    position = resampled(pose[0], base) + hand.apply(asked.hand.tcp_in_hand_m)
    twist = resampled(velocity, base) if velocity else _differentiated(position, hand)
    position[:, 2] -= asked.hand.table_height_m
    phase, segment = _phases(asked, time, position[:, 2], twist)
    grasp = model.shape.grasps[action.grasp]
    yaw = _closing_yaw(hand, asked.hand) - grasp.angle
    sensor = hand * Rotation.from_quat(asked.sensor.in_hand_wxyz, scalar_first=True)
    tool = asked.tool
    trajectory = Trajectory(
        action=action,
        status="ok",
        reason="",
        time_s=time,
        phase=phase,
        segment=segment,
        object_pose=pose_from_point(position[:, :2], grasp.position, yaw),
        object_velocity=_object_velocity(twist, yaw, grasp),
        tcp_position=position,
        tcp_velocity=twist,
        sensor_orientation=sensor.as_quat(scalar_first=True),
        sensor_wrench=asked.sensor.sign * resampled(wrench, base),
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=np.zeros((count, 7)) if joints is None else resampled(joints, base),
        tool=Tool(tool.mass_kg, np.array(tool.com_m), np.array(tool.inertia_kg_m2), np.array(tool.tcp_m)),
        sensor_bias_std=np.repeat([asked.sensor.bias_std_N, asked.sensor.bias_std_Nm], 3),
        sensor_drift_std=np.repeat([asked.sensor.drift_std_N, asked.sensor.drift_std_Nm], 3),
        provenance={
            "runner": "import",
            "object": model.name,
            "log": log.name,
            **({"recorded": _moment(base[0])} if _SINCE_1970[0] < base[0] < _SINCE_1970[1] else {}),
            "joints": "as logged" if joints else "not logged: zeros",
            "velocity": "as logged" if velocity else "from the pose",
            "phases": "as mapped" if asked.phases else "from the motion",
        },
    )
    return judge_drift(compensate(trajectory), limit or DriftLimit())


def object_of(asked: Mapping, mapping: Path) -> ObjectModel:
    """The object that a mapping file names: a file beside it first, as in a scenario.

    Raises:
        HeftError: there is none, or its file does not fit; the message names both files.
    """
    beside = mapping.parent / asked.object
    try:
        return load_object(beside if asked.object.endswith(".toml") and beside.is_file() else asked.object)
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=error.file or mapping) from None


def _held(asked: Mapping, mapping: Path) -> tuple[Rotate | Accelerate | Slide, ObjectModel]:
    """What was done with which object."""
    action, model = asked.done(), object_of(asked, mapping)
    if action.grasp >= len(model.shape.grasps):
        names = ", ".join(f"{i} ({g.name})" for i, g in enumerate(model.shape.grasps))
        raise InvalidValueError("action.grasp", action.grasp, names or "none: nothing is grippable", file=mapping)
    return action, model


def _moment(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")


def _wrench(log: Log, asked: Mapping) -> Series:
    """N and N m, (N, 6)."""
    sensor = asked.sensor
    time, values = log.series("sensor.force, sensor.torque", [*sensor.force, *sensor.torque], sensor.topic, asked.time)
    units = np.repeat([factor("force", sensor.force_unit), factor("torque", sensor.torque_unit)], 3)
    return Series(time, values * units)


def _pose(log: Log, asked: Mapping) -> tuple[Series, Rotation]:
    """Position of the hand, m, and its orientation, in the base frame."""
    hand = asked.hand
    time, values = log.series(
        "hand.position, hand.orientation", [*hand.position, *hand.orientation], hand.topic, asked.time
    )
    position, given = values[:, :3] * factor("length", hand.position_unit), values[:, 3:]
    if hand.orientation_as in ("wxyz", "xyzw"):
        lengths = np.linalg.norm(given, axis=1)
        worst = int(np.argmax(np.abs(lengths - 1)))
        if abs(lengths[worst] - 1) > 0.01:
            raise LogError(f"hand.orientation: length {lengths[worst]:g} at sample {worst}; allowed: unit quaternions")
        rotation = Rotation.from_quat(given, scalar_first=hand.orientation_as == "wxyz")
    elif hand.orientation_as == "rotation_vector":
        rotation = Rotation.from_rotvec(given * factor("angle", hand.angle_unit))
    else:
        rotation = Rotation.from_euler("xyz", given * factor("angle", hand.angle_unit))
    return Series(time, position), rotation


def _joints(log: Log, joints: JointMap, time: TimeMap) -> Series:
    """Joint angles, rad, (N, 7)."""
    stamps, values = log.series("joints.position", joints.position, joints.topic, time)
    return Series(stamps, values * factor("angle", joints.unit))


def _velocity(log: Log, velocity: VelocityMap, time: TimeMap) -> Series:
    """Velocity of the TCP, m/s and rad/s, base axes, (N, 6)."""
    names = [*velocity.linear, *velocity.angular]
    stamps, values = log.series("velocity.linear, velocity.angular", names, velocity.topic, time)
    units = [factor("speed", velocity.linear_unit), factor("turn rate", velocity.angular_unit)]
    return Series(stamps, values * np.repeat(units, 3))


def _differentiated(position: np.ndarray, hand: Rotation) -> np.ndarray:
    """Velocity of the TCP from its pose, m/s and rad/s, base axes, (T, 6)."""
    window = round(_SLOPE_WINDOW * RATE) | 1
    linear = savgol_filter(position, window, 2, deriv=1, delta=1 / RATE, axis=0)
    steps = (hand[1:] * hand[:-1].inv()).as_rotvec() * RATE  # mean turn rate between two samples
    rate = np.vstack([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
    return np.hstack([np.asarray(linear), np.asarray(savgol_filter(rate, window, 2, axis=0))])


def _closing_yaw(hand: Rotation, asked: HandMap) -> np.ndarray:
    """Yaw of the direction in which the pads close, rad, without jumps."""
    angle = np.radians(asked.closing_deg)
    along = hand.apply([np.cos(angle), np.sin(angle), 0.0])
    return np.unwrap(np.arctan2(along[:, 1], along[:, 0]))


def _object_velocity(twist: np.ndarray, yaw: np.ndarray, grasp: Grasp) -> np.ndarray:
    lever = np.einsum("nij,j->ni", rotation_2d(yaw), -grasp.position)
    return np.column_stack([twist[:, :2] + twist[:, 5:] * perpendicular(lever), twist[:, 5]])


def _phases(asked: Mapping, time: np.ndarray, height: np.ndarray, twist: np.ndarray) -> Phases:
    if asked.phases:
        return given_phases(asked.phases, time)
    return found_phases(asked.done(), height, twist)
