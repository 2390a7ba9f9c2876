"""Errors of a real setup on top of exact Coulomb friction: bias, grasp offset, anisotropy, another law of friction."""

from dataclasses import replace

import numpy as np

from estimators.testing.analytic_world import HEIGHT, analytic_trial
from testbed import GRAVITY, Accelerate, ObjectModel, Rotate, Slide, Trajectory
from testbed.frames import cross_2d, move_wrench, perpendicular, rotate_wrench, rotation_2d, rotation_matrix


def biased(trajectory: Trajectory, bias: np.ndarray, stated: np.ndarray | float = 0.0) -> Trajectory:
    """With a constant error of the sensor, N and N m, (6,), and the size of it that the sensor states."""
    wrench = trajectory.wrench_on_object_world + rotate_wrench(_upright(trajectory), at_tcp(trajectory, bias)[None])
    return replace(trajectory, wrench_on_object_world=wrench, sensor_bias_std=np.broadcast_to(stated, 6))


def turns_beside(obj: ObjectModel, beside: np.ndarray | tuple[float, float], count: int = 6) -> list[Rotate]:
    """Turns there and back, each about a point that lies so far from a grasp, m, object frame; grasp after grasp."""
    grasps = [k % len(obj.shape.grasps) for k in range(count)]
    pivots = [tuple(np.add(obj.shape.grasps[g].position, beside)) for g in grasps]
    return [Rotate(g, duration=2.5, pivot=p, back=True) for g, p in zip(grasps, pivots, strict=True)]


def at_tcp(trajectory: Trajectory, bias: np.ndarray) -> np.ndarray:
    """A sensor's bias about the TCP, in the axes of the object, which the hand holds, (6,)."""
    assert trajectory.tool is not None
    first = int(np.argmax(trajectory.segment >= 0))
    to_world = rotation_matrix(trajectory.sensor_orientation[first])
    return rotate_wrench(_upright(trajectory)[first].T @ to_world, move_wrench(bias, trajectory.tool.tcp))


def held_beside(
    obj: ObjectModel, action: Rotate | Accelerate | Slide, offset: np.ndarray, **world: object
) -> Trajectory:
    """One action with the object held at its grasp point plus `offset`, m, (2,), which the hand does not know."""
    grasps = tuple(replace(g, position=g.position + offset) for g in obj.shape.grasps)
    moved = replace(obj, shape=replace(obj.shape, grasps=grasps))
    if isinstance(action, Rotate) and action.pivot is not None:  # the hand goes as it would have gone
        action = replace(action, pivot=tuple(np.add(action.pivot, offset)))
    return analytic_trial(moved, action, **world)  # pyright: ignore[reportArgumentType]


def on_anisotropic_table(obj: ObjectModel, trajectory: Trajectory, ratio: float, direction: float) -> Trajectory:
    """The trial of an object on its own weight with friction anisotropy: friction gives the pull of most power.

    `ratio` is of the least over the most friction, whose geometric mean is the object's; `direction` of the most [rad],
    world; `trajectory` the same action on an even table. The gripper is unloaded.
    """
    lever, velocity, drag = _rubbing(obj, trajectory)
    ellipse = rotation_2d(direction) * [ratio**-0.5, ratio**0.5]
    return _with_forces(trajectory, lever, drag * (_pull(velocity, ellipse) - _pull(velocity, np.eye(2))))


def on_plastic(obj: ObjectModel, trajectory: Trajectory, departure: np.ndarray) -> Trajectory:
    """The trial of an object on its own weight with friction that departs from Coulomb's law.

    `departure` is of the friction along itself, across it and around the middle of the contact, as parts of it: a row a
    sample, or one for all. The gripper or the fingertip is unloaded.
    """
    lever, velocity, drag = _rubbing(obj, trajectory)
    feet = obj.shape.friction_group >= 0
    pull = drag * _pull(velocity, np.eye(2))
    spoke = lever - lever[:, feet].mean(axis=1, keepdims=True)
    reach = np.sqrt((spoke[:, feet] ** 2).sum(axis=-1).mean())
    along, across, around = np.broadcast_to(departure, (len(lever), 3)).T[..., None, None]
    more = along * pull + across * perpendicular(pull) + around / reach * drag * perpendicular(spoke)
    return _with_forces(trajectory, lever, more)


def _rubbing(obj: ObjectModel, trajectory: Trajectory) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Places of all particles from the TCP [m] and velocities [m/s], world, (T, P, 2), and friction [N], (P, 1)."""
    shape, turn = obj.shape, _upright(trajectory)[:, :2, :2]
    drag = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0)
    arm = (turn[:, None] @ shape.particles[..., None])[..., 0]
    velocity = trajectory.object_velocity[:, None, :2] + trajectory.object_velocity[:, None, 2:] * perpendicular(arm)
    lever = arm + (trajectory.object_pose[:, :2] - trajectory.tcp_position[:, :2])[:, None]
    return lever, velocity, (drag * obj.particle_mass * GRAVITY)[:, None]


def _with_forces(trajectory: Trajectory, lever: np.ndarray, forces: np.ndarray) -> Trajectory:
    """The trial with more forces on the particles, (T, P, 2)."""
    force, torque = forces.sum(axis=1), cross_2d(lever, forces).sum(axis=1)
    wrench = np.column_stack([force, 0 * torque, HEIGHT * -perpendicular(force), torque])
    return replace(trajectory, wrench_on_object_world=trajectory.wrench_on_object_world + wrench)


def _pull(velocity: np.ndarray, ellipse: np.ndarray) -> np.ndarray:
    """Pull of unit friction: the point of the ellipse furthest along the velocity."""
    along = velocity @ ellipse
    size = np.linalg.norm(along, axis=-1, keepdims=True)
    return np.divide(along @ ellipse.T, size, out=np.zeros_like(along), where=size > 1e-9)


def _upright(trajectory: Trajectory) -> np.ndarray:
    """From object axes to the world's, (T, 3, 3)."""
    axes = np.zeros((len(trajectory.time_s), 3, 3))
    axes[:, :2, :2], axes[:, 2, 2] = rotation_2d(trajectory.object_pose[:, 2]), 1.0
    return axes
