"""Every particle's friction load at given masses and frictions, and what it owes to each of them."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Estimate
from estimators.hidden_states.friction import FrictionEquations, LoadGroups, friction_equations, rank_of
from estimators.particles.errors import ModelErrors
from estimators.particles.model import Inertia, ParticleModel, cross, inertia_of
from estimators.particles.support import GripperLoad, own_weight, rigid_loads
from estimators.particles.windows import Observations, observe
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.sensing.windows import steady_samples
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class ParticleLoads:
    """Loads where the gripper carries nothing, under one support model."""

    model: ParticleModel
    mass: Float[Tensor, "P"]
    friction: Float[Tensor, "P"]
    load: Float[Tensor, "P"]
    """mu N of every particle, N."""
    slopes: Float[Tensor, "P unknowns"]
    """Its derivatives in particle masses and frictions, n_m + n_mu unknowns."""
    height: float
    """Of the object, m."""

    @staticmethod
    def of(shape: ObjectShape, distribution: MassDistribution, support: str) -> ParticleLoads:
        """At some masses and frictions, under own_weight or rigid."""
        model = ParticleModel.of(shape)
        mass, friction = torch.tensor(distribution.mass), torch.tensor(distribution.friction)
        of_particle = model.particle_friction(friction)
        per_mass = _loads_per_mass(model, support)
        normal = per_mass @ mass
        of_friction = torch.stack([(model.friction_group == k) * normal for k in range(shape.n_mu)], 1)
        slopes = torch.cat([of_particle[:, None] * per_mass, of_friction], 1)
        return ParticleLoads(model, model.particle_mass(mass), of_particle, of_particle * normal, slopes, shape.height)

    def equations(self, windows: Observations, errors: ModelErrors) -> FrictionEquations:
        """Eq. dvs with a column a particle, where these loads are what is felt."""
        count = len(self.load)
        each = LoadGroups(torch.arange(count), tuple((particle, 0) for particle in range(count)))
        felt = windows.drag_rows(self.model, errors.pivot_error)[0] @ self.load
        inertia = inertia_of(self.model, self.mass)
        felt_windows = replace(windows, wrench=felt)
        return friction_equations(
            self.model, each, felt_windows, self.mass, self.friction, inertia, self.height, errors
        )


def _loads_per_mass(model: ParticleModel, support: str) -> Float[Tensor, "P n_m"]:
    """Load on each particle a kg of each particle mass, N."""
    none, columns = GripperLoad.none(1), []
    for mass in model.parts:
        if support == "rigid":
            columns.append(rigid_loads(model.particles, model.contact, mass, none)[0])
        else:
            resting = own_weight(model.particles, model.mass_group, model.contact, mass, none)
            columns.append(resting.share * GRAVITY + resting.lean)
    return torch.stack(columns, 1)


STEP = 0.01
"""Step of the prediction, that of a 100 Hz record, s."""
MODEL_ERROR = 0.002
"""Error of the particle model, as a part of the largest force and torque: under weighting "covariance"."""
Weighting = Literal["velocity", "covariance"]


LoadsOf = Callable[[ParticleModel, Tensor, GripperLoad], Tensor]
"""A support model: particle masses, kg, (P,), and what the gripper carries to loads, N, (K, P)."""


def own_weight_loads(model: ParticleModel, mass: Tensor, load: GripperLoad) -> Tensor:
    """Every mass group on its own weight."""
    return own_weight(model.particles, model.mass_group, model.contact, mass, load).loads(load)


@dataclass(frozen=True, eq=False)
class AffineLoads:
    """Normal load of every particle in every window, affine in the masses: weight, and what the gripper presses."""

    per_mass: Float[Tensor, "K P n_m"]
    """N a kg of each particle mass."""
    carried: Float[Tensor, "K P"]
    """N."""

    @staticmethod
    def of(
        shape: ObjectShape, model: ParticleModel, windows: Observations, loads_of: LoadsOf = own_weight_loads
    ) -> AffineLoads:
        """A support model's loads, probed with one particle mass of 2 kg among ones."""

        def loads(mass: Tensor) -> Tensor:
            particle_mass = model.particle_mass(mass)
            return loads_of(model, particle_mass, windows.gripper_load(inertia_of(model, particle_mass), shape.height))

        ones = torch.ones(shape.n_m, dtype=torch.float64)
        base = loads(ones)
        per_mass = torch.stack([loads(ones + one) - base for one in torch.diag(ones)], -1)
        return AffineLoads(per_mass, base - per_mass.sum(-1))

    def at(self, mass: Float[Tensor, "... n_m"]) -> Float[Tensor, "... K P"]:
        """Loads under candidates' masses, N."""
        flat = mass @ self.per_mass.flatten(0, 1).T
        return flat.unflatten(-1, self.carried.shape) + self.carried


@dataclass(frozen=True, eq=False)
class WrenchModel:
    """Wrench that the measured motion takes, (f_x, f_y, torque about the grasp point), bilinear in mass and friction.

    wrench = inertial m + sum_k mu_k (weighed_k m + carried_k).
    """

    inertial: Float[Tensor, "K 3 n_m"]
    """Of the motion itself, a kg of each particle mass."""
    weighed: Float[Tensor, "n_mu K 3 n_m"]
    """Drag of a friction of 1 under the weight of the masses."""
    carried: Float[Tensor, "n_mu K 3"]
    """Drag of a friction of 1 under what the gripper was measured to press."""

    @staticmethod
    def of(model: ParticleModel, windows: Observations, loads: AffineLoads, pivot_error: float) -> WrenchModel:
        """The model of every window."""
        rows, _ = windows.drag_rows(model, pivot_error)
        rubbing = [rows * (model.friction_group == k) for k in range(int(model.friction_group.max()) + 1)]
        spins = windows.lever(model).square().sum(-1) + model.cell**2 / 6
        moves = []
        for mass in model.parts:
            moved = windows.inertial_wrench(inertia_of(model, mass))
            moved[:, 2] += (mass * spins).sum(-1) * windows.acceleration[:, 2]
            moves.append(moved)
        weighed = torch.stack([part @ loads.per_mass for part in rubbing])
        carried = torch.stack([(part @ loads.carried[..., None])[..., 0] for part in rubbing])
        return WrenchModel(torch.stack(moves, -1), weighed, carried)

    def wrench(self, mass: Float[Tensor, "... n_m"], friction: Float[Tensor, "... n_mu"]) -> Float[Tensor, "... K 3"]:
        """Predicted wrench of the gripper on the object, N and N m."""
        windows = self.inertial.shape[:2]
        per_mass = mass @ self.inertial.flatten(0, 1).T
        dragged = torch.einsum("kwm,...m->...kw", self.weighed.flatten(1, 2), mass) + self.carried.flatten(1, 2)
        return (per_mass + (friction[..., None, :] @ dragged)[..., 0, :]).unflatten(-1, windows)


@dataclass(frozen=True, eq=False)
class Problem:
    """What a search works on: one object's windows, and whether M is known."""

    shape: ObjectShape
    model: ParticleModel
    windows: Observations
    loads: AffineLoads
    wrenches: WrenchModel
    weight: float | None
    """M, kg, or None where the method is not given it."""
    whiten: Tensor
    """Takes wrench residuals to unit variance, (3 K, 3 K)."""

    @staticmethod
    def of(
        shape: ObjectShape,
        weight: float | None,
        trajectories: Sequence[Trajectory],
        *,
        use_weight: bool,
        pivot_error: float,
    ) -> Problem | Estimate:
        """The problem, or the answer that says why there is none.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        if use_weight and not (weight is not None and np.isfinite(weight) and weight > 0):
            raise InvalidValueError("weight", weight, "M as weighed, a finite number > 0, kg, or use_weight = false")
        windows = observe(shape, trajectories)
        if windows is None or bool(windows.accelerated.all()):
            return Estimate(None, "no_data", "no trajectory with status ok that slides or turns at constant speed")
        model = ParticleModel.of(shape)
        groups = LoadGroups.of(model)
        steady = windows.where(~windows.accelerated)
        seen = rank_of(groups.gather(steady.drag_rows(model, pivot_error)[0]).flatten(0, 1).numpy())
        if seen < len(groups.pairs):
            why = f"rank(Q) is {seen} and {len(groups.pairs)} friction loads are unknown: turn about more points"
            return Estimate(None, "underdetermined", why)
        loads = AffineLoads.of(shape, model, windows)
        wrenches = WrenchModel.of(model, windows, loads, pivot_error)
        return Problem(shape, model, windows, loads, wrenches, weight if use_weight else None, _whitening(windows))

    @property
    def per_group(self) -> Float[Tensor, "n_m"]:
        """Particles in each mass group."""
        return torch.tensor(self.shape.particles_per_group, dtype=torch.float64)

    @property
    def drag(self) -> float:
        """Largest force felt at constant speed, N: a lower bound of mu M g."""
        return float(self.windows.wrench[~self.windows.accelerated, :2].norm(dim=1).max())

    @property
    def scale_known(self) -> bool:
        """Whether mass and friction can be told apart: by M, or by an acceleration."""
        return self.weight is not None or bool(self.windows.accelerated.any())

    def typical_mass(self, friction: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Mean particle mass: M where known, else what explains the largest drag at that friction, kg."""
        count = len(self.shape.particles)
        if self.weight is not None:
            return torch.full_like(friction, self.weight / count)
        return self.drag / (friction * GRAVITY * count)

    def inertia(self, mass: Float[Tensor, "... n_m"]) -> Inertia:
        """M, c and I_cm of candidates."""
        return inertia_of(self.model, self.model.particle_mass(mass))

    def loss(
        self, mass: Float[Tensor, "... n_m"], friction: Float[Tensor, "... n_mu"], weighting: Weighting = "velocity"
    ) -> Float[Tensor, "..."]:
        """Mean over windows of |v_predicted - v_measured|^2 one step on (Eq. problem), or of the whitened error."""
        missing = self.windows.wrench - self.wrenches.wrench(mass, friction)
        if weighting == "covariance":
            return (missing.flatten(-2) @ self.whiten.T).square().mean(-1)
        along, spin = self._missing_acceleration(mass, missing)
        return STEP**2 * (along.square().sum(-1) + spin.square()).mean(-1)

    def residuals(
        self, mass: Float[Tensor, "n_m"], friction: Float[Tensor, "n_mu"], weighting: Weighting
    ) -> Float[Tensor, "3K"]:
        """What `loss` is the sum of the squares of."""
        missing = self.windows.wrench - self.wrenches.wrench(mass, friction)
        if weighting == "covariance":
            return (missing.flatten(-2) @ self.whiten.T) / math.sqrt(missing.numel())
        along, spin = self._missing_acceleration(mass, missing)
        return STEP / math.sqrt(len(self.windows)) * torch.cat([along.flatten(), spin])

    def _missing_acceleration(self, mass: Tensor, missing: Float[Tensor, "... K 3"]) -> tuple[Tensor, Tensor]:
        """Of the centre of mass and of the turn, that what is missing would cause, (..., K, 2) and (..., K)."""
        inertia = self.inertia(mass)
        arm = inertia.com[..., None, :] - self.windows.grasp
        spin = (missing[..., 2] - cross(arm, missing[..., :2])) / inertia.about_com[..., None]
        return missing[..., :2] / inertia.mass[..., None, None], spin


def _whitening(windows: Observations) -> Tensor:
    """Inverse root of the wrenches' covariance; windows of a trial share their bias."""
    size = torch.stack([windows.wrench[:, :2].norm(dim=1).max()] * 2 + [windows.wrench[:, 2].abs().max()])
    within = windows.covariance + torch.diag_embed((MODEL_ERROR * size).square() + 1e-12)
    count = 3 * len(windows)
    shared = windows.shared_covariance().reshape(count, count)
    return torch.linalg.inv(torch.linalg.cholesky(torch.block_diag(*within) + shared))


PIVOT_ERROR = 2e-4
"""How well the centre of a turn is taken to be known, m; as the estimators take it."""


def predicted_wrenches(
    shape: ObjectShape, distribution: MassDistribution, trajectories: Sequence[Trajectory]
) -> list[Float[np.ndarray, "T 3"]]:
    """Force x, y (N) and torque about the grasp point (N m), object axes, that the measured motion takes.

    Every mass group rests on its own weight, and on what the gripper was measured to press or lift.

    Args:
        shape: geometry.
        distribution: the truth, or an answer.
        trajectories: of one object; what is left out of estimates is NaN, as is all outside steady stretches.
    """
    predicted = [np.full((len(t.time_s), 3), np.nan) for t in trajectories]
    windows = observe(shape, trajectories)
    if windows is None:
        return predicted
    model = ParticleModel.of(shape)
    wrenches = WrenchModel.of(model, windows, AffineLoads.of(shape, model, windows), PIVOT_ERROR).wrench(
        torch.tensor(distribution.mass), torch.tensor(distribution.friction)
    )
    for index in sorted(set(windows.trial.tolist())):
        rows = wrenches[windows.trial == index].numpy()
        for kept, row in zip(steady_samples(trajectories[index]), rows, strict=True):
            predicted[index][kept] = row
    return predicted
