"""Every particle's friction load at given masses and frictions, and what it owes to each of them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.dynamics import ParticleModel, inertia_of
from estimators.friction_loads import FrictionEquations, LoadGroups, friction_equations
from estimators.model_errors import ModelErrors
from estimators.observations import Observations
from estimators.support import GripperLoad, own_weight, rigid_loads
from testbed.objects import GRAVITY, MassDistribution, ObjectShape


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
