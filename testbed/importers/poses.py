"""Poses of the hand, and of objects by a camera: columns, messages, a tree of transforms, joint angles and a URDF."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from testbed.errors import InvalidValueError
from testbed.importers.columns import CameraMap, Cell, HandMap, PartMap, PoseMap, TimeMap
from testbed.importers.logs import LogError, Series, factor, in_order, unknown
from testbed.importers.messages import JOINT_STATE, Message, MessageLog
from testbed.importers.phases import ROUNDING
from testbed.importers.tables import TableLog
from testbed.importers.urdf import forward_kinematics, joints_to
from testbed.sensing.series import interpolated, runs

Log = TableLog | MessageLog
Pose = tuple[Series, Rotation]
"""Position [m], shape (N, 3), and orientation, N of them."""
_FIELDS = {
    "geometry_msgs/Pose": ("position", "orientation"),
    "geometry_msgs/PoseStamped": ("pose.position", "pose.orientation"),
    "geometry_msgs/PoseWithCovarianceStamped": ("pose.pose.position", "pose.pose.orientation"),
    "geometry_msgs/TransformStamped": ("transform.translation", "transform.rotation"),
    "nav_msgs/Odometry": ("pose.pose.position", "pose.pose.orientation"),
}
"""Fields of position and quaternion of the messages that have them."""
_TREE = "tf2_msgs/TFMessage"
FROZEN = 0.1
"""Shortest repetition of a pose within a motion that is left out [s]."""
LEAST_JUMP = 1e-4
"""Least half of the way during a repetition that shows a motion [m, or of a quaternion]: sources round their poses."""
BEFORE = 5
"""Number of steps before a repetition from which the speed is estimated."""
_TILTED = 20.0
"""Largest angle between the z axes of an object on the table and of the base [deg]."""


def hand_pose(log: Log, hand: HandMap, time: TimeMap, folder: Path, longest_gap: float) -> Pose:
    """Pose of the hand, arm's base frame turned upright.

    Args:
        log: where it is.
        hand: the mapping's [hand] table.
        time: column and unit of the time.
        folder: folder of the mapping file, from which a URDF is named.
        longest_gap: longest time between two stamps of a transform over which it is interpolated [s].

    Raises:
        InvalidValueError: no such topic, column, frame, link or joint; or nothing says where the pose is.
        LogError: values that are no pose.
    """
    if isinstance(log, MessageLog) and not hand.position and log.type_of("hand", hand.topic) == JOINT_STATE:
        found = _from_joints(log, hand, time, folder)
    else:
        found = _pose(log, "hand", hand, time, longest_gap)
    series, turned = found if isinstance(log, TableLog) and log.numbered else without_frozen(found)
    return series._replace(values=hand.upright.apply(series.values)), hand.upright * turned


def camera_pose(log: Log, field: str, part: PartMap, camera: CameraMap, time: TimeMap, longest_gap: float) -> Pose:
    """Pose of an object frame by a camera, arm's base frame.

    Args:
        log: where it is.
        field: the mapping's name for it, in errors.
        part: the mapping's [[camera.parts]] table.
        camera: its [camera] table.
        time: column and unit of the time.
        longest_gap: as in `hand_pose`.

    Raises:
        InvalidValueError: as `hand_pose`.
        LogError: values that are no pose, or a frame that does not lie on the table.
    """
    pose = _pose(log, field, part, time, longest_gap)
    if isinstance(log, TableLog) and part.file is None:  # a row for every sample of the other streams too
        pose = without_held(pose)
    series, marker = without_frozen(pose)
    mount = Rotation.from_quat(camera.in_base_wxyz, scalar_first=True)
    place = mount.apply(series.values + marker.apply(part.object_m)) + camera.in_base_m
    turned = mount * marker * Rotation.from_quat(part.object_wxyz, scalar_first=True)
    tilt = np.degrees(np.arccos(np.clip(turned.as_matrix()[:, 2, 2], -1.0, 1.0)))
    if (usual := float(np.median(tilt))) > _TILTED:
        raise LogError(
            f"{field}: the object's z axis is {usual:.0f} deg from the base's; allowed: {_TILTED:g} deg, up from the "
            "table: check object_wxyz and in_base_wxyz"
        )
    return Series(series.time_s, place), turned


def _pose(log: Log, field: str, of: PoseMap, time: TimeMap, longest_gap: float) -> Pose:
    kind = log.type_of(field, of.topic)
    if of.position and of.orientation:
        return _from_columns(log, field, of, of.position, of.orientation, time)
    if isinstance(log, MessageLog) and kind == _TREE:
        return _from_tree(log, field, of, time, longest_gap)
    if kind not in _FIELDS:
        has = f"; {of.topic} has {kind or 'no type of message'}" if of.topic else ""
        columns = f"{field}.position, {field}.orientation"
        raise InvalidValueError(columns, None, f"columns of the pose{has}", file=log.path)
    where, turned = _FIELDS[kind]
    position, orientation = [f"{where}.{a}" for a in "xyz"], [f"{turned}.{a}" for a in "xyzw"]
    known = {"orientation_as": "xyzw", "position_unit": "m"}
    return _from_columns(log, field, of.model_copy(update=known), position, orientation, time)


def _from_columns(
    log: Log, field: str, of: PoseMap, position: Sequence[Cell], orientation: Sequence[Cell], time: TimeMap
) -> Pose:
    columns = f"{field}.position, {field}.orientation"
    stamps, values = log.series(columns, [*position, *orientation], of.topic, time)
    where, given = np.split(values, [len(position)], axis=1)
    where = np.pad(where * factor("length", of.position_unit), ((0, 0), (0, 3 - len(position))))
    if of.orientation_as in ("wxyz", "xyzw"):
        rotation = _quaternions(f"{field}.orientation", given, of.orientation_as == "wxyz")
    elif of.orientation_as == "matrix":
        rotation = _matrices(f"{field}.orientation", given.reshape(-1, 3, 3))
    elif of.orientation_as == "rotation_vector":
        rotation = Rotation.from_rotvec(given * factor("angle", of.angle_unit))
    else:
        axes = "z" if of.orientation_as == "yaw" else "xyz"
        rotation = Rotation.from_euler(axes, given * factor("angle", of.angle_unit))
    return Series(stamps, where), rotation


def without_frozen(pose: Pose) -> Pose:
    """Poses without repetitions of `FROZEN` or longer within a motion.

    A source that loses the hand or the object may repeat its last pose, which is no measurement. A rest is kept: no
    jump ends it.
    """
    stamps, steps = pose[0].time_s, _steps(pose)
    kept = np.full(len(stamps), True)
    for run in runs(steps == 0):
        first, last = int(run[0]), int(run[-1]) + 1  # these samples and all between are equal
        seconds, before = stamps[last] - stamps[first], slice(first - BEFORE, first)
        if seconds < FROZEN or last == len(steps) or first < BEFORE:
            continue
        way = float(np.median(steps[before] / np.diff(stamps)[before])) * seconds
        kept[run + 1] = not steps[last] > way / 2 > LEAST_JUMP
    return _among(pose, kept)


def without_held(pose: Pose) -> Pose:
    """Poses without repetitions shorter than `FROZEN`: a table at a higher rate holds the frames of a camera.

    Longer repetitions are a rest.
    """
    stamps, steps = pose[0].time_s, _steps(pose)
    kept = np.full(len(stamps), True)
    for run in runs(steps == 0):
        kept[run + 1] = stamps[run[-1] + 1] - stamps[run[0]] >= FROZEN
    return _among(pose, kept)


def _steps(pose: Pose) -> np.ndarray:
    """Largest change of a component from each pose to the next [m, or of a quaternion]."""
    (_, place), turned = pose
    quaternion = turned.as_quat()
    flips = (quaternion[1:] * quaternion[:-1]).sum(axis=1) < 0  # q and -q are one rotation
    quaternion[1:] *= np.cumprod(np.where(flips, -1.0, 1.0))[:, None]
    return np.abs(np.diff(np.hstack([place, quaternion]), axis=0)).max(axis=1)


def _among(pose: Pose, kept: np.ndarray) -> Pose:
    (stamps, place), turned = pose
    return pose if kept.all() else (Series(stamps[kept], place[kept]), Rotation.from_quat(turned.as_quat()[kept]))


def _quaternions(field: str, given: np.ndarray, scalar_first: bool = False) -> Rotation:
    lengths = np.linalg.norm(given, axis=1)
    worst = int(np.argmax(np.abs(lengths - 1)))
    if abs(lengths[worst] - 1) > 0.01:
        raise LogError(f"{field}: length {lengths[worst]:g} at sample {worst}; allowed: unit quaternions")
    return Rotation.from_quat(given, scalar_first=scalar_first)


def _matrices(field: str, given: np.ndarray) -> Rotation:
    off = np.abs(given @ given.transpose(0, 2, 1) - np.eye(3)).max(axis=(1, 2))
    off = np.maximum(off, np.abs(np.linalg.det(given) - 1))
    worst = int(np.argmax(off))
    if off[worst] > 0.02:
        raise LogError(f"{field}: no rotation at sample {worst}; allowed: matrices row by row, of determinant 1")
    return Rotation.from_matrix(given)


class _Edge(NamedTuple):
    """Transform from a frame to its parent over time; fixed if it has one stamp."""

    parent: str
    time_s: np.ndarray
    position: np.ndarray
    rotation: Rotation

    def at(self, time: np.ndarray) -> tuple[np.ndarray, Rotation]:
        if len(self.time_s) == 1 or np.array_equal(time, self.time_s):
            return self.position, self.rotation
        return interpolated(time, self.time_s, self.position), Slerp(self.time_s, self.rotation)(time)


def _from_tree(log: MessageLog, field: str, of: PoseMap, time: TimeMap, longest_gap: float) -> Pose:
    """Pose of a frame at the stamps of its lowest moving transform, without those in a gap of another one."""
    edges = _edges(log, field, str(of.topic), time)
    if of.frame not in edges:
        raise unknown(f"{field}.frame", of.frame, sorted(edges), log.path)
    frame, chain, passed = of.frame, [], []
    while frame in edges and frame != of.base and frame not in passed:
        passed.append(frame)
        chain.append(edges[frame])
        frame = edges[frame].parent
    if frame in passed:
        cycle = ", ".join([*passed, frame])
        raise LogError(f"{log.path}: {field}.frame: a cycle of transforms ({cycle}); allowed: a tree, of one root")
    if of.base not in (None, frame):
        raise InvalidValueError(f"{field}.base", of.base, f"a frame above {of.frame}, or {frame}", file=log.path)
    moving = [edge for edge in chain if len(edge.time_s) > 1]
    if not moving:
        raise LogError(f"{log.path}: {field}.frame: {of.frame} never moves in {frame}; allowed: a frame that does")
    stamps = moving[0].time_s
    begin, end = max(e.time_s[0] for e in moving), min(e.time_s[-1] for e in moving)
    stamps = stamps[(stamps >= begin) & (stamps <= end)]
    for edge in moving[1:]:
        after = np.searchsorted(edge.time_s, stamps).clip(1, len(edge.time_s) - 1)
        gap = edge.time_s[after] - edge.time_s[after - 1]
        rests = _steps((Series(edge.time_s, edge.position), edge.rotation))[after - 1] == 0
        stamps = stamps[(gap <= longest_gap + ROUNDING) | rests | np.isin(stamps, edge.time_s)]
    if len(stamps) < 2:
        spans = [(name, edges[name].time_s) for name in passed if len(edges[name].time_s) > 1]
        given = ", ".join(f"{name} at {one[0]:.2f} to {one[-1]:.2f} s" for name, one in spans)
        raise LogError(f"{log.path}: {field}.frame: {given}; allowed: frames whose stamps share a stretch of time")
    position, rotation = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
    for edge in chain:
        offset, turn = edge.at(stamps)
        position, rotation = turn.apply(position) + offset, turn * rotation
    return Series(stamps, position), rotation


def _edges(log: MessageLog, field: str, topic: str, time: TimeMap) -> dict[str, _Edge]:
    """Transforms of a topic, and of the static one beside it, by child frame."""
    edges: dict[str, _Edge] = {}
    for name in (f"{topic}_static", topic):
        by_child: dict[str, list[Message]] = {}
        for message in log.messages(name) if name in log.types else []:
            transforms = log.part(f"{field}.topic {name}", "transforms", message.content)
            if not isinstance(transforms, list):
                allowed = "a list of transforms in every message"
                raise InvalidValueError(f"{field}.topic {name}", transforms, allowed, file=log.path)
            for transform in transforms:
                child = str(log.part(f"{field}.topic {name}", "child_frame_id", transform))
                by_child.setdefault(child, []).append(message._replace(text=json.dumps(transform).encode()))
        for child, messages in by_child.items():
            kept = messages[-1:] if name != topic else messages
            names = [*(f"transform.translation.{a}" for a in "xyz"), *(f"transform.rotation.{a}" for a in "xyzw")]
            stamps, values = np.zeros(1), log.values(f"{field}.frame {child}", names, name, kept)
            if len(kept) > 1:
                stamps, values = in_order(log.path, f"{field}.frame {child}", log.stamps(name, kept, time), values)
            parent = str(log.part(f"{field}.frame {child}", "header.frame_id", kept[-1].content))
            edges[child] = _Edge(parent, stamps, values[:, :3], _quaternions(f"{field}.frame {child}", values[:, 3:]))
    return edges


def _from_joints(log: MessageLog, hand: HandMap, time: TimeMap, folder: Path) -> Pose:
    if hand.urdf is None:
        raise InvalidValueError("hand.urdf", None, f"the arm's URDF: {hand.topic} has joint angles", file=log.path)
    chain = joints_to(folder / hand.urdf, str(hand.frame), hand.base)
    names = [f"position.{joint.name}" for joint in chain if joint.kind != "fixed"]
    if not names:
        allowed = f"a link that a joint moves against {hand.base or 'the root'}"
        raise InvalidValueError("hand.frame", hand.frame, allowed, file=folder / hand.urdf)
    stamps, values = log.series("hand.urdf", names, hand.topic, time)
    position, rotation = forward_kinematics(chain, values)
    return Series(stamps, position), rotation
