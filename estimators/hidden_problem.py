"""What Algorithm 1 works on: one object's windows, sorted, and where it starts."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch

from estimators.dynamics import ParticleModel
from estimators.friction_loads import LoadGroups
from estimators.joint_loads import JointLoads
from estimators.mass_solve import load_jacobian
from estimators.nuisance import corrected
from estimators.observations import Observations
from testbed.objects import GRAVITY, MassDistribution, ObjectShape


@dataclass(frozen=True, eq=False)
class Problem:
    """What one call of `estimate` works on."""

    shape: ObjectShape
    weight: float
    model: ParticleModel
    groups: LoadGroups
    steady: Observations
    """Windows of constant speed."""
    accelerated: Observations
    """Windows of constant acceleration."""
    robot_seconds: float
    """What the data cost, s."""

    @staticmethod
    def of(shape: ObjectShape, weight: float, observed: Observations, seconds: float) -> Problem:
        """Windows sorted by whether they accelerate."""
        model = ParticleModel.of(shape)
        steady, accelerated = observed.where(~observed.accelerated), observed.where(observed.accelerated)
        return Problem(shape, weight, model, LoadGroups.of(model), steady, accelerated, seconds)

    def on(self, joint: JointLoads | None) -> Problem:
        """The same on a table with the grain that was found."""
        if joint is None:
            return self
        grain = torch.zeros(len(self.accelerated), 7, dtype=torch.float64)
        grain[:, 5:] = joint.grain
        return replace(self, accelerated=corrected(self.accelerated, grain))

    def loads(self, at: MassDistribution) -> np.ndarray:
        """s under masses and frictions, N."""
        return load_jacobian(self.shape, self.groups.pairs, at)[:, : self.shape.n_m] @ at.mass

    def first_guess(self) -> tuple[torch.Tensor, torch.Tensor]:
        """Uniform mass, as Algorithm 1 starts, and the largest drag felt over the weight, a lower bound of friction."""
        mass = torch.full((self.shape.n_m,), self.weight / len(self.shape.particles), dtype=torch.float64)
        drag = self.steady.wrench[:, :2].norm(dim=1).max() / (self.weight * GRAVITY)
        return mass, drag.expand(self.shape.n_mu)
