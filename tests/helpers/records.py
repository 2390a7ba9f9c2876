"""Trajectories written by hand, so that tests of the record need no physics."""

from typing import Any

import numpy as np
from numpy.polynomial import Polynomial
from scipy.signal import lfilter
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import DOWN, RATE, TOOL, record
from testbed import GRAVITY, Sensing, Trajectory
from testbed.frames import perpendicular, pose_from_point, rotation_2d


def series_of(trajectory: Trajectory, rows: slice | np.ndarray = slice(None)) -> dict[str, np.ndarray]:
    """Copies of all arrays along the time of a trajectory, or of some of their rows."""
    along, count = vars(trajectory).items(), trajectory.time_s.shape
    return {name: np.array(values[rows]) for name, values in along if np.shape(values)[:1] == count}


def turn_record(
    wrench_object: np.ndarray,
    *,
    grasp: np.ndarray,
    pivot: np.ndarray,
    start: float = 0.3,
    speed: float = 0.5,
    acceleration: float = 0.0,
    count: int = 400,
    **changes: Any,
) -> Trajectory:
    """A turn under a wrench about the TCP in object axes, (6,) or (T, 6), of `count` samples.

    It is held at `grasp` and turned about `pivot` [m], object frame, which rests at (0.4, 0.1) in the world; yaw [rad],
    turn rate [rad/s] and acceleration are those at the start. `changes` are other fields of the record.
    """
    time = np.arange(count) / RATE
    yaw = start + speed * time + acceleration * time**2 / 2
    rate = speed + acceleration * time
    center = np.array([0.4, 0.1])
    turn = rotation_2d(yaw)
    hand, origin = turn @ (grasp - pivot), turn @ -pivot
    by_sample = np.broadcast_to(wrench_object, (count, 6))
    world = np.array(by_sample)
    for part in (slice(0, 2), slice(3, 5)):
        world[:, part] = np.einsum("nij,nj->ni", turn, by_sample[:, part])
    still = np.zeros((count, 2))
    return record(
        count,
        tare=0,
        time_s=time,
        object_pose=pose_from_point(center, pivot, yaw),
        object_velocity=np.column_stack([rate[:, None] * perpendicular(origin), rate]),
        tcp_position=np.column_stack([center + hand, np.full(count, 0.015)]),
        tcp_velocity=np.column_stack([rate[:, None] * perpendicular(hand), still, still[:, 0], rate]),
        wrench_on_object_world=world,
        **changes,
    )


def moving_hand(
    start: Rotation = DOWN,
    axis: tuple[float, float, float] = (0.0, 0.0, 1.0),
    wrench_world: np.ndarray | None = None,
    count: int = 200,
) -> Trajectory:
    """A hand that turns about `axis` at a growing rate while it is accelerated in space.

    The sensor record is Newton's and Euler's, written in world axes; `wrench_world` is done to the object at the TCP
    after the tare.
    """
    time = np.arange(count) / RATE
    unit = np.asarray(axis) / np.linalg.norm(axis)
    # rates are quadratic in time, so that differentiation by a local parabola is exact
    angle, rate, rate_slope = (Polynomial([0, 0.4, 0.35, 0.3]).deriv(i)(time) for i in range(3))
    turned = Rotation.from_rotvec(angle[:, None] * unit) * start
    to_world = turned.as_matrix()
    spin, spin_slope = rate[:, None] * unit, rate_slope[:, None] * unit
    velocity = np.outer(time, [0.3, -0.2, 0.1]) + np.outer(time**2, [-0.1, 0.2, 0.3]) + [0.05, 0.0, -0.02]
    acceleration = np.outer(np.ones(count), [0.3, -0.2, 0.1]) + np.outer(2 * time, [-0.1, 0.2, 0.3])
    arm = to_world @ (TOOL.com - TOOL.tcp)
    com_acceleration = acceleration + np.cross(spin_slope, arm) + np.cross(spin, np.cross(spin, arm))
    force = TOOL.mass * (com_acceleration + np.array([0, 0, GRAVITY]))
    inertia = to_world @ TOOL.inertia @ to_world.transpose(0, 2, 1)
    momentum, momentum_slope = (np.einsum("nij,nj->ni", inertia, x) for x in (spin, spin_slope))
    torque = np.cross(to_world @ TOOL.com, force) + momentum_slope + np.cross(spin, momentum)
    if wrench_world is not None:
        on_object = np.where(np.arange(count)[:, None] >= 100, wrench_world, 0.0)
        force = force + on_object[:, :3]
        torque = torque + on_object[:, 3:] + np.cross(to_world @ TOOL.tcp, on_object[:, :3])
    from_world = to_world.transpose(0, 2, 1)
    return record(
        count,
        time_s=time,
        tcp_velocity=np.hstack([velocity, spin]),
        object_velocity=np.column_stack([velocity[:, :2], spin[:, 2]]),
        sensor_orientation=turned.as_quat(scalar_first=True),
        sensor_wrench=np.hstack([np.einsum("nij,nj->ni", from_world, part) for part in (force, torque)]),
    )


def coloured_noise(count: int, columns: int, lag1: float, rng: np.random.Generator) -> np.ndarray:
    """Stationary first-order autoregressive noise of unit variance, (count, columns)."""
    noise = rng.standard_normal((count, columns))
    noise[1:] *= np.sqrt(1 - lag1**2)
    return np.asarray(lfilter([1.0], [1.0, -lag1], noise, axis=0))


NOISY = Sensing("noisy", (0.1, 0.2, 0.3), (0.01, 0.02, 0.03), lag1=0.4)
"""Coloured noise and nothing else."""
