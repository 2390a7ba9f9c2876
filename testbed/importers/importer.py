"""Import of a log by its mapping: a trajectory, resampled, compensated, its drift judged."""

from __future__ import annotations

from datetime import UTC, datetime
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.frames import origin_velocity, pose_from_point
from testbed.importers.clocks import NO_DELAY, Delay
from testbed.importers.logs import LogError, read_all
from testbed.importers.mapping import LogMap, Mapping
from testbed.importers.phases import (
    RATE,
    check_sensor_alive,
    check_stretches,
    common_base,
    phases_from_motion,
    phases_from_windows,
    resampled,
)
from testbed.importers.streams import Streams, closing_yaw, differentiated, open_log
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.robot.calibration.file import load_calibration
from testbed.sensing.camera_poses import frame_mismatch, with_camera_poses
from testbed.sensing.compensation import ZEROED_BEFORE, compensate
from testbed.sensing.drift import DriftLimit, judge_drift
from testbed.toml import load_toml
from testbed.trajectory import Tool, Trajectory

FARTHEST = 50.0
"""Largest coordinate of a hand [m]: no hall with a bench is larger."""
_CAMERA_REMEDY = "check in_base of [camera], object and order of [[camera.parts]], tcp_in_hand_m and closing_deg"
_SINCE_1970 = 1e9, 4e9
"""Times between these count from 1970: the years 2001 to 2096 [s]."""


def import_trajectory(log: Path, mapping: Path, delay: Delay | None = None, entry: LogMap | None = None) -> Trajectory:
    """Read a log of another robot as a trajectory.

    Args:
        log: a table, an .mcap file, or a ROS 2 bag: its folder or a .db3 file.
        mapping: a TOML file that describes its columns; see docs/formats.md.
        delay: delay of a separate stream of wrenches; None takes the mapping's, or that of an accelerated turn.
        entry: the [[logs]] table of the trial, if several name this log.

    Raises:
        InvalidFileError: the mapping does not fit its schema; one line per error.
        InvalidValueError: an unknown column, topic, object or grasp; the message names the nearest.
        LogError: invalid numbers or times, gaps, or phases that cannot be found; or several errors, one line each.
    """
    table, gain, entry = _entry_table(log, mapping, entry)
    (action, model), streams = _content(log, table, mapping, entry)
    delay = streams.delay(table, action) if delay is None or not table.separate else delay
    if delay is not None and delay.sure:
        streams = streams.early(delay.seconds)
    streams = streams.sensed(table)
    wrench, velocity, joints = streams.wrench, streams.velocity, streams.joints
    base = common_base(streams.needed, table.longest_gap_s)
    time, count, begin = np.arange(len(base)) / RATE, len(base), streams.epoch_s + float(base[0])
    position, hand = streams.tcp(table, base)
    if (far := float(np.abs(position).max())) > FARTHEST:
        raise LogError(
            f"hand.position: {far:.3g} m from the origin; allowed: {FARTHEST:g} m; is position_unit another?"
        )
    twist = resampled(velocity, base) if velocity else differentiated(position, hand)
    position[:, 2] -= table.hand.table_height_m
    if table.phases:
        phase, segment = phases_from_windows(table.phases, base - streams.begin_s, table.sensor.zeroed)
        check_stretches(action, twist, segment)
    else:
        phase, segment = phases_from_motion(action, position[:, 2], twist, table.sensor.zeroed)
    check_sensor_alive(wrench, base[0] + time[np.flatnonzero(segment >= 0)[[0, -1]]], table.sensor.measured)
    yaw, grip = np.zeros(count), np.zeros(2)  # of a push: its object is where the camera sees it
    if action.grasp is not None:
        grasp = model.shape.grasps[action.grasp]
        yaw, grip = closing_yaw(hand, table.hand) - grasp.angle, grasp.position
    in_hand = Rotation.from_quat(table.sensor.in_hand_wxyz, scalar_first=True)
    zeroed = (streams.begin_hand * in_hand).as_quat(scalar_first=True) if table.sensor.zeroed else None
    figures = {"wrench_delay_s": delay.seconds, "wrench_delay_std_s": delay.std} if delay else {}
    figures |= {} if zeroed is None else {ZEROED_BEFORE: float(base[0]) - streams.begin_s}
    tool, since_1970 = table.tool, _SINCE_1970[0] < begin < _SINCE_1970[1]
    origin = {
        "runner": "import",
        "object": model.name,
        "log": log.name,
        "stretch": entry.stretch or None,
        "sensor log": table.sensor.file,
        "recorded": datetime.fromtimestamp(begin, UTC).isoformat(timespec="milliseconds") if since_1970 else None,
        "joints": "as logged" if joints else "not logged: zeros",
        "velocity": "as logged" if velocity else "from the pose",
        "phases": "as mapped" if table.phases else "from the motion",
        "left out": streams.left_out or None,
        "delay": str(delay or NO_DELAY) if table.separate or delay else None,
    }
    trajectory = Trajectory(
        action=action,
        status="ok",
        reason="",
        time_s=time,
        phase=phase,
        segment=segment,
        object_pose=pose_from_point(position[:, :2], grip, yaw),
        object_velocity=origin_velocity(twist, yaw, grip),
        tcp_position=position,
        tcp_velocity=twist,
        sensor_orientation=(hand * in_hand).as_quat(scalar_first=True),
        sensor_wrench=table.sensor.sign * resampled(wrench, base) / gain,
        wrench_on_object_world=np.zeros((count, 6)),
        joint_position=np.zeros((count, 7)) if joints is None else resampled(joints, base),
        tool=Tool(tool.mass_kg, np.array(tool.com_m), np.array(tool.inertia_kg_m2), np.array(tool.tcp_m)),
        sensor_bias_std=np.repeat([table.sensor.bias_std_N, table.sensor.bias_std_Nm], 3),
        sensor_drift_std=np.repeat([table.sensor.drift_std_N, table.sensor.drift_std_Nm], 3),
        setup=table.setup,
        camera=streams.camera(table, base),
        provenance={name: words for name, words in origin.items() if words is not None},
        figures=figures,
    )
    trajectory = with_camera_poses(compensate(trajectory, zeroed))
    if doubt := frame_mismatch(trajectory, model.shape):
        raise LogError(f"camera: {doubt}; {_CAMERA_REMEDY}")
    return judge_drift(trajectory, DriftLimit())


def delay_of(log: Path, mapping: Path, entry: LogMap | None = None) -> Delay | None:
    """Delay of a log's wrenches, if it is an accelerated turn of separate streams and the mapping gives none.

    Raises:
        HeftError: see `import_trajectory`.
    """
    table, _, entry = _entry_table(log, mapping, entry)
    known = table.sensor.delay_s is not None or table.action is None  # without an action it is refused later
    if known or not table.separate or not table.recorded_action().action.accelerated:
        return None
    (action, _), streams = _content(log, table, mapping, entry)
    return streams.delay(table, action)


def _entry_table(log: Path, mapping: Path, entry: LogMap | None) -> tuple[Mapping, np.ndarray, LogMap]:
    """The mapping of one trial, calibrated, the gains of the axes, and its [[logs]] table."""
    whole = load_toml(mapping, Mapping)
    if whole.rows == "poses":
        raise InvalidValueError("rows", "poses", "samples: rows of poses are for heft calibrate", file=mapping)
    (entry,) = [entry] if entry else whole.entries(log, mapping.parent)
    return *calibrated(whole.for_entry(entry), mapping), entry


def _content(log: Path, table: Mapping, mapping: Path, entry: LogMap) -> tuple[tuple[Action, ObjectModel], Streams]:
    """Action, object and streams of a trial; all their errors at once."""
    source = open_log(log, table)
    own = "" if entry.action is None else " of " + ", ".join(filter(None, (log.name, entry.stretch)))
    named, streams = read_all(
        lambda: _action_and_object(table, mapping, own), lambda: Streams.of(source, table, mapping.parent)
    )
    return named, streams.within(entry.from_s, entry.to_s)


def calibrated(table: Mapping, mapping: Path) -> tuple[Mapping, np.ndarray]:
    """The mapping with sign, mount and tool of the calibration that it names, and the gains of the axes."""
    if table.sensor.calibration is None:
        return table, np.ones(6)
    found = load_calibration(mapping.parent / table.sensor.calibration)
    sensor = {"sign": found.sign, "in_hand_wxyz": found.sensor_in_hand.tolist()}
    tool = {"mass_kg": found.mass, "com_m": found.com.tolist()}
    changes = {"sensor": table.sensor.model_copy(update=sensor), "tool": table.tool.model_copy(update=tool)}
    return table.model_copy(update=changes), found.gain


def object_of(table: Mapping, mapping: Path) -> ObjectModel:
    """Object of a mapping file, by a file beside it or by name, as in a scenario.

    Raises:
        HeftError: no such object, or its file does not fit; the message names both files.
    """
    beside = mapping.parent / table.object
    try:
        named = beside if table.object.endswith(".toml") and beside.is_file() else table.object
        return load_object(named, measured=True, hand=table.hand.size)
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=error.file or mapping) from None


def _action_and_object(table: Mapping, mapping: Path, own: str) -> tuple[Action, ObjectModel]:
    """Action and object of a trial; `own` names the log in an error where the action is not that of all logs."""
    named, model = table.recorded_action(), object_of(table, mapping)
    links = 1 if model.shape.chain is None else model.shape.chain.links
    try:
        action = named.on(model.shape, table.hand.size)
        if table.camera is None and (links > 1 or action.grasp is None):
            what = "the poses of a pushed object" if links == 1 else f"the poses of {links} links"
            raise InvalidValueError("camera", None, f"{what}: the hand's do not determine them")
        if table.camera is not None and len(table.camera.parts) != links:
            each = "one, of a rigid object" if links == 1 else f"{links}, one per link"
            raise InvalidValueError("camera.parts", f"{len(table.camera.parts)} tables", each)
        return action, model
    except InvalidValueError as error:
        raise InvalidValueError(error.field + own, error.given, error.allowed, file=mapping) from None
