"""Import of a log by its mapping: a trajectory, resampled, compensated, its drift judged."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from testbed.actions.base import TableAction
from testbed.errors import InvalidValueError
from testbed.frames import origin_velocity, pose_from_point
from testbed.importers.clocks import NO_DELAY, Delay, wrench_delay
from testbed.importers.logs import Series, read_all
from testbed.importers.mapping import Columns, HandMap, JointMap, Mapping, SensorMap, TimeMap, VelocityMap, factor
from testbed.importers.messages import open_bag, open_mcap
from testbed.importers.phases import (
    RATE,
    Phases,
    check_sensor_alive,
    common_base,
    phases_from_motion,
    phases_from_windows,
    resampled,
    resampled_rotation,
)
from testbed.importers.poses import Log, Pose, hand_pose
from testbed.importers.tables import CsvLog
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.robot.calibration.file import load_calibration
from testbed.sensing.compensation import compensate
from testbed.sensing.drift import DriftLimit, judge_drift
from testbed.toml import load_toml
from testbed.trajectory import Tool, Trajectory

_SLOPE_WINDOW = 0.15
"""Time over which a logged pose is differentiated [s]."""
_TABLES = (".csv", ".tsv", ".txt")
_BAGS = (".db3", ".mcap")
_WRENCHES = {"geometry_msgs/WrenchStamped": "wrench.", "geometry_msgs/Wrench": ""}
"""Beginning of the fields of the messages that hold a wrench."""
_SINCE_1970 = 1e9, 4e9
"""Times between these count from 1970: the years 2001 to 2096 [s]."""


def import_trajectory(
    log: Path, mapping: Path, limit: DriftLimit | None = None, delay: Delay | None = None
) -> Trajectory:
    """Read a log of another robot as a trajectory.

    Args:
        log: a table, an .mcap file, or a ROS 2 bag: its folder or a .db3 file.
        mapping: a TOML file that describes its columns; see docs/formats.md.
        limit: largest drift of a valid trial, if the log ends with a second tare.
        delay: delay of a separate stream of wrenches; None takes the mapping's, or that of an accelerated turn.

    Raises:
        InvalidFileError: the mapping does not fit its schema; one line per error.
        InvalidValueError: an unknown column, topic, object or grasp; the message names the nearest.
        LogError: invalid numbers or times, gaps, or phases that cannot be found; or several errors, one line each.
    """
    table, gain = _calibrated(load_toml(mapping, Mapping).for_log(log, mapping.parent), mapping)
    streams = _Streams.of(log, table, mapping)
    action, model = streams.action, streams.model
    delay = streams.delay(table) if delay is None or not table.separate else delay
    if delay is not None and delay.sure:
        streams = streams.earlier(delay.seconds)
    wrench, velocity, joints = streams.wrench, streams.velocity, streams.joints
    base = streams.base(table.longest_gap_s)
    time, count, begin = np.arange(len(base)) / RATE, len(base), streams.epoch_s + float(base[0])
    position, hand = streams.tcp(table, base)
    twist = resampled(velocity, base) if velocity else _differentiated(position, hand)
    position[:, 2] -= table.hand.table_height_m
    phase, segment = _phases(table, action, time, position[:, 2], twist)
    check_sensor_alive(wrench, base[0] + time[np.flatnonzero(segment >= 0)[[0, -1]]])
    grasp = model.shape.grasps[action.grasp]
    yaw = _closing_yaw(hand, table.hand) - grasp.angle
    sensor = hand * Rotation.from_quat(table.sensor.in_hand_wxyz, scalar_first=True)
    tool = table.tool
    trajectory = Trajectory(
        action=action,
        status="ok",
        reason="",
        time_s=time,
        phase=phase,
        segment=segment,
        object_pose=pose_from_point(position[:, :2], grasp.position, yaw),
        object_velocity=origin_velocity(twist, yaw, grasp.position),
        tcp_position=position,
        tcp_velocity=twist,
        sensor_orientation=sensor.as_quat(scalar_first=True),
        sensor_wrench=table.sensor.sign * resampled(wrench, base) / gain,
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=np.zeros((count, 7)) if joints is None else resampled(joints, base),
        tool=Tool(tool.mass_kg, np.array(tool.com_m), np.array(tool.inertia_kg_m2), np.array(tool.tcp_m)),
        sensor_bias_std=np.repeat([table.sensor.bias_std_N, table.sensor.bias_std_Nm], 3),
        sensor_drift_std=np.repeat([table.sensor.drift_std_N, table.sensor.drift_std_Nm], 3),
        setup=table.setup,
        provenance={
            "runner": "import",
            "object": model.name,
            "log": log.name,
            **({"sensor log": table.sensor.file} if table.sensor.file else {}),
            **({"recorded": _moment(begin)} if _SINCE_1970[0] < begin < _SINCE_1970[1] else {}),
            "joints": "as logged" if joints else "not logged: zeros",
            "velocity": "as logged" if velocity else "from the pose",
            "phases": "as mapped" if table.phases else "from the motion",
            **({"delay": str(delay or NO_DELAY)} if table.separate or delay else {}),
        },
        figures={"wrench_delay_s": delay.seconds, "wrench_delay_std_s": delay.std} if delay else {},
    )
    return judge_drift(compensate(trajectory), limit or DriftLimit())


def delay_of(log: Path, mapping: Path) -> Delay | None:
    """Delay of a log's wrenches, if it is an accelerated turn of separate streams and the mapping gives none.

    Raises:
        HeftError: see `import_trajectory`.
    """
    table, _ = _calibrated(load_toml(mapping, Mapping).for_log(log, mapping.parent), mapping)
    known = table.sensor.delay_s is not None or table.action is None  # without an action it is refused later
    if known or not table.separate or not table.recorded_action().action.accelerated:
        return None
    return _Streams.of(log, table, mapping).delay(table)


def _calibrated(table: Mapping, mapping: Path) -> tuple[Mapping, np.ndarray]:
    """The mapping with sign, mount and tool of the calibration that it names, and the gains of the axes."""
    if table.sensor.calibration is None:
        return table, np.ones(6)
    found = load_calibration(mapping.parent / table.sensor.calibration)
    sensor = {"sign": found.sign, "in_hand_wxyz": found.sensor_in_hand.tolist()}
    tool = {"mass_kg": found.mass, "com_m": found.com.tolist()}
    changes = {"sensor": table.sensor.model_copy(update=sensor), "tool": table.tool.model_copy(update=tool)}
    return table.model_copy(update=changes), found.gain


def open_log(path: Path, table: Columns) -> Log:
    """Open a log by its suffix; a folder is a bag.

    Raises:
        InvalidValueError: a suffix that is none of a log's, or no such file.
        LogError: a file that cannot be read.
    """
    if path.is_dir():
        return open_bag(path)
    if not path.is_file():
        raise InvalidValueError("log", str(path), f"an existing file ({', '.join(_TABLES + _BAGS)}) or bag folder")
    if path.suffix in _TABLES:
        return CsvLog(path, table)
    if path.suffix in _BAGS:
        return open_mcap(path) if path.suffix == ".mcap" else open_bag(path)
    raise InvalidValueError("log", str(path), f"a file that ends in {', '.join(_TABLES + _BAGS)}, or a bag folder")


def sensor_log(log: Log, table: Columns, folder: Path) -> Log:
    """Log of the wrenches: the one that the mapping in a folder names, or the same."""
    return log if table.sensor.file is None else open_log(folder / table.sensor.file, table)


def object_of(table: Mapping, mapping: Path) -> ObjectModel:
    """Object of a mapping file, by a file beside it or by name, as in a scenario.

    Raises:
        HeftError: no such object, or its file does not fit; the message names both files.
    """
    beside = mapping.parent / table.object
    try:
        named = beside if table.object.endswith(".toml") and beside.is_file() else table.object
        return load_object(named, measured=True)
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=error.file or mapping) from None


@dataclass(frozen=True, eq=False)
class _Streams:
    """What a log holds, each by its own stamps from one epoch."""

    action: TableAction
    model: ObjectModel
    wrench: Series
    pose: Pose
    joints: Series | None
    velocity: Series | None
    epoch_s: int

    @classmethod
    def of(cls, log: Path, table: Mapping, mapping: Path) -> _Streams:
        """All streams of a log; all their errors at once."""
        source = open_log(log, table)
        other = sensor_log(source, table, mapping.parent)
        (action, model), wrench, pose, joints, velocity = read_all(
            lambda: _action_and_object(table, mapping),
            lambda: read_wrench(other, table.sensor, table.time),
            lambda: hand_pose(source, table.hand, table.time, mapping.parent),
            lambda: _joints(source, table.joints, table.time) if table.joints else None,
            lambda: _velocity(source, table.velocity, table.time) if table.velocity else None,
        )
        wrench = wrench._replace(time_s=wrench.time_s + (other.epoch_s - source.epoch_s))
        wrench = in_sensor_axes(wrench, pose, table.sensor)
        return cls(action, model, wrench, pose, joints, velocity, source.epoch_s)

    def base(self, longest_gap: float) -> np.ndarray:
        """Times at 100 Hz that all of them cover [s]."""
        series = (self.wrench, self.pose[0], self.joints, self.velocity)
        return common_base([s for s in series if s is not None], longest_gap)

    def tcp(self, table: Mapping, base: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Position of the TCP [m], and orientation of the hand, at the base's times."""
        hand = resampled_rotation(self.pose[0].time_s, self.pose[1], base)
        return resampled(self.pose[0], base) + hand.apply(table.hand.tcp_in_hand_m), hand

    def delay(self, table: Mapping) -> Delay | None:
        """Delay of the wrench: the mapping's, or that of an accelerated turn of separate streams; else None."""
        if table.sensor.delay_s is not None:
            return Delay(table.sensor.delay_s, 0.0)
        if not table.separate or not self.action.accelerated:
            return None
        base = self.base(table.longest_gap_s)
        position, hand = self.tcp(table, base)
        up = (hand * Rotation.from_quat(table.sensor.in_hand_wxyz, scalar_first=True)).inv().apply([0.0, 0.0, 1.0])
        torque = np.sum(resampled(self.wrench, base)[:, 3:] * up, axis=1)
        return wrench_delay(torque, position, hand, base)

    def earlier(self, seconds: float) -> _Streams:
        """The same with the wrench's stamps earlier."""
        return replace(self, wrench=self.wrench._replace(time_s=self.wrench.time_s - seconds))


def _action_and_object(table: Mapping, mapping: Path) -> tuple[TableAction, ObjectModel]:
    action, model = table.recorded_action(), object_of(table, mapping)
    try:
        return action.on(model.shape), model
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=mapping) from None


def _moment(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, UTC).isoformat(timespec="milliseconds")


def read_wrench(log: Log, sensor: SensorMap, time: TimeMap) -> Series:
    """Wrench of the sensor [N, N m], shape (N, 6).

    Raises:
        InvalidValueError: no such column or topic, or nothing says where the wrench is.
        LogError: values that are no numbers.
    """
    field = "sensor.force, sensor.torque"
    kind = log.type_of(field, sensor.topic)
    if sensor.force and sensor.torque:
        names = [*sensor.force, *sensor.torque]
    elif kind in _WRENCHES:
        names = [f"{_WRENCHES[kind]}{part}.{a}" for part in ("force", "torque") for a in "xyz"]
    else:
        of = f"; {sensor.topic} has {kind or 'no type of message'}" if sensor.topic else ""
        raise InvalidValueError(field, None, f"columns of the wrench{of}", file=log.path)
    stamps, values = log.series(field, names, sensor.topic, sensor.time or time)
    units = np.repeat([factor("force", sensor.force_unit), factor("torque", sensor.torque_unit)], 3)
    return Series(stamps, values * units)


def in_sensor_axes(wrench: Series, pose: Pose, sensor: SensorMap) -> Series:
    """Wrench by the axes of the sensor, of one that may be by those of the arm's base, as a UR reports it."""
    if sensor.axes == "sensor":
        return wrench
    mount = Rotation.from_quat(sensor.in_hand_wxyz, scalar_first=True)
    back = (resampled_rotation(pose[0].time_s, pose[1], wrench.time_s) * mount).inv()
    return wrench._replace(
        values=np.hstack([back.apply(part) for part in (wrench.values[:, :3], wrench.values[:, 3:])])
    )


def _joints(log: Log, joints: JointMap, time: TimeMap) -> Series:
    """Joint angles [rad], shape (N, 7)."""
    stamps, values = log.series("joints.position", joints.position, joints.topic, time)
    return Series(stamps, values * factor("angle", joints.unit))


def _velocity(log: Log, velocity: VelocityMap, time: TimeMap) -> Series:
    """Velocity of the TCP, base axes [m/s, rad/s], shape (N, 6)."""
    names = [*velocity.linear, *velocity.angular]
    stamps, values = log.series("velocity.linear, velocity.angular", names, velocity.topic, time)
    units = [factor("speed", velocity.linear_unit), factor("turn rate", velocity.angular_unit)]
    return Series(stamps, values * np.repeat(units, 3))


def _differentiated(position: np.ndarray, hand: Rotation) -> np.ndarray:
    """Velocity of the TCP from its pose, base axes [m/s, rad/s], shape (T, 6)."""
    window = round(_SLOPE_WINDOW * RATE) | 1
    linear = savgol_filter(position, window, 2, deriv=1, delta=1 / RATE, axis=0)
    steps = (hand[1:] * hand[:-1].inv()).as_rotvec() * RATE  # mean turn rate between two samples
    rate = np.vstack([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
    return np.hstack([np.asarray(linear), np.asarray(savgol_filter(rate, window, 2, axis=0))])


def _closing_yaw(hand: Rotation, hand_map: HandMap) -> np.ndarray:
    """Yaw of the direction in which the pads close [rad], without jumps."""
    angle = np.radians(hand_map.closing_deg)
    along = hand.apply([np.cos(angle), np.sin(angle), 0.0])
    return np.unwrap(np.arctan2(along[:, 1], along[:, 0]))


def _phases(table: Mapping, action: TableAction, time: np.ndarray, height: np.ndarray, twist: np.ndarray) -> Phases:
    if table.phases:
        return phases_from_windows(table.phases, time)
    return phases_from_motion(action, height, twist)
