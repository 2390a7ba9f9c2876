"""Lift of an object, particle by particle by Newton's law alone, without a simulator."""

import numpy as np
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import DOWN, HEIGHT, RATE, TOOL, record
from testbed import GRAVITY, Lift, ObjectModel, Phase, Trajectory
from testbed.frames import move_wrench, rotate_wrench

BIAS = np.array([0.05, 0.05, 0.05, 0.003, 0.003, 0.003])
"""Left after the tare, one standard deviation, N and N m, sensor axes."""
NOISE = np.array([0.08, 0.08, 0.07, 0.003, 0.003, 0.001])
"""A sample's."""


def lifted(
    obj: ObjectModel,
    action: Lift,
    *,
    offset: tuple[float, float, float] = (0.0, 0.0, 0.0),
    tilt: float = 0.0,
    errors: float = 0.0,
    seed: int = 0,
) -> Trajectory:
    """Record of a lift, with `errors` times BIAS and NOISE.

    `offset` is the object's in the grip [m], object axes, `tilt` that of table and robot about x [rad].
    """
    shape, still = obj.shape, 80
    profile = action.sampled(1 / RATE)
    count = still + len(profile.height)
    yaw = 0.3
    rest = [(still, 0), (0, 0)]
    angle, rate, slope = (np.pad(v, rest) for v in (profile.angle, profile.rate, profile.acceleration))
    orientation = Rotation.from_euler("z", yaw) * Rotation.from_rotvec(angle)
    rise, rise_rate = (np.pad(v, rest[0]) for v in (profile.height, profile.height_rate))
    upwards = orientation.inv().apply(Rotation.from_rotvec([tilt, 0.0, 0.0]).apply([0.0, 0.0, GRAVITY]))

    # each particle a brick of eight corners' worth: points at its half diagonals over the square root of three
    lever = np.column_stack([shape.particles - shape.grasps[action.grasp].position, np.zeros(len(shape.particles))])
    lever[:, 2] = shape.height / 2 - HEIGHT
    signs = np.array([[a, b, c] for a in (-1, 1) for b in (-1, 1) for c in (-1, 1)])
    corner = signs * np.array([shape.cell, shape.cell, shape.height]) / 2 / np.sqrt(3)
    points = (lever[:, None] + corner).reshape(-1, 3) + offset
    mass = np.repeat(obj.particle_mass / 8, 8)
    acceleration = upwards[:, None] + np.cross(slope[:, None], points)
    acceleration += np.cross(rate[:, None], np.cross(rate[:, None], points))
    force = mass[:, None] * acceleration
    wrench = np.hstack([force.sum(axis=1), np.cross(points, force).sum(axis=1)])

    rng = np.random.default_rng(seed)
    off = errors * (NOISE * rng.standard_normal((count, 6)) + BIAS * rng.standard_normal(6))
    sensor = orientation * Rotation.from_euler("z", 0.7) * DOWN
    phase = np.full(count, Phase.SETTLE)
    phase[: still // 2] = Phase.TARE
    segment = np.concatenate([np.full(still, -1), profile.segment])
    phase[still:] = np.where(profile.segment >= 0, Phase.STEADY, Phase.RAMP)
    world = rotate_wrench(orientation.as_matrix(), wrench)
    world += rotate_wrench(sensor.as_matrix(), move_wrench(off, TOOL.tcp))
    zero = np.zeros((count, 2))
    return record(
        count,
        action=action,
        phase=phase,
        segment=segment,
        object_pose=np.column_stack([zero, np.full(count, yaw)]),
        tcp_position=np.column_stack([zero, HEIGHT + rise]),
        tcp_velocity=np.column_stack([zero, rise_rate, orientation.apply(rate)]),
        sensor_orientation=sensor.as_quat(scalar_first=True),
        sensor_wrench=errors * NOISE * rng.standard_normal((count, 6)),
        wrench_on_object_world=world,
        sensor_bias_std=errors * BIAS,
    )
