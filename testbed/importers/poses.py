"""Pose of the hand from columns, pose messages, a tree of transforms, or joint angles and a URDF."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from testbed.errors import InvalidValueError
from testbed.importers.logs import LogError, Series, factor, in_order, unknown
from testbed.importers.mapping import HandMap, TimeMap
from testbed.importers.messages import JOINT_STATE, Message, MessageLog, inside
from testbed.importers.tables import CsvLog
from testbed.importers.urdf import forward_kinematics, joints_to

Log = CsvLog | MessageLog
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


def hand_pose(log: Log, hand: HandMap, time: TimeMap, folder: Path) -> Pose:
    """Pose of the hand, arm's base frame.

    Args:
        log: where it is.
        hand: the mapping's [hand] table.
        time: column and unit of the time.
        folder: folder of the mapping file, from which a URDF is named.

    Raises:
        InvalidValueError: no such topic, column, frame, link or joint; or nothing says where the pose is.
        LogError: values that are no pose.
    """
    kind = log.type_of("hand", hand.topic)
    if hand.position and hand.orientation:
        return _from_columns(log, hand, hand.position, hand.orientation, time)
    if isinstance(log, MessageLog) and kind == _TREE:
        return _from_tree(log, hand, time)
    if isinstance(log, MessageLog) and kind == JOINT_STATE:
        return _from_joints(log, hand, time, folder)
    if kind not in _FIELDS:
        of = f"; {hand.topic} has {kind or 'no type of message'}" if hand.topic else ""
        raise InvalidValueError("hand.position, hand.orientation", None, f"columns of the pose{of}", file=log.path)
    where, turned = _FIELDS[kind]
    position, orientation = [f"{where}.{a}" for a in "xyz"], [f"{turned}.{a}" for a in "xyzw"]
    known = {"orientation_as": "xyzw", "position_unit": "m"}
    return _from_columns(log, hand.model_copy(update=known), position, orientation, time)


def _from_columns(log: Log, hand: HandMap, position: Sequence[str], orientation: Sequence[str], time: TimeMap) -> Pose:
    stamps, values = log.series("hand.position, hand.orientation", [*position, *orientation], hand.topic, time)
    where, given = values[:, :3] * factor("length", hand.position_unit), values[:, 3:]
    if hand.orientation_as in ("wxyz", "xyzw"):
        rotation = _quaternions(given, hand.orientation_as == "wxyz")
    elif hand.orientation_as == "rotation_vector":
        rotation = Rotation.from_rotvec(given * factor("angle", hand.angle_unit))
    else:
        rotation = Rotation.from_euler("xyz", given * factor("angle", hand.angle_unit))
    return Series(stamps, where), rotation


def _quaternions(given: np.ndarray, scalar_first: bool = False) -> Rotation:
    lengths = np.linalg.norm(given, axis=1)
    worst = int(np.argmax(np.abs(lengths - 1)))
    if abs(lengths[worst] - 1) > 0.01:
        raise LogError(f"hand.orientation: length {lengths[worst]:g} at sample {worst}; allowed: unit quaternions")
    return Rotation.from_quat(given, scalar_first=scalar_first)


class _Edge(NamedTuple):
    """Transform from a frame to its parent over time; fixed if it has one stamp."""

    parent: str
    time_s: np.ndarray
    position: np.ndarray
    rotation: Rotation

    def at(self, time: np.ndarray) -> tuple[np.ndarray, Rotation]:
        if len(self.time_s) == 1 or np.array_equal(time, self.time_s):
            return self.position, self.rotation
        position = np.column_stack([np.interp(time, self.time_s, column) for column in self.position.T])
        return position, Slerp(self.time_s, self.rotation)(time)


def _from_tree(log: MessageLog, hand: HandMap, time: TimeMap) -> Pose:
    edges = _edges(log, str(hand.topic), time)
    if hand.frame not in edges:
        raise unknown("hand.frame", hand.frame, sorted(edges), log.path)
    frame, chain, passed = hand.frame, [], []
    while frame in edges and frame != hand.base and frame not in passed:
        passed.append(frame)
        chain.append(edges[frame])
        frame = edges[frame].parent
    if hand.base not in (None, frame):
        raise InvalidValueError("hand.base", hand.base, f"a frame above {hand.frame}, or {frame}", file=log.path)
    moving = [edge for edge in chain if len(edge.time_s) > 1]
    if not moving:
        raise LogError(f"{log.path}: hand.frame: {hand.frame} never moves in {frame}; allowed: the frame of a hand")
    stamps = moving[0].time_s
    begin, end = max(e.time_s[0] for e in moving), min(e.time_s[-1] for e in moving)
    stamps = stamps[(stamps >= begin) & (stamps <= end)]
    position, rotation = np.zeros((len(stamps), 3)), Rotation.identity(len(stamps))
    for edge in chain:
        offset, turn = edge.at(stamps)
        position, rotation = turn.apply(position) + offset, turn * rotation
    return Series(stamps, position), rotation


def _edges(log: MessageLog, topic: str, time: TimeMap) -> dict[str, _Edge]:
    """Transforms of a topic, and of the static one beside it, by child frame."""
    edges: dict[str, _Edge] = {}
    for name in (f"{topic}_static", topic):
        by_child: dict[str, list[Message]] = {}
        for message in log.messages(name) if name in log.types else []:
            for transform in inside(message.content, "transforms"):
                child = str(inside(transform, "child_frame_id"))
                by_child.setdefault(child, []).append(message._replace(content=transform))
        for child, messages in by_child.items():
            kept = messages[-1:] if name != topic else messages
            names = [*(f"transform.translation.{a}" for a in "xyz"), *(f"transform.rotation.{a}" for a in "xyzw")]
            stamps, values = np.zeros(1), log.values(f"hand.frame {child}", names, name, kept)
            if len(kept) > 1:
                stamps, values = in_order(log.path, f"hand.frame {child}", log.stamps(name, kept, time), values)
            parent = str(inside(inside(kept[-1].content, "header"), "frame_id"))
            edges[child] = _Edge(parent, stamps, values[:, :3], _quaternions(values[:, 3:]))
    return edges


def _from_joints(log: MessageLog, hand: HandMap, time: TimeMap, folder: Path) -> Pose:
    if hand.urdf is None:
        raise InvalidValueError("hand.urdf", None, f"the arm's URDF: {hand.topic} has joint angles", file=log.path)
    chain = joints_to(folder / hand.urdf, str(hand.frame), hand.base)
    names = [f"position.{joint.name}" for joint in chain if joint.kind != "fixed"]
    stamps, values = log.series("hand.urdf", names, hand.topic, time)
    position, rotation = forward_kinematics(chain, values)
    return Series(stamps, position), rotation
