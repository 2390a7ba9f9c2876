"""Planar and spatial frames, and moving a wrench between them.

One sign convention: a wrench is what the gripper does to the object, force then torque, torque about the named point.
Planar poses are x, y (m) and yaw (rad); quaternions are wxyz.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def rotation_2d(angle: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "... 2 2"]:
    """Rotation matrices that turn by `angle` (rad), (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def rotation_z(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation about z by an angle [rad]."""
    turn = np.eye(3)
    turn[:2, :2] = rotation_2d(angle)
    return turn


def transform_point(pose: Float[np.ndarray, "... 3"], point: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """A point given in the frame at `pose`, in the world."""
    return pose[..., :2] + np.einsum("...ij,...j->...i", rotation_2d(pose[..., 2]), np.asarray(point))


def pose_from_point(
    point_world: Float[np.ndarray, "... 2"], point: Float[np.ndarray, "2"], yaw: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "... 3"]:
    """The pose with angle `yaw` that puts the body's `point` at `point_world`."""
    xy = point_world - np.einsum("...ij,j->...i", rotation_2d(yaw), np.asarray(point))
    return np.concatenate([xy, np.asarray(yaw)[..., None]], axis=-1)


def cross_2d(a: Float[np.ndarray, "... 2"], b: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """z component of the cross product a x b."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def perpendicular(vector: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """The vector turned by +90 degrees: e_z x vector."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def origin_velocity(
    twist: Float[np.ndarray, "N 6"], yaw: Float[np.ndarray, "N"], point: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "N 3"]:
    """Planar velocity of a body's origin [m/s, m/s, rad/s] from the twist of its `point` [m/s, rad/s], world axes."""
    lever = np.einsum("nij,j->ni", rotation_2d(yaw), -point)
    return np.column_stack([twist[:, :2] + twist[:, 5:] * perpendicular(lever), twist[:, 5]])


def rotation_matrix(quaternion: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "... 3 3"]:
    """Rotation matrices of wxyz quaternions, (..., 3, 3)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def rotate_wrench(
    rotation: Float[np.ndarray, "... 3 3"], wrench: Float[np.ndarray, "... 6"]
) -> Float[np.ndarray, "... 6"]:
    """The wrench in rotated axes, about the same point."""
    return np.concatenate(
        [np.einsum("...ij,...j->...i", rotation, part) for part in (wrench[..., :3], wrench[..., 3:])], -1
    )


def move_wrench(wrench: Float[np.ndarray, "... 6"], to_point: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 6"]:
    """Wrench with its torque about the point `to_point` (from the present point), same axes."""
    torque = wrench[..., 3:] - np.cross(to_point, wrench[..., :3])
    return np.concatenate([wrench[..., :3], torque], axis=-1)
