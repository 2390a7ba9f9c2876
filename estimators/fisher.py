"""Fisher information of the reduced data: steady wrenches, moments of inertia about pivots, lifts, and M as weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.dynamics import ParticleModel, inertia_of
from estimators.friction_loads import LoadGroups, friction_system
from estimators.hidden_states import HiddenStatesEstimator
from estimators.identifiability import Identifiability, identifiability
from estimators.inertia import PivotInertia, slope_variance
from estimators.lifted import lift_information, lifts_among
from estimators.mass_solve import inertia_map
from estimators.observations import Observations, observe
from estimators.planned import planned_observations
from estimators.planned_lift import planned_lift
from estimators.support import GripperLoad, own_weight, rigid_loads
from testbed.actions import Action, Lift
from testbed.errors import InvalidValueError
from testbed.lift_reduction import LiftWindow
from testbed.objects import GRAVITY, MassDistribution, ObjectShape
from testbed.sensing import Sensing
from testbed.trajectory import Trajectory

SUPPORTS = ("own_weight", "rigid")


@dataclass(frozen=True)
class Question:
    """Under which support, and with which errors of model and weighing, information is counted."""

    support: str = "own_weight"
    """own_weight or rigid."""
    errors: HiddenStatesEstimator = field(default_factory=HiddenStatesEstimator)
    """Whose stated errors the data have beyond the sensor's own."""

    def __post_init__(self) -> None:
        if self.support not in SUPPORTS:
            raise InvalidValueError("support", self.support, f"one of {', '.join(SUPPORTS)}")


def expected(
    shape: ObjectShape,
    distribution: MassDistribution,
    actions: Sequence[Action],
    sensing: Sensing,
    question: Question | None = None,
) -> Identifiability:
    """What some actions would show, before any trial: at the truth, its errors are the Cramer-Rao bound.

    Args:
        shape: geometry and groups.
        distribution: masses and frictions, true or guessed; what is open hardly depends on them.
        actions: what would be done; the object is weighed besides.
        sensing: how the sensor errs.
        question: support model and stated errors.
    """
    question = question or Question()
    scale = max(sensing.scale, 1e-6)
    asked = replace(question, errors=replace(question.errors, weight_error=scale))
    windows = planned_observations(shape, actions, sensing)
    lifts = [planned_lift(action, sensing) for action in actions if isinstance(action, Lift)]
    return identifiability(shape, distribution, information_root(shape, distribution, windows, asked, lifts))


def observed(
    shape: ObjectShape,
    distribution: MassDistribution,
    trajectories: Sequence[Trajectory],
    question: Question | None = None,
) -> Identifiability:
    """What some trials show of an object with such masses and frictions."""
    windows, lifts = observe(shape, trajectories), lifts_among(shape, trajectories)
    root = information_root(shape, distribution, windows, question or Question(), lifts)
    return identifiability(shape, distribution, root)


def information_root(
    shape: ObjectShape,
    distribution: MassDistribution,
    windows: Observations | None,
    question: Question,
    lifts: Sequence[Sequence[LiftWindow]] = (),
) -> Float[np.ndarray, "R unknowns"]:
    """Derivatives of the data in particle masses and frictions, over the data's errors, (R, n_m + n_mu)."""
    count = shape.particles_per_group.astype(float)
    weighed = np.append(count, np.zeros(shape.n_mu)) / question.errors.weight_error
    rows = [weighed[None]]
    if windows is not None:
        steady, accelerated = windows.where(~windows.accelerated), windows.where(windows.accelerated)
        if len(steady):
            rows.append(_friction_rows(shape, distribution, steady, question))
        if len(accelerated):
            rows.append(_inertia_rows(shape, distribution, accelerated, question.errors.inertia_error))
    for lift in lifts:
        in_air, _ = lift_information(shape, lift, distribution.mass)
        rows.append(np.hstack([in_air, np.zeros((len(in_air), shape.n_mu))]))
    return np.vstack(rows)


def _friction_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Observations, question: Question
) -> np.ndarray:
    """Of every steady window's wrench: Q for each particle, times what the load on it owes to each mass."""
    model = ParticleModel.of(shape)
    each = LoadGroups(torch.arange(len(shape.particles)), tuple((int(p), 0) for p in range(len(shape.particles))))
    mass, friction = torch.tensor(distribution.mass), torch.tensor(distribution.friction)
    particle_mass, particle_friction = model.particle_mass(mass), model.particle_friction(friction)
    per_mass = loads_per_mass(model, shape.n_m, question.support)
    load = per_mass @ mass
    felt = windows.drag_rows(model, question.errors.pivot_error)[0] @ (particle_friction * load)
    errors = question.errors
    system = friction_system(
        model,
        each,
        replace(windows, wrench=felt),
        particle_mass,
        particle_friction,
        inertia_of(model, particle_mass),
        shape.height,
        pivot_error=errors.pivot_error,
        force_error=errors.force_error,
        torque_error=errors.torque_error,
        height_error=errors.height_error,
        lift_error=errors.lift_error,
    )
    of_friction = torch.stack([(model.friction_group == k) * load for k in range(shape.n_mu)], 1)
    return (system.q @ torch.cat([particle_friction[:, None] * per_mass, of_friction], 1)).numpy()


def loads_per_mass(model: ParticleModel, n_m: int, support: str) -> Float[Tensor, "P n_m"]:
    """Load on each particle a kg of each particle mass, N, where the gripper carries nothing."""
    none, columns = GripperLoad.none(1), []
    for group in range(n_m):
        mass = (model.mass_group == group).double()
        if support == "rigid":
            columns.append(rigid_loads(model.particles, model.contact, mass, none)[0])
        else:
            resting = own_weight(model.particles, model.mass_group, model.contact, mass, none)
            columns.append(resting.share * GRAVITY + resting.lean)
    return torch.stack(columns, 1)


def _inertia_rows(
    shape: ObjectShape, distribution: MassDistribution, windows: Observations, inertia_error: float
) -> np.ndarray:
    """Of I_j about every pivot, by the slope of torque against acceleration."""
    pivots, variance = slope_variance(windows)
    rows = inertia_map(shape, pivots)
    inertia = rows @ distribution.mass
    covariance = PivotInertia(pivots, inertia, variance + (inertia_error * inertia) ** 2, inertia_error).covariance
    whitened = np.linalg.solve(np.linalg.cholesky(covariance), rows)
    return np.hstack([whitened, np.zeros((len(rows), shape.n_mu))])
