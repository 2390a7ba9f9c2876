"""The loss of Eq. problem over masses and frictions, on steady windows: what the baselines minimize."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Estimate
from estimators.particles.friction_system import LoadGroups, rank_of
from estimators.particles.model import Inertia, ParticleModel, cross, inertia_of
from estimators.particles.windows import Observations, observe
from estimators.particles.wrench import AffineLoads, WrenchModel
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.trajectory import Trajectory

STEP = 0.01
"""Step of the prediction [s], that of a 100 Hz record."""
MODEL_ERROR = 0.002
"""Error of the particle model, as a part of the largest force and torque: under weighting "covariance"."""
Weighting = Literal["velocity", "covariance"]


@dataclass(frozen=True, eq=False)
class Problem:
    """Data of a search: the windows of one object, and M if the search gets it."""

    shape: ObjectShape
    model: ParticleModel
    windows: Observations
    loads: AffineLoads
    wrenches: WrenchModel
    weight: float | None
    """M [kg], or None if the method does not get it."""
    whiten: Tensor
    """Map of wrench residuals to unit variance, shape (3 K, 3 K)."""

    @staticmethod
    def of(
        shape: ObjectShape,
        weight: float | None,
        trajectories: Sequence[Trajectory],
        *,
        use_weight: bool,
        pivot_error: float,
    ) -> Problem | Estimate:
        """The problem, or the estimate that says why there is none.

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
        seen = rank_of(groups.gather(steady.drag_rows(model, pivot_error)).flatten(0, 1).numpy())
        if seen < len(groups.pairs):
            why = f"rank(Q) is {seen} and {len(groups.pairs)} friction loads are unknown: turn about more points"
            return Estimate(None, "underdetermined", why)
        loads = AffineLoads.of(shape, model, windows)
        wrenches = WrenchModel.of(model, windows, loads, pivot_error)
        return Problem(shape, model, windows, loads, wrenches, weight if use_weight else None, _whitening(windows))

    @staticmethod
    def stacked(draws: Sequence[Problem]) -> Problem:
        """Problems of D draws of one object with the same `layout`, for `loss` at candidates (D, S, ...)."""
        return replace(
            draws[0],
            windows=Observations.stacked([draw.windows for draw in draws]),
            loads=AffineLoads.stacked([draw.loads for draw in draws]),
            wrenches=WrenchModel.stacked([draw.wrenches for draw in draws]),
            whiten=torch.stack([draw.whiten for draw in draws]),
        )

    @property
    def layout(self) -> tuple[float, ...]:
        """Trial of each window, and the sign of its acceleration: problems with equal ones can be stacked."""
        w = self.windows
        return tuple([*w.trial.tolist(), *torch.where(w.accelerated, w.acceleration[:, 2].sign(), 2.0).tolist()])

    @property
    def per_group(self) -> Float[Tensor, "n_m"]:
        """Number of particles in each mass group."""
        return torch.tensor(self.shape.particles_per_group, dtype=torch.float64)

    @property
    def scale_known(self) -> bool:
        """True if M or an acceleration separates mass from friction."""
        return self.weight is not None or bool(self.windows.accelerated.any())

    def typical_mass(self, friction: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Mean particle mass [kg]: by M if known, else by the largest drag at that friction."""
        count = len(self.shape.particles)
        if self.weight is not None:
            return torch.full_like(friction, self.weight / count)
        return self.windows.drag / (friction * GRAVITY * count)

    def inertia(self, mass: Float[Tensor, "... n_m"]) -> Inertia:
        """M, c and I_cm of candidates."""
        return inertia_of(self.model, self.model.particle_mass(mass))

    def loss(
        self, mass: Float[Tensor, "... n_m"], friction: Float[Tensor, "... n_mu"], weighting: Weighting = "velocity"
    ) -> Float[Tensor, "..."]:
        """Mean over windows of |v_predicted - v_measured|^2 one step on (Eq. problem), or of the whitened error."""
        missing = self.windows.wrench - self.wrenches.wrench(mass, friction)
        if weighting == "covariance":
            return (missing.flatten(-2) @ self.whiten.mT).square().mean(-1)
        along, spin = self._missing_acceleration(mass, missing)
        return STEP**2 * (along.square().sum(-1) + spin.square()).mean(-1)

    def residuals(
        self, mass: Float[Tensor, "n_m"], friction: Float[Tensor, "n_mu"], weighting: Weighting
    ) -> Float[Tensor, "3K"]:
        """Residuals whose squares sum to `loss`."""
        missing = self.windows.wrench - self.wrenches.wrench(mass, friction)
        if weighting == "covariance":
            return (missing.flatten(-2) @ self.whiten.T) / math.sqrt(missing.numel())
        along, spin = self._missing_acceleration(mass, missing)
        return STEP / math.sqrt(len(self.windows)) * torch.cat([along.flatten(), spin])

    def _missing_acceleration(self, mass: Tensor, missing: Float[Tensor, "... K 3"]) -> tuple[Tensor, Tensor]:
        """Acceleration of the center of mass and of the turn by a missing wrench, shapes (..., K, 2) and (..., K)."""
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
