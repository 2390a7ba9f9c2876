"""The paper's metrics: NAD, and MPD by forward simulation of turns at constant speed with an estimate."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.errors import RIGID, ModelErrors
from estimators.particles.model import Inertia, ParticleModel, inertia_of, one_step, rotate, turned
from estimators.particles.support import LOADS
from estimators.particles.windows import Observations, observe
from estimators.particles.wrench import AffineLoads
from testbed.errors import InvalidValueError
from testbed.frames import perpendicular, rotation_2d
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.windows import steady_samples
from testbed.trajectory import Trajectory

CREEP = 1e-5
"""Speed over which friction changes sign [m/s]: a particle that sticks creeps by less."""
NEWTON_STEPS, HALVINGS = 30, 30
OPEN_LOOP = 1.0
"""Duration of the open-loop prediction [s]."""


@dataclass(frozen=True, eq=False)
class SteadyTurn:
    """Filtered turn: N measured states of the center of mass, and the wrench at each."""

    pose: Tensor
    """Planar pose of the center of mass, shape (N, 3)."""
    velocity: Tensor
    """Planar twist of the center of mass, shape (N, 3)."""
    wrench: Tensor
    """Planar wrench about the grasp point, world axes, shape (N, 3)."""
    grasp: Tensor
    """Grasp point [m], object frame, shape (2,)."""
    dt: float

    @staticmethod
    def of(window: Observations, trajectory: Trajectory, kept: np.ndarray, inertia: Inertia) -> SteadyTurn:
        """Turn of the samples kept in a window, for an object with that inertia."""
        measured = torch.tensor(trajectory.object_pose[kept])
        yaw, spin = measured[:, 2], window.twist[:, 2]
        turned_to = lambda v: rotate(yaw, v.expand(len(yaw), 2))  # noqa: E731
        along = window.twist[:, :2] + spin[:, None] * turned(inertia.com - window.grasp)
        return SteadyTurn(
            torch.cat([measured[:, :2] + turned_to(inertia.com), yaw[:, None]], -1),
            torch.cat([turned_to(along), spin.expand(len(yaw), 1)], -1),
            torch.cat([turned_to(window.wrench[:, :2]), window.wrench[:, 2:].expand(len(yaw), 1)], -1),
            window.grasp[0],
            float(np.median(np.diff(trajectory.time_s[kept]))),
        )

    def open_loop(self, model: ParticleModel, inertia: Inertia, friction: Float[Tensor, "P"], seconds: float) -> float:
        """Mean particle distance [m] after `seconds` of simulation from the wrench alone, at friction mu_i N_i [N]."""
        steps = min(round(seconds / self.dt), len(self.pose) - 1)
        arms = (model.particles - inertia.com).numpy()
        mass = np.array([inertia.mass, inertia.mass, inertia.about_com])
        pose, velocity = self.pose[0].numpy().copy(), self.velocity[0].numpy()
        hand = (self.grasp - inertia.com).numpy()
        for wrench in self.wrench[:steps].numpy():
            turn = rotation_2d(pose[2])
            lever = turn @ hand
            torque = wrench[2] + lever[0] * wrench[1] - lever[1] * wrench[0]
            free = velocity + self.dt * np.array([wrench[0], wrench[1], torque]) / mass
            velocity = _after_friction(mass, free, velocity, arms @ turn.T, self.dt * friction.numpy())
            pose += self.dt * velocity
        return _mean_distance(model, inertia, torch.tensor(pose), self.pose[steps])

    def stepwise(self, model: ParticleModel, inertia: Inertia, friction: Float[Tensor, "P"]) -> float:
        """Mean particle distance [m] at the end where each step starts from the measured state and steps add up."""
        drag, state = friction.expand(len(self.pose), -1), (self.pose, self.velocity)
        after = one_step(model, inertia, drag, *state, self.wrench, self.grasp, self.dt)
        end = self.pose[0] + self.dt * torch.cat([self.velocity[:1], after[:-2]]).sum(0)
        return _mean_distance(model, inertia, end, self.pose[-1])


def _after_friction(
    mass: np.ndarray, free: np.ndarray, start: np.ndarray, arms: np.ndarray, bound: np.ndarray
) -> np.ndarray:
    """Velocity after an implicit step with Coulomb friction, (3,): the minimum of the step's dissipation by Newton.

    The step is implicit since friction can stop an object within a step of the record. `mass` is (M, M, I_cm), `free`
    the velocity without friction, `arms` the particles from the center of mass [m], world axes, (P, 2), and `bound` the
    greatest friction impulse of each [N s].
    """

    def value(v: np.ndarray) -> tuple[float, np.ndarray, np.ndarray]:
        slip = v[:2] + v[2] * across
        speed = np.sqrt((slip**2).sum(axis=1) + CREEP**2)
        return 0.5 * mass @ (v - free) ** 2 + bound @ (speed - CREEP), slip, speed

    across = perpendicular(arms)
    v = start
    least, slip, speed = value(v)
    now = least
    for _ in range(NEWTON_STEPS):
        pull = bound / speed
        along = slip / speed[:, None]
        rows = (
            np.column_stack([np.ones(len(arms)), np.zeros(len(arms)), across[:, 0]]),
            np.column_stack([np.zeros(len(arms)), np.ones(len(arms)), across[:, 1]]),
        )
        same = along[:, :1] * rows[0] + along[:, 1:] * rows[1]
        gradient = mass * (v - free) + bound @ same
        hessian = np.diag(mass) + sum((r.T * pull) @ r for r in rows) - (same.T * pull) @ same
        step = -np.linalg.solve(hessian, gradient)
        for _ in range(HALVINGS):
            now, slip, speed = value(v + step)
            if now <= least:
                break
            step = step / 2
        v, least = v + step, now
        if np.abs(step).max() < 1e-13 + 1e-9 * np.abs(v).max():
            break
    return v


def _mean_distance(model: ParticleModel, inertia: Inertia, a: Tensor, b: Tensor) -> float:
    """Mean distance between the particles at two poses of the center of mass [m]."""
    arm = model.particles - inertia.com
    first, second = (pose[:2] + rotate(pose[2], arm) for pose in (a, b))
    return float((first - second).norm(dim=-1).mean())


def normalized_absolute_difference(shape: ObjectShape, estimate: MassDistribution, truth: MassDistribution) -> float:
    """NAD, eta_1: sum over particles of |m - m_g| over the true total mass; 0 is exact.

    With the right total it is twice the misplaced part of the mass, so 2 at most; with a wrong one it has no bound.

    Raises:
        InvalidValueError: masses that do not fit the shape.
    """
    for name, given in (("estimate.mass", estimate.mass), ("truth.mass", truth.mass)):
        if len(given) != shape.n_m:
            raise InvalidValueError(name, given.tolist(), f"{shape.n_m} numbers, one a mass group")
    count = shape.particles_per_group
    return float(count @ np.abs(estimate.mass - truth.mass) / (count @ truth.mass))


@dataclass(frozen=True)
class ParticleDistance:
    """MPD, eta_2 [m]: mean over turns of the mean distance between predicted and measured particles at the end."""

    open_loop: float
    """MPD after 1 s of forward simulation from the measured wrench alone."""
    turn: float
    """MPD after the whole turn, each step predicted from the measured state before it and the steps added up."""


def mean_particle_distance(
    shape: ObjectShape, estimate: MassDistribution, turns: Sequence[Trajectory], support: str = "own_weight"
) -> ParticleDistance | None:
    """MPD of an estimate on turns that it was not given; None where no turn is ok.

    As in the paper, wrench and motion are the filtered ones: constant in the object frame over a steady turn. The
    measured load on the gripper enters the loads.

    Args:
        shape: geometry and groups.
        estimate: masses and frictions.
        turns: turns at constant speed.
        support: support that the prediction assumes: own_weight, as every method does, or rigid.
    """
    usable = [turn for turn in turns if turn.ok]
    windows = observe(shape, usable, RIGID if support == "rigid" else ModelErrors())
    if windows is None:
        return None
    model = ParticleModel.of(shape)
    mass, friction = torch.tensor(estimate.mass), torch.tensor(estimate.friction)
    inertia = inertia_of(model, model.particle_mass(mass))
    loads = AffineLoads.of(shape, model, windows, LOADS[support])
    pressed = model.particle_friction(friction) * loads.at(mass).clamp(min=0)
    found = []
    for trial, trajectory in enumerate(usable):
        mine = torch.nonzero(windows.trial == trial).flatten()
        for k, kept in zip(mine, steady_samples(trajectory) if len(mine) else [], strict=True):
            turn = SteadyTurn.of(windows.where(k[None]), trajectory, kept, inertia)
            open_loop = turn.open_loop(model, inertia, pressed[k], OPEN_LOOP)
            found.append((open_loop, turn.stepwise(model, inertia, pressed[k])))
    open_loop, whole = np.mean(found, axis=0)
    return ParticleDistance(float(open_loop), float(whole))
