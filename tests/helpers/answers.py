"""Trials of an object in the analytic world, their windows and estimates, and the errors of the estimates."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators import Estimate, Estimator, HiddenStates, ModelErrors, Observations, observe
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.particles.lifts import lifts_among
from estimators.posterior.in_air import InAir
from estimators.posterior.posterior import Posterior
from estimators.posterior.priors import FRICTION, FRICTION_STD, MASS_STD
from estimators.posterior.solver import solve
from estimators.posterior.unknowns import Block, Unknowns
from estimators.testing.analytic_world import accelerated, turns
from estimators.wrench.setup import stated_sizes
from testbed import MassDistribution, ObjectModel, ObjectShape, Trajectory
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors


def trials_of(obj: ObjectModel, **world: Any) -> list[Trajectory]:
    """A turn there and back and an accelerated turn about every grasp."""
    return turns(obj, **world) + accelerated(obj, **world)


def windows_of(obj: ObjectModel, trials: Sequence[Trajectory], errors: ModelErrors | None = None) -> Observations:
    """Windows of trials, at least one of which is usable."""
    windows = observe(obj.shape, trials, errors)
    assert windows is not None
    return windows


def true_values(obj: ObjectModel) -> dict[str, Tensor]:
    """True masses and frictions, by the names of the forward models' parameters."""
    return {"mass": torch.tensor(obj.truth.mass), "friction": torch.tensor(obj.truth.friction)}


def ask(obj: ObjectModel, trajectories: Sequence[Trajectory], method: Estimator | None = None) -> Estimate:
    """Estimate of `method`, or of Algorithm 1, from trials and the true weight."""
    return (method or HiddenStates()).estimate(obj.shape, obj.total_mass, trajectories, 0)


def found(answer: Estimate) -> MassDistribution:
    """Masses and frictions of an estimate with an answer."""
    assert answer.distribution is not None, answer.message
    return answer.distribution


def claimed(answer: Estimate) -> Float[np.ndarray, "n_m"]:
    """Standard errors of the masses that an estimate states [kg per particle]."""
    assert answer.covariance is not None, answer.message
    return np.sqrt(np.diag(answer.covariance))


def holds(answer: Estimate, masses: Sequence[float] | Float[np.ndarray, "n_m"], within: float = 0.0) -> bool:
    """True if the masses of all groups [kg] lie within the bounds that an estimate states, widened by `within` [kg]."""
    low, high = ([answer.diagnostics[f"{end}_{g}_kg"] for g in range(len(masses))] for end in ("least", "most"))
    return bool(np.all(np.subtract(low, within) <= masses) and np.all(masses <= np.add(high, within)))


def nad(obj: ObjectModel, answer: Estimate) -> float:
    """NAD of an estimate with an answer."""
    return normalized_absolute_difference(obj.shape, found(answer), obj.truth)


def shown_in_the_air(
    shape: ObjectShape, weight: float, trials: Sequence[Trajectory]
) -> tuple[Float[np.ndarray, "r n_m"], Float[np.ndarray, "r"]]:
    """Equations of the masses from lifts alone, by `Posterior.mass_equations`, with the stated errors."""
    lifts = lifts_among(shape, trials)
    measurements = [InAir.of(shape, trial, windows, weight) for trial, windows in lifts.items()]
    setup = SetupErrors.largest([trials[trial].setup for trial in lifts])
    blocks = {
        "mass": Block.log_normal(weight / len(shape.particles), MASS_STD, shape.n_m),
        "friction": Block.log_normal(FRICTION, FRICTION_STD, shape.n_mu, inverse=shape.n_mu > 1),
    }
    for name, size in stated_sizes(setup, ("air", "reading"), shape.n_m).items():
        if PARAMETERS[name].scope != "trial":
            blocks[name] = Block.normal(size)
    unknowns = Unknowns(blocks)
    posterior = Posterior(unknowns, measurements, solve(measurements, unknowns, unknowns.start()))
    rows, values = posterior.mass_equations()
    narrowed = posterior.explained.widening**0.5
    return narrowed * rows, narrowed * values
