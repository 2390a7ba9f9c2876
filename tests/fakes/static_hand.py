"""A hand held still in many ways with a sensor on it, by the lever law alone."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.objects.model import GRAVITY
from testbed.robot.calibration.static_poses import StaticPose

DOWN = Rotation.from_euler("x", 180, degrees=True)
"""Hand pointing at the table."""
POSES = [
    DOWN * Rotation.from_euler("xyz", angles, degrees=True)
    for angles in ((0, 0, 0), (40, 0, 0), (-40, 0, 0), (0, 40, 0), (0, -40, 0), (30, 30, 0), (90, 0, 0), (0, 90, 90))
]
"""Orientations of the hand in the base frame."""
MASS, COM = 0.93, np.array([0.003, -0.002, 0.061])
"""Mass and center of the tool [kg, m], hand axes."""
BIAS = np.array([5.0, -3.0, 8.0, 0.1, 0.2, -0.3])
ERROR = np.array([0.012, 0.014, 0.011, 6e-4, 5e-4, 2e-4])
"""Standard error of a pose's mean: some seconds of an FT-300S."""


def readings(
    mount: Rotation,
    sign: int = 1,
    *,
    noise: float = 0.0,
    seed: int = 0,
    hands: Sequence[Rotation] = POSES,
    torque_sign: int = 1,
) -> list[StaticPose]:
    """Readings of a sensor.

    Args:
        mount: orientation of the sensor in the hand.
        sign: -1 for a sensor that reports what the tool does to the arm.
        noise: times ERROR.
        seed: of the noise.
        hands: orientations of the hand.
        torque_sign: as `sign`, of torque alone.
    """
    rng = np.random.default_rng(seed)
    poses = []
    for hand in hands:
        up = (hand * mount).inv().apply([0.0, 0.0, 1.0])
        force = MASS * GRAVITY * up
        torque = torque_sign * np.cross(mount.inv().apply(COM), force)
        wrench = sign * np.concatenate([force, torque]) + BIAS + noise * ERROR * rng.standard_normal(6)
        poses.append(StaticPose(hand.as_quat(scalar_first=True), wrench, ERROR))
    return poses
