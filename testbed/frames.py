"""Planar and spatial frames, and wrenches in them.

Sign convention: a wrench is the action of the gripper on the object, force then torque about the named point.
Planar poses are x, y [m] and yaw [rad]; quaternions are wxyz.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation


def rotation_2d(angle: Float[np.ndarray, "..."] | float) -> Float[np.ndarray, "... 2 2"]:
    """Rotation matrices of planar rotations by `angle` [rad], shape (..., 2, 2)."""
    c, s = np.cos(angle), np.sin(angle)
    return np.stack([np.stack([c, -s], -1), np.stack([s, c], -1)], -2)


def rotation_z(angle: float) -> Float[np.ndarray, "3 3"]:
    """Rotation matrix about z by an angle [rad], shape (3, 3)."""
    turn = np.eye(3)
    turn[:2, :2] = rotation_2d(angle)
    return turn


def transform_point(pose: Float[np.ndarray, "... 3"], point: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """World coordinates of a point in the frame at `pose`."""
    return pose[..., :2] + np.einsum("...ij,...j->...i", rotation_2d(pose[..., 2]), np.asarray(point))


def pose_from_point(
    point_world: Float[np.ndarray, "... 2"], point: Float[np.ndarray, "2"], yaw: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "... 3"]:
    """Pose with angle `yaw` at which the body's `point` lies at `point_world`, shape (..., 3)."""
    xy = point_world - np.einsum("...ij,j->...i", rotation_2d(yaw), np.asarray(point))
    return np.concatenate([xy, np.asarray(yaw)[..., None]], axis=-1)


def cross_2d(a: Float[np.ndarray, "... 2"], b: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "..."]:
    """z component of the cross product a x b, shape (...)."""
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def perpendicular(vector: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    """Vector rotated by +90 degrees: e_z x vector."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)


def origin_velocity(
    twist: Float[np.ndarray, "N 6"], yaw: Float[np.ndarray, "N"], point: Float[np.ndarray, "2"]
) -> Float[np.ndarray, "N 3"]:
    """Planar velocity of a body's origin [m/s, m/s, rad/s] from the twist at its `point` [m/s, rad/s], world axes."""
    lever = np.einsum("nij,j->ni", rotation_2d(yaw), -point)
    return np.column_stack([twist[:, :2] + twist[:, 5:] * perpendicular(lever), twist[:, 5]])


def rotation_matrix(quaternion: Float[np.ndarray, "... 4"]) -> Float[np.ndarray, "... 3 3"]:
    """Rotation matrices of wxyz quaternions, shape (..., 3, 3)."""
    return Rotation.from_quat(quaternion, scalar_first=True).as_matrix()


def rotate_wrench(
    rotation: Float[np.ndarray, "... 3 3"], wrench: Float[np.ndarray, "... 6"]
) -> Float[np.ndarray, "... 6"]:
    """Wrench in rotated axes, about the same point."""
    return np.concatenate(
        [np.einsum("...ij,...j->...i", rotation, part) for part in (wrench[..., :3], wrench[..., 3:])], -1
    )


def move_wrench(wrench: Float[np.ndarray, "... 6"], to_point: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 6"]:
    """Wrench about another point, at `to_point` [m] from the present one, in the same axes."""
    torque = wrench[..., 3:] - np.cross(to_point, wrench[..., :3])
    return np.concatenate([wrench[..., :3], torque], axis=-1)
