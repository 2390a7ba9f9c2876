"""The object as its camera sees it: its pose where no hand holds it, and whether it is where the hand has it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from testbed.actions.push import Push
from testbed.frames import rotation_2d
from testbed.objects.faces import room_at
from testbed.objects.model import ObjectShape
from testbed.sensing.camera import PoseStream
from testbed.sensing.push_windows import touching
from testbed.trajectory import Phase, Trajectory

APART = 0.015, math.radians(6)
"""Distance [m] and angle [rad] between the object by hand and by camera from which their frames do not fit."""
_EVERY = 10


def as_seen(record: Trajectory) -> Trajectory:
    """Record with the object where its camera sees it, if the hand does not hold it; at rest where nothing was seen."""
    if record.action.grasp is not None or record.camera is None:
        return record
    motion = record.camera.motion(record.time_s)
    seen = np.flatnonzero(~np.isnan(motion.pose[:, 0]))
    if len(seen) == 0:
        return record
    nearest = seen[np.searchsorted(seen, np.arange(len(record.time_s))).clip(max=len(seen) - 1)]
    twist = np.where(np.isnan(motion.twist), 0.0, motion.twist)
    return replace(record, object_pose=motion.pose[nearest], object_velocity=twist)


def misseen(record: Trajectory, shape: ObjectShape) -> str:
    """What tells that the frames of hand and camera do not fit, in words; empty if nothing does.

    In a grip it sees the held link elsewhere than the hand has it; in a push the fingertip beside the object's face.
    Smaller errors of a camera's place show in no single trial.

    Args:
        record: a record with poses of a camera, compensated; one without says nothing.
        shape: geometry of the object.
    """
    if record.camera is None or not record.action.on_table:
        return ""
    return (
        _beside(record, shape, record.action) if isinstance(record.action, Push) else _off(record, shape, record.camera)
    )


def _off(record: Trajectory, shape: ObjectShape, camera: PoseStream) -> str:
    grasp = record.action.grasp
    assert grasp is not None
    chain, held = shape.chain, shape.pressed(shape.grasps[grasp])
    poses = camera.poses[:, 0 if chain is None else chain.link[held[0]]]
    moved = record.time_s[np.isin(record.phase, (Phase.RAMP, Phase.STEADY))]
    kept = ~np.isnan(poses[:, 0]) & (camera.time_s >= moved[0]) & (camera.time_s <= moved[-1])
    if not kept.any():
        return ""
    time = camera.time_s[kept]
    by_hand = np.column_stack([np.interp(time, record.time_s, column) for column in record.object_pose.T])
    off = poses[kept] - by_hand
    way = float(np.median(np.linalg.norm(off[:, :2], axis=1)))
    turn = float(np.angle(np.exp(1j * off[:, 2]).mean()))
    if way <= APART[0] and abs(turn) <= APART[1]:
        return ""
    return (
        f"it sees what is held {way * 1e3:.0f} mm and {math.degrees(turn):+.0f} deg from where the hand has it; "
        f"allowed: {APART[0] * 1e3:.0f} mm and {math.degrees(APART[1]):.0f} deg"
    )


def _beside(record: Trajectory, shape: ObjectShape, action: Push) -> str:
    contact = touching(record)[::_EVERY]
    pose = record.object_pose[contact]
    point = np.einsum("nij,nj->ni", rotation_2d(-pose[:, 2]), record.tcp_position[contact, :2] - pose[:, :2])
    away = float(np.median([room_at(shape, each) for each in point])) - action.radius
    if abs(away) <= APART[0]:
        return ""
    return f"it sees the face {away * 1e3:+.0f} mm from the fingertip that pushes it; allowed: {APART[0] * 1e3:.0f} mm"
