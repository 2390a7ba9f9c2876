"""Streams of a log, each by its own stamps: wrench, hand, joints, velocity, frames of a camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy.signal import savgol_filter
from scipy.spatial.transform import Rotation

from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.files import refuse_pointer
from testbed.importers.clocks import Delay, wrench_delay
from testbed.importers.columns import Columns, HandMap, JointMap, PartMap, SensorMap, TimeMap, VelocityMap
from testbed.importers.logs import LogError, Series, factor, read_all
from testbed.importers.mapping import Mapping
from testbed.importers.messages import open_messages
from testbed.importers.phases import RATE, common_base, resampled, resampled_rotation, without_faults
from testbed.importers.poses import Log, Pose, camera_pose, hand_pose
from testbed.importers.tables import ARRAYS, TableLog
from testbed.sensing.camera import PoseStream

_SLOPE_WINDOW = 0.15
"""Time over which a logged pose is differentiated [s]."""
_AROUND = 1.0
"""Time before and after a trial of which a camera's frames are kept [s]."""
_TEXTS = (".csv", ".tsv", ".txt")
_BAGS = (".db3", ".mcap")
_SUFFIXES = ", ".join(_TEXTS + ARRAYS + _BAGS)
MOST_TURNS = 20.0
"""Largest angle of a joint [turns]: cables and hoses allow less."""
_WRENCHES = {"geometry_msgs/WrenchStamped": "wrench.", "geometry_msgs/Wrench": ""}
"""Beginning of the fields of the messages that hold a wrench."""


@dataclass(frozen=True, eq=False)
class Streams:
    """Streams of a log, each by its own stamps from one epoch."""

    wrench: Series
    """Wrench as logged [N, N m]; see `sensed`."""
    pose: Pose
    joints: Series | None
    velocity: Series | None
    epoch_s: int
    begin_s: float
    """Time of the first sample that all of them cover in the whole log [s]."""
    begin_hand: Rotation
    """Orientation of the hand at that time."""
    left_out: str = ""
    """Samples of the wrench that measured nothing, in words."""
    camera_poses: tuple[Pose, ...] = ()
    """Poses of each link from a camera; they may cover less than the rest."""

    @classmethod
    def of(cls, source: Log, table: Mapping, folder: Path) -> Streams:
        """All streams of a log; all their errors at once. `folder` is the mapping's."""
        other = sensor_log(source, table, folder)
        (wrench, left_out), pose, joints, velocity, camera_poses = read_all(
            lambda: read_wrench(other, table.sensor, table.time),
            lambda: hand_pose(source, table.hand, table.time, folder, table.longest_gap_s),
            lambda: _joints(source, table.joints, table.time) if table.joints else None,
            lambda: _velocity(source, table.velocity, table.time, table.hand) if table.velocity else None,
            lambda: _camera_poses(source, table, folder),
        )
        wrench = wrench._replace(time_s=wrench.time_s + (other.epoch_s - source.epoch_s))
        streams = cls(wrench, pose, joints, velocity, source.epoch_s, 0.0, pose[1][0], left_out, camera_poses)
        begin = float(max(one.time_s[0] for one in streams.needed))
        stamps = np.clip([begin], *pose[0].time_s[[0, -1]])  # streams that do not overlap are refused later
        return replace(streams, begin_s=begin, begin_hand=resampled_rotation(pose[0].time_s, pose[1], stamps)[0])

    @property
    def needed(self) -> list[Series]:
        """All series but the camera's: each covers a whole trial."""
        return [one for one in (self.wrench, self.pose[0], self.joints, self.velocity) if one is not None]

    def early(self, seconds: float) -> Streams:
        """Streams with the wrench's stamps shifted back by a time [s]."""
        return replace(self, wrench=self.wrench._replace(time_s=self.wrench.time_s - seconds))

    def sensed(self, table: Mapping) -> Streams:
        """Streams with the wrench about the sensor, in its axes.

        The axes are those of the hand at the stamps of the wrench: take its delay off by `early` before.
        """
        wrench = in_sensor_axes(self.wrench, self.pose, table.sensor, table.hand)
        if table.sensor.torque_about == "tcp":
            lever = np.cross(table.tool.tcp_m, wrench.values[:, :3])
            wrench = wrench._replace(values=wrench.values + np.hstack([np.zeros_like(lever), lever]))
        return replace(self, wrench=wrench)

    def within(self, from_s: float, to_s: float | None) -> Streams:
        """The same from one time to another after the first sample; None is the end.

        Raises:
            InvalidValueError: beyond the log's end.
        """
        if from_s == 0 and to_s is None:
            return self
        seconds = min(one.time_s[-1] for one in self.needed) - self.begin_s
        if max(from_s, to_s or 0.0) > seconds + 1 / RATE:
            given = f"{from_s:g} to {seconds if to_s is None else to_s:g} s"
            raise InvalidValueError("logs.from_s, to_s", given, f"within the log's {seconds:.2f} s")
        low, high = self.begin_s + from_s - 1e-6, self.begin_s + (seconds if to_s is None else to_s) + 1e-6

        def cut(one: Series) -> slice:
            first, last = np.searchsorted(one.time_s, [low, high])
            return slice(max(int(first) - 1, 0), int(last) + 1)  # a sample beyond each end

        def part(one: Series | None) -> Series | None:
            return None if one is None else Series(one.time_s[cut(one)], one.values[cut(one)])

        position, hand = self.pose
        pose = (Series(position.time_s[cut(position)], position.values[cut(position)]), hand[cut(position)])
        return replace(
            self, wrench=part(self.wrench), pose=pose, joints=part(self.joints), velocity=part(self.velocity)
        )

    def tcp(self, table: Mapping, base: np.ndarray) -> tuple[np.ndarray, Rotation]:
        """Position of the TCP [m], and orientation of the hand, at the base's times."""
        hand = resampled_rotation(self.pose[0].time_s, self.pose[1], base)
        return resampled(self.pose[0], base) + hand.apply(table.hand.tcp_in_hand_m), hand

    def camera(self, table: Mapping, base: np.ndarray) -> PoseStream | None:
        """Frames of the camera around a trial, times from the base's first; None without a camera.

        Raises:
            LogError: no frame of a part during the trial.
        """
        if table.camera is None:
            return None
        time = np.unique(np.concatenate([series.time_s for series, _ in self.camera_poses]))
        poses = np.full((len(time), len(self.camera_poses), 3), np.nan)
        for part, (place, turned) in enumerate(self.camera_poses):
            along = turned.apply([1.0, 0.0, 0.0])
            yaw = np.arctan2(along[:, 1], along[:, 0])
            poses[np.searchsorted(time, place.time_s), part] = np.column_stack([place.values[:, :2], yaw])
        time = time - table.camera.delay_s - base[0]
        kept = (time >= -_AROUND) & (time <= base[-1] - base[0] + _AROUND)
        for part in range(len(self.camera_poses)):
            if np.isnan(poses[kept, part]).all():
                raise LogError(
                    f"camera.parts.{part}: no frame during the trial; allowed: frames by the clock of the hand's pose"
                )
        std = table.camera.position_std_m, float(np.radians(table.camera.angle_std_deg)), table.camera.delay_std_s
        return PoseStream(time[kept], poses[kept], *std)

    def delay(self, table: Mapping, action: Action) -> Delay | None:
        """Delay of the wrench: the mapping's, or that of an accelerated turn of separate streams; else None."""
        if table.sensor.delay_s is not None:
            return Delay(table.sensor.delay_s, 0.0)
        if not table.separate or not action.accelerated:
            return None
        base = common_base(self.needed, table.longest_gap_s)
        position, hand = self.tcp(table, base)
        up = (hand * Rotation.from_quat(table.sensor.in_hand_wxyz, scalar_first=True)).inv().apply([0.0, 0.0, 1.0])
        torque = np.sum(resampled(self.sensed(table).wrench, base)[:, 3:] * up, axis=1)
        return wrench_delay(torque, position, hand, base)


def open_log(path: Path, table: Columns) -> Log:
    """Open a log by its suffix; a folder is a bag.

    Raises:
        InvalidValueError: a suffix that is none of a log's, or no such file.
        LogError: a file that cannot be read.
    """
    for file in sorted(path.iterdir()) if path.is_dir() else [path]:
        if file.is_file():
            refuse_pointer(file, "log")
    if path.is_dir():
        return open_messages(path)
    if not path.is_file():
        raise InvalidValueError("log", str(path), f"an existing file ({_SUFFIXES}) or bag folder")
    if path.suffix.lower() in _TEXTS + ARRAYS:
        return TableLog(path, table)
    if path.suffix.lower() in _BAGS:
        return open_messages(path)
    raise InvalidValueError("log", str(path), f"a file that ends in {_SUFFIXES}, or a bag folder")


def sensor_log(log: Log, table: Columns, folder: Path) -> Log:
    """Log of the wrenches: the one that the mapping in a folder names, or the same."""
    return log if table.sensor.file is None else open_log(folder / table.sensor.file, table)


def read_wrench(log: Log, sensor: SensorMap, time: TimeMap) -> tuple[Series, str]:
    """Wrench of the sensor [N, N m], shape (N, 6), and the samples that measured nothing, in words: they are left out.

    Raises:
        InvalidValueError: no such column or topic, or nothing says where the wrench is.
        LogError: values that are no numbers, or too many that measured nothing.
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
    return without_faults(Series(stamps, values * units))


def in_sensor_axes(wrench: Series, pose: Pose, sensor: SensorMap, hand: HandMap) -> Series:
    """Wrench in the axes of the sensor; some robots, as those of UR, report it in those of the base."""
    if sensor.axes == "sensor":
        return wrench
    mount = Rotation.from_quat(sensor.in_hand_wxyz, scalar_first=True)
    back = (resampled_rotation(pose[0].time_s, pose[1], wrench.time_s) * mount).inv() * hand.upright
    return wrench._replace(
        values=np.hstack([back.apply(part) for part in (wrench.values[:, :3], wrench.values[:, 3:])])
    )


def _camera_poses(source: Log, table: Mapping, folder: Path) -> tuple[Pose, ...]:
    """Poses of each link from the camera, by the clock of the source."""
    if table.camera is None:
        return ()
    camera = table.camera

    def read(index: int, part: PartMap) -> Pose:
        log = source if part.file is None else open_log(folder / part.file, table)
        field, time = f"camera.parts.{index}", part.time or table.time
        series, turned = camera_pose(log, field, part, camera, time, table.longest_gap_s)
        return series._replace(time_s=series.time_s + (log.epoch_s - source.epoch_s)), turned

    return tuple(read_all(*(partial(read, *each) for each in enumerate(camera.parts))))


def _joints(log: Log, joints: JointMap, time: TimeMap) -> Series:
    """Joint angles [rad], shape (N, 7)."""
    stamps, values = log.series("joints.position", joints.position, joints.topic, time)
    turns = np.abs(values).max(initial=0.0) * factor("angle", joints.unit) / (2 * np.pi)
    if turns > MOST_TURNS:
        given = f"a joint at {turns:.3g} turns, in {joints.unit}"
        allowed = f"at most {MOST_TURNS:g} turns; is joints.unit another, or the column no angle?"
        raise InvalidValueError("joints.position", given, allowed, file=log.path)
    return Series(stamps, np.unwrap(values * factor("angle", joints.unit), axis=0))


def _velocity(log: Log, velocity: VelocityMap, time: TimeMap, hand: HandMap) -> Series:
    """Velocity of the TCP, axes of the base turned upright [m/s, rad/s], shape (N, 6)."""
    names = [*velocity.linear, *velocity.angular]
    stamps, values = log.series("velocity.linear, velocity.angular", names, velocity.topic, time)
    units = [factor("speed", velocity.linear_unit), factor("turn rate", velocity.angular_unit)]
    linear, angular = np.split(values * np.repeat(units, 3), 2, axis=1)
    return Series(stamps, np.hstack([hand.upright.apply(linear), hand.upright.apply(angular)]))


def differentiated(position: np.ndarray, hand: Rotation) -> np.ndarray:
    """Velocity of the TCP from its pose, base axes [m/s, rad/s], shape (T, 6)."""
    window = round(_SLOPE_WINDOW * RATE) | 1
    linear = savgol_filter(position, window, 2, deriv=1, delta=1 / RATE, axis=0)
    steps = (hand[1:] * hand[:-1].inv()).as_rotvec() * RATE  # mean turn rate between two samples
    rate = np.vstack([steps[:1], (steps[1:] + steps[:-1]) / 2, steps[-1:]])
    return np.hstack([np.asarray(linear), np.asarray(savgol_filter(rate, window, 2, axis=0))])


def closing_yaw(hand: Rotation, hand_map: HandMap) -> np.ndarray:
    """Yaw of the direction in which the pads close [rad], without jumps."""
    angle = np.radians(hand_map.closing_deg)
    along = hand.apply([np.cos(angle), np.sin(angle), 0.0])
    return np.unwrap(np.arctan2(along[:, 1], along[:, 0]))
