"""Wrenches of friction and inertia under candidate masses and frictions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.func import vmap

from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import LOADS, LoadsOf, own_weight_loads
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.compensation import tare_time
from testbed.sensing.push_windows import window_samples
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class AffineLoads:
    """Normal load of every particle in every window: linear in the masses, plus the gripper's load."""

    per_mass: Float[Tensor, "K P n_m"]
    """Load per kg of each group's particle mass, N/kg."""
    carried: Float[Tensor, "K P"]
    """Load of the gripper, N."""

    @staticmethod
    def of(
        shape: ObjectShape, model: ParticleModel, windows: Observations, loads_of: LoadsOf = own_weight_loads
    ) -> AffineLoads:
        """Loads of a support model, by evaluating it at particle masses of 1 kg, with 2 kg in one group at a time."""

        def loads(mass: Tensor) -> Tensor:
            particle_mass = model.particle_mass(mass)
            return loads_of(model, particle_mass, windows.gripper_load(model, particle_mass, shape.height))

        ones = torch.ones(shape.n_m, dtype=torch.float64)
        base = loads(ones)
        per_mass = vmap(loads, out_dims=-1)(ones + torch.diag(ones)) - base[..., None]
        return AffineLoads(per_mass, base - per_mass.sum(-1))

    @staticmethod
    def stacked(draws: Sequence[AffineLoads]) -> AffineLoads:
        """Loads of D draws, for candidates (D, S, n_m)."""
        per_mass = torch.stack([draw.per_mass for draw in draws])
        return AffineLoads(per_mass, torch.stack([draw.carried for draw in draws])[:, None])

    def at(self, mass: Float[Tensor, "... n_m"]) -> Float[Tensor, "... K P"]:
        """Loads under candidate masses, N."""
        flat = mass @ self.per_mass.flatten(-3, -2).mT
        return flat.unflatten(-1, self.carried.shape[-2:]) + self.carried


@dataclass(frozen=True, eq=False)
class WrenchModel:
    """Wrench of the measured motion, r components in K windows, bilinear in mass and friction.

    Planar, (f_x, f_y, torque about the grasp point), or all six components of a gripper without load.

    wrench = inertial m + sum_k mu_k (weighed_k m + carried_k).
    """

    inertial: Float[Tensor, "K r n_m"]
    """Wrench of inertia per kg of each group's particle mass."""
    weighed: Float[Tensor, "n_mu K r n_m"]
    """Drag of a friction of 1 under the weight of the masses."""
    carried: Float[Tensor, "n_mu K r"]
    """Drag of a friction of 1 under the gripper's measured load."""

    @staticmethod
    def of(model: ParticleModel, windows: Observations, loads: AffineLoads, pivot_error: float) -> WrenchModel:
        """The model of every window."""
        inertial = windows.table(model, pivot_error).inertial_rows() @ model.parts.T
        return WrenchModel.by_rows(model, inertial, windows.drag_rows(model, pivot_error), loads)

    @staticmethod
    def by_rows(
        model: ParticleModel, inertial: Float[Tensor, "K r n_m"], rows: Float[Tensor, "K r P"], loads: AffineLoads
    ) -> WrenchModel:
        """The model from its rows per kg of particle mass, and per N of each particle's friction."""
        of_group = [rows * (model.friction_group == k) for k in range(int(model.friction_group.max()) + 1)]
        weighed = torch.stack([part @ loads.per_mass for part in of_group])
        carried = torch.stack([(part @ loads.carried[..., None])[..., 0] for part in of_group])
        return WrenchModel(inertial, weighed, carried)

    @staticmethod
    def stacked(draws: Sequence[WrenchModel]) -> WrenchModel:
        """Models of D draws, for candidates (D, S, n_m) and (D, S, n_mu)."""
        inertial, weighed = (torch.stack([getattr(draw, part) for draw in draws]) for part in ("inertial", "weighed"))
        return WrenchModel(inertial, weighed, torch.stack([draw.carried for draw in draws])[:, None])

    def wrench(self, mass: Float[Tensor, "... n_m"], friction: Float[Tensor, "... n_mu"]) -> Float[Tensor, "... K r"]:
        """Predicted wrench of the gripper on the object, N and N m."""
        carried = self.carried.flatten(-2)
        per_mass = mass @ self.inertial.flatten(-3, -2).mT
        dragged = (mass @ self.weighed.flatten(-4, -2).mT).unflatten(-1, carried.shape[-2:]) + carried
        return (per_mass + (friction[..., None, :] @ dragged)[..., 0, :]).unflatten(-1, self.carried.shape[-2:])


def predicted_wrenches(
    shape: ObjectShape, distribution: MassDistribution, trajectories: Sequence[Trajectory]
) -> list[Float[np.ndarray, "T 3"]]:
    """Force x, y (N) and torque about the grasp point (N m) of the measured motion, object axes.

    Every mass group rests on its own weight, an object with a part in the air as one rigid body; loads include the
    measured load of the gripper. NaN outside steady stretches and in trajectories that estimates leave out.

    Args:
        shape: geometry.
        distribution: masses and frictions, true or estimated.
        trajectories: trajectories of one object.
    """
    predicted = [np.full((len(t.time_s), 3), np.nan) for t in trajectories]
    windows = observe(shape, trajectories)
    if windows is None:
        return predicted
    model = ParticleModel.of(shape)
    loads = AffineLoads.of(shape, model, windows, LOADS["own_weight" if shape.stands_in_groups else "rigid"])
    wrenches = WrenchModel.of(model, windows, loads, ModelErrors.pivot_error).wrench(
        torch.tensor(distribution.mass), torch.tensor(distribution.friction)
    )
    for index in sorted(set(windows.trial.tolist())):
        rows = wrenches[windows.trial == index].numpy()
        trajectory = trajectories[index]
        if windows.articulated:
            since = trajectory.time_s - tare_time(trajectory)
            for (begin, end), row in zip(windows.since_tare[windows.trial == index].tolist(), rows, strict=True):
                predicted[index][(since > begin - 1e-9) & (since < end + 1e-9)] = row
            continue
        for kept, row in zip(window_samples(trajectory), rows, strict=True):
            predicted[index][kept] = row
    return predicted
