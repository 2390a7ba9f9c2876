"""How the arm lifts and rocks: joint angles for every tick of a lift."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from testbed.actions import Lift
from testbed.frames import rotation_2d
from testbed.lift_profile import LiftProfile
from testbed.simulation.arm import joint_path

_EACH_WAY = 4
"""Waypoints from level to a tilt."""
_RISE = 5
"""Waypoints on the way up."""


def lifted_joints(
    action: Lift, profile: LiftProfile, hold: np.ndarray, yaw: float, q_hold: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles and speeds over a lift.

    Height and every axis have a path of their own, and all start from the same joint angles: the arm has a joint to
    spare, and would else come back to a pose by other angles.

    Args:
        action: the lift.
        profile: its ticks, N.
        hold: tool pose with the object on the table: x, y, z, m, and yaw of the closing direction, rad, (4,).
        yaw: of the object, rad, world.
        q_hold: joint angles there, (7,).

    Returns:
        Angles, rad, and speeds, rad/s, each (N, 7).

    Raises:
        InfeasibleTrialError: a pose out of reach or beyond a joint's range.
    """
    rise = np.tile(hold, (_RISE, 1))
    rise[:, 2] += np.linspace(0.0, action.height, _RISE)
    path = CubicSpline(np.linspace(0.0, action.height, _RISE), joint_path(rise, q_hold))
    q, qd = path(profile.height), path(profile.height, 1) * profile.height_rate[:, None]
    q_up = path(action.height)
    axes = np.eye(3)
    axes[:2, :2] = rotation_2d(yaw).T  # the object's axes in the world, a row each
    for k, axis in enumerate(axes if action.tilt > 0 else ()):
        angles = np.linspace(0.0, action.tilt, _EACH_WAY + 1)
        ways = [joint_path(_tilted(rise[-1], sign * angles[1:], axis), q_up) for sign in (-1, 1)]
        knots = np.concatenate([-angles[:0:-1], angles])
        path = CubicSpline(knots, np.concatenate([ways[0][::-1], q_up[None], ways[1]]))
        moved = (profile.angle[:, k] != 0) | (profile.rate[:, k] != 0)
        q[moved] = path(profile.angle[moved, k])
        qd[moved] = path(profile.angle[moved, k], 1) * profile.rate[moved, k, None]
    return q, qd


def _tilted(pose: np.ndarray, angles: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """A tool pose turned about an axis of the world through the TCP: x, y, z, yaw and a rotation vector, (N, 7)."""
    return np.hstack([np.tile(pose, (len(angles), 1)), np.outer(angles, axis)])
