"""The paper's metrics: NAD, and MPD by forward simulation of turns at constant speed with an estimate."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.wrench.model import RIGID, Inertia, ModelErrors, ParticleModel, inertia_of, one_step, rotate, turned
from estimators.wrench.support import LOADS
from testbed.errors import InvalidValueError
from testbed.frames import perpendicular
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.windows import steady_samples
from testbed.trajectory import Trajectory

CREEP = 1e-5
"""Speed over which friction changes sign [m/s]: a particle that sticks creeps by less."""
NEWTON_STEPS, HALVINGS = 30, 30
ROUNDING = 1e-13
"""Relative rise of the dissipation that counts as rounding."""
CONVERGED = 1e-9
"""Last step of a velocity [m/s, rad/s]; the remaining error is proportional to its square over `CREEP`."""
OPEN_LOOP = 1.0
"""Time at which the open loop is evaluated in addition to its end [s]."""
FINE, COARSE = 2, 10
"""Samples per step of the open loop, up to `OPEN_LOOP` and after it; the steps are implicit."""


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
    time: Tensor
    """Time since the first state [s], shape (N,): a real record may have lost samples."""

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
            torch.tensor(trajectory.time_s[kept] - trajectory.time_s[kept[0]]),
        )

    def stepwise(self, model: ParticleModel, inertia: Inertia, friction: Float[Tensor, "P"]) -> float:
        """Mean particle distance [m] at the end where each step starts from the measured state and steps add up."""
        step = self.time.diff()[:, None]
        drag, state = friction.expand(len(step), -1), (self.pose[:-1], self.velocity[:-1])
        after = one_step(model, inertia, drag, *state, self.wrench[:-1], self.grasp, step)
        end = self.pose[0] + (step * torch.cat([self.velocity[:1], after[:-1]])).sum(0)
        return _mean_distance(model, inertia, end, self.pose[-1])


def open_loop(
    turns: Sequence[SteadyTurn], model: ParticleModel, inertia: Inertia, friction: Float[Tensor, "W P"]
) -> tuple[list[float], list[float]]:
    """Mean particle distances [m] of W turns by simulation from the wrench alone: after `OPEN_LOOP`, and at the end.

    `friction` is mu_i N_i [N] of each turn. All turns take their steps side by side.
    """
    if not turns:
        return [], []
    times = [turn.time.numpy() for turn in turns]
    last = [len(time) - 1 for time in times]
    soon = [int(np.abs(time - OPEN_LOOP).argmin()) for time in times]
    at = [np.unique(np.r_[0:near:FINE, near:end:COARSE, end]) for near, end in zip(soon, last, strict=True)]
    count = max(map(len, at)) - 1
    at = [np.pad(samples, (0, count + 1 - len(samples)), mode="edge") for samples in at]  # steps of no length
    dt = np.array([np.diff(time[samples]) for time, samples in zip(times, at, strict=True)])
    feet, hand = _Feet.of(model, inertia), np.array([(turn.grasp - inertia.com).numpy() for turn in turns])
    mass = np.array([inertia.mass, inertia.mass, inertia.about_com])
    pose, velocity = (np.array([getattr(t, name)[0].numpy() for t in turns]) for name in ("pose", "velocity"))
    wrench = np.array([t.wrench.numpy()[samples] for t, samples in zip(turns, at, strict=True)])
    # In the object's axes, where the feet stay and a steady turn keeps its velocity
    path, turn, velocity = [pose], np.zeros(len(turns)), _along(pose[:, 2], velocity)
    before = velocity
    for k in range(count):
        step, pushed = dt[:, k, None], _along(pose[:, 2], wrench[:, k])
        pushed[:, 2] += hand[:, 0] * pushed[:, 1] - hand[:, 1] * pushed[:, 0]
        free, guess, before = _along(turn, velocity) + step * pushed / mass, 2 * velocity - before, velocity
        velocity = feet.velocity_after(mass, free, guess, step * friction.numpy())
        moved = step * _along(-pose[:, 2], velocity)
        pose, turn = pose + moved, moved[:, 2]
        path.append(pose)
    reached = torch.tensor(np.array(path)).transpose(0, 1)
    near, end = (
        [
            _mean_distance(model, inertia, poses[int(np.searchsorted(samples, n))], turn.pose[n])
            for turn, poses, samples, n in zip(turns, reached, at, when, strict=True)
        ]
        for when in (soon, last)
    )
    return near, end


def _along(yaw: Float[np.ndarray, "W"], vector: Float[np.ndarray, "W 3"]) -> Float[np.ndarray, "W 3"]:
    """Planar twists or wrenches in axes turned by `yaw` [rad]."""
    c, s, (x, y, about) = np.cos(yaw), np.sin(yaw), vector.T
    return np.array([c * x + s * y, c * y - s * x, about]).T


@dataclass(frozen=True, eq=False)
class _Feet:
    """Jacobian of the velocities of P particles in the planar twist of the center of mass, object axes."""

    jacobian: Float[np.ndarray, "2P 3"]
    """Velocities along x, then along y."""
    products: Float[np.ndarray, "3P 9"]
    """Products of its rows by particle: x x, y y, and x y both ways."""

    @staticmethod
    def of(model: ParticleModel, inertia: Inertia) -> _Feet:
        """Jacobian of all particles of an object."""
        ahead, sideways = perpendicular((model.particles - inertia.com).numpy()).T
        one, none = np.ones_like(ahead), np.zeros_like(ahead)
        x, y = np.stack([one, none, ahead], 1), np.stack([none, one, sideways], 1)
        xx, yy, xy = (a[:, :, None] * b[:, None] for a, b in ((x, x), (y, y), (x, y)))
        return _Feet(np.concatenate([x, y]), np.concatenate([xx, yy, xy + xy.swapaxes(1, 2)]).reshape(-1, 9))

    def velocity_after(
        self,
        mass: Float[np.ndarray, "3"],
        free: Float[np.ndarray, "W 3"],
        start: Float[np.ndarray, "W 3"],
        bound: Float[np.ndarray, "W P"],
    ) -> Float[np.ndarray, "W 3"]:
        """Velocities after an implicit step with Coulomb friction: the minimum of each step's dissipation by Newton.

        The step is implicit since friction can stop an object within a step of the record. `mass` is (M, M, I_cm),
        `free` the velocity without friction, `start` where the search starts, and `bound` the greatest friction
        impulse of each particle [N s].
        """
        count = bound.shape[1]

        def value(v: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
            both = v @ self.jacobian.T
            x, y = both[:, :count], both[:, count:]
            speed = np.sqrt(x * x + y * y + CREEP**2)
            off = v - free
            return 0.5 * (off * off) @ mass + (bound * speed).sum(-1), x, y, speed

        v, open_ = start, np.ones((len(start), 1), dtype=bool)
        least, x, y, speed = value(v)
        for _ in range(NEWTON_STEPS):
            pull = bound / speed
            drag_x, drag_y, square = pull * x, pull * y, speed * speed
            gradient = mass * (v - free) + np.concatenate([drag_x, drag_y], 1) @ self.jacobian
            across = pull - drag_x * x / square, pull - drag_y * y / square, -drag_x * y / square
            hessian = np.diag(mass) + (np.concatenate(across, 1) @ self.products).reshape(-1, 3, 3)
            step = -np.linalg.solve(hessian, gradient[..., None])[..., 0] * open_
            open_ = np.abs(step).max(1, keepdims=True) > CONVERGED
            if not open_.any():
                return v + step
            now, x, y, speed = value(v + step)
            for _ in range(HALVINGS):
                worse = now > least * (1 + ROUNDING)
                if not worse.any():
                    break
                step = np.where(worse[:, None], step / 2, step)
                now, x, y, speed = value(v + step)
            v, least = v + step, now
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
    for name, given in (("estimate", estimate), ("truth", truth)):
        if not isinstance(given, MassDistribution):
            raise InvalidValueError(name, given, "a MassDistribution, such as `distribution` of an Estimate")
    for name, given in (("estimate.mass", estimate.mass), ("truth.mass", truth.mass)):
        if len(given) != shape.n_m:
            raise InvalidValueError(name, given.tolist(), f"{shape.n_m} numbers, one per mass group")
    count = shape.particles_per_group
    return float(count @ np.abs(estimate.mass - truth.mass) / (count @ truth.mass))


@dataclass(frozen=True)
class ParticleDistance:
    """MPD, eta_2 [m]: mean over turns of the mean distance between predicted and measured particles at the end."""

    end: float
    """MPD of the paper: after a whole turn of forward simulation from the measured wrench alone."""
    open_loop: float
    """The same after 1 s."""
    turn: float
    """After the whole turn, each step predicted from the measured state before it and the steps added up."""


def mean_particle_distance(
    shape: ObjectShape, estimate: MassDistribution, turns: Sequence[Trajectory], support: str = "own_weight"
) -> ParticleDistance | None:
    """MPD of an estimate on turns that it was not given; None where no turn is ok, and of an object with hinges.

    As in the paper, wrench and motion are the filtered ones: constant in the object frame over a steady turn. The
    measured load on the gripper enters the loads.

    Args:
        shape: geometry and groups.
        estimate: masses and frictions.
        turns: turns at constant speed.
        support: support that the prediction assumes: own_weight, as every method does, or rigid.

    Raises:
        InvalidValueError: another support.
    """
    if support not in LOADS:
        raise InvalidValueError("support", support, f"one of {', '.join(LOADS)}")
    usable = [turn for turn in turns if turn.ok]
    windows = observe(shape, usable, RIGID if support == "rigid" else ModelErrors())
    if windows is None or windows.articulated:
        return None
    model = ParticleModel.of(shape)
    mass = model.particle_mass(torch.tensor(estimate.mass))
    inertia = inertia_of(model, mass)
    loads = LOADS[support](model, mass, windows.gripper_load(model, mass, shape.height))
    pressed = model.particle_friction(torch.tensor(estimate.friction)) * loads.clamp(min=0)
    moved: list[tuple[SteadyTurn, int]] = []
    for trial, trajectory in enumerate(usable):
        mine = torch.nonzero(windows.trial == trial).flatten()
        for k, kept in zip(mine, steady_samples(trajectory) if len(mine) else [], strict=True):
            moved.append((SteadyTurn.of(windows.where(k[None]), trajectory, kept, inertia), int(k)))
    drags = pressed[[k for _, k in moved]]
    near, end = open_loop([turn for turn, _ in moved], model, inertia, drags)
    whole = [turn.stepwise(model, inertia, drag) for (turn, _), drag in zip(moved, drags, strict=True)]
    return ParticleDistance(*(float(np.mean(values)) for values in (end, near, whole)))


def hinge_columns(friction: Sequence[float], diagnostics: Mapping[str, float]) -> dict[str, Any]:
    """Columns of the friction of hinges [N m]: as estimated, its standard error, and the mean error over the mean.

    NaN of hinges that no trial shows; the mean is over the others.
    """
    if not any(name.startswith("hinge_") for name in diagnostics):
        return {"hinge_Nm": None, "hinge_error_Nm": None, "hinge_error": math.nan}
    hinges = range(len(friction))
    found, std = ([diagnostics.get(f"hinge_{h}_{unit}", math.nan) for h in hinges] for unit in ("Nm", "std_Nm"))
    true, known = np.array(friction), ~np.isnan(found)
    off = float(np.abs(np.array(found) - true)[known].mean() / true[known].mean()) if true[known].any() else math.nan
    return {"hinge_Nm": found, "hinge_error_Nm": std, "hinge_error": off}
