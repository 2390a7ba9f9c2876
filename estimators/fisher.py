"""Fisher information of the reduced data: steady wrenches, moments of inertia about pivots, lifts, and M as weighed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from estimators.identifiability import Identifiability, identifiability
from estimators.inertia import PivotInertia, slope_variance
from estimators.lifted import lift_information, lifts_among
from estimators.mass_solve import inertia_map
from estimators.model_errors import RIGID, ModelErrors
from estimators.observations import Observations, observe
from estimators.particle_loads import ParticleLoads
from estimators.planned import planned_observations
from estimators.planned_lift import planned_lift
from testbed.actions import Action, Lift
from testbed.errors import InvalidValueError
from testbed.lift_reduction import LiftWindow
from testbed.objects import MassDistribution, ObjectShape
from testbed.sensing import Sensing
from testbed.trajectory import Trajectory

SUPPORTS = ("own_weight", "rigid")


@dataclass(frozen=True)
class Question:
    """Under which support, and with which errors of model and weighing, information is counted."""

    support: str = "own_weight"
    """own_weight or rigid."""
    errors: ModelErrors | None = None
    """Which the data have beyond the sensor's own; None is what was measured under this support."""

    def __post_init__(self) -> None:
        if self.support not in SUPPORTS:
            raise InvalidValueError("support", self.support, f"one of {', '.join(SUPPORTS)}")

    @property
    def stated(self) -> ModelErrors:
        """The errors that count."""
        return self.errors or (RIGID if self.support == "rigid" else ModelErrors())


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
    asked = replace(question, errors=replace(question.stated, weight_error=scale))
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
    windows, lifts = observe(shape, trajectories), list(lifts_among(shape, trajectories).values())
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
    weighed = np.append(count, np.zeros(shape.n_mu)) / question.stated.weight_error
    rows = [weighed[None]]
    if windows is not None:
        steady, accelerated = windows.where(~windows.accelerated), windows.where(windows.accelerated)
        if len(steady):
            loads = ParticleLoads.of(shape, distribution, question.support)
            rows.append((loads.equations(steady, question.stated).whitened().q @ loads.slopes).numpy())
        if len(accelerated):
            rows.append(_inertia_rows(shape, distribution, accelerated, question.stated.inertia_error))
    for lift in lifts:
        in_air, _ = lift_information(shape, lift, distribution.mass)
        rows.append(np.hstack([in_air, np.zeros((len(in_air), shape.n_mu))]))
    return np.vstack(rows)


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
