"""Estimates of an object's trials, and their distance from the truth."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from estimators.base import Estimate, Estimator
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.particles.lifts import lifts_among
from estimators.posterior.in_air import InAir
from estimators.posterior.posterior import Posterior
from estimators.posterior.priors import FRICTION, FRICTION_STD, MASS_STD
from estimators.posterior.solver import solve
from estimators.posterior.unknowns import Block, Unknowns
from estimators.wrench.setup import stated_sizes
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors


def ask(obj: ObjectModel, trajectories: Sequence[Trajectory], method: Estimator | None = None) -> Estimate:
    """Estimate of `method`, or of Algorithm 1, from trials and the true weight."""
    return (method or HiddenStates()).estimate(obj.shape, obj.total_mass, trajectories, 0)


def found(answer: Estimate) -> MassDistribution:
    """Masses and frictions of an estimate that has them."""
    assert answer.distribution is not None, answer.message
    return answer.distribution


def nad(obj: ObjectModel, answer: Estimate) -> float:
    """NAD of an estimate that has masses."""
    return normalized_absolute_difference(obj.shape, found(answer), obj.truth)


def shown_in_the_air(
    shape: ObjectShape, weight: float, trials: Sequence[Trajectory]
) -> tuple[Float[np.ndarray, "r n_m"], Float[np.ndarray, "r"]]:
    """Equations of the masses that lifts alone show, by `Posterior.mass_equations`, their errors as stated."""
    lifts = lifts_among(shape, trials)
    measurements = [InAir.of(shape, trial, windows, weight) for trial, windows in lifts.items()]
    setup = SetupErrors.largest([trials[trial].setup for trial in lifts])
    blocks = {
        "mass": Block.log_normal(weight / len(shape.particles), MASS_STD, shape.n_m),
        "friction": Block.log_normal(FRICTION, FRICTION_STD, shape.n_mu),
    }
    for name, size in stated_sizes(setup, ("air", "reading"), shape.n_m).items():
        if PARAMETERS[name].scope != "trial":
            blocks[name] = Block.normal(size)
    unknowns = Unknowns(blocks)
    posterior = Posterior(unknowns, measurements, solve(measurements, unknowns, unknowns.start()))
    rows, values = posterior.mass_equations()
    narrowed = posterior.explained.widening**0.5
    return narrowed * rows, narrowed * values
