"""Joint posterior as an estimator of masses, frictions and every error of the setup."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from estimators.base import Estimate, weighed
from estimators.particles.lifts import lifts_among
from estimators.particles.observe import NO_DATA, NO_LINKS, ONE_BODY, observe
from estimators.posterior.in_air import InAir
from estimators.posterior.on_table import OnTable
from estimators.posterior.posterior import Posterior
from estimators.posterior.priors import priors
from estimators.posterior.scale import Scale, Weighing
from estimators.posterior.solver import Measurement, solve
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import ASSUMPTION, ERRORS, JoinedSupport
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.parameters import FULL_SCALE
from testbed.worlds.setup_errors import SetupErrors

START_FRICTION = 0.01, 2.0
"""Least and greatest friction at which a search starts."""


@dataclass(frozen=True)
class Bayes:
    """Joint posterior of masses, frictions, friction of hinges and every stated error of the setup."""

    support: JoinedSupport = "own_weight"
    """Assumed support: own_weight, rigid, or springs of unknown stiffness between the groups."""
    unknown_bias: bool = False
    """True takes the bias that the tare leaves as unknown, instead of as stated by the sensor."""

    def __post_init__(self) -> None:
        if self.support not in ASSUMPTION:
            raise InvalidValueError("Bayes.support", self.support, f"one of {', '.join(ASSUMPTION)}")
        if not isinstance(self.unknown_bias, bool):
            raise InvalidValueError("Bayes.unknown_bias", self.unknown_bias, "true or false")

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Most likely masses and frictions, with Laplace's covariance. Draws nothing: `seed` changes nothing.

        Raises:
            InvalidValueError: no weight.
        """
        begin, weight = time.perf_counter(), weighed(shape, weight)
        if self.support != "rigid" and not shape.stands_in_groups:
            return Estimate(None, "assumption_violated", ONE_BODY)
        if self.support != "own_weight" and shape.chain is not None:
            return Estimate(None, "assumption_violated", "every link of an object with hinges rests on its own weight")
        found = self.posterior(shape, weight, trajectories)
        if found is None:
            return Estimate(None, "no_data", NO_DATA if shape.chain is None else NO_LINKS)
        answer = found.estimate(shape)
        return replace(answer, assumes=ASSUMPTION[self.support], seconds=time.perf_counter() - begin)

    def posterior(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory]
    ) -> Posterior | None:
        """Posterior of an object from its trials, by these settings; None where no trial is usable."""
        found = posterior_of(shape, weight, trajectories, self.support, unknown_bias=self.unknown_bias)
        return found.leaning() if found is not None and self.support == "own_weight" else found


def posterior_of(
    shape: ObjectShape,
    weight: float | None,
    trajectories: Sequence[Trajectory],
    support: JoinedSupport = "own_weight",
    *,
    unknown_bias: bool = False,
    errors: ModelErrors | None = None,
    near: Posterior | None = None,
    rigid_share: float = 0.5,
    at: MassDistribution | None = None,
) -> Posterior | None:
    """Posterior of an object from its trials; None where no trial is usable.

    Args:
        shape: geometry and groups.
        weight: M as weighed, kg.
        trajectories: slides, turns, accelerated turns, pushes and lifts; all others are left out.
        support: support model on the table.
        unknown_bias: as in `Bayes`.
        errors: errors of the model, those of the support if left out.
        near: posterior from which the search starts: of the same trials under another support or other errors.
        rigid_share: share of springs, as in `Springs.joined`, from which the search starts.
        at: masses and frictions taken as known; only the nuisances are then estimated.

    Raises:
        InvalidValueError: no weight, or a grasp that the shape does not have.
    """
    weight = weighed(shape, weight)
    errors = errors or ERRORS[support]
    lifts = lifts_among(shape, trajectories)
    in_air = tuple(trajectories[index].setup for index in lifts)
    on_table = _on_table(shape, tuple(trajectories), in_air, support, errors, unknown_bias)
    if on_table is None:
        return None
    windows = on_table.windows
    setup = windows.setup
    unknowns = priors(shape, setup, errors, weight, on_table.trials, joined=support == "springs", lifted=bool(lifts))
    if at is not None:
        unknowns = unknowns.given(mass=torch.tensor(at.mass), friction=torch.tensor(at.friction))
    measurements: list[Measurement] = [on_table, Scale(weight, Weighing.of(shape, errors.weight_error, setup))]
    measurements += [InAir.of(shape, trial, each, weight) for trial, each in lifts.items()]
    known: dict[str, Tensor | float] = {"friction": float(np.clip(windows.drag / (weight * GRAVITY), *START_FRICTION))}
    known |= {} if near is None else near.unknowns.values(near.optimum.z)
    known["rigid_share"] = rigid_share
    start = unknowns.start(**{name: value for name, value in known.items() if name in unknowns.blocks})
    return Posterior(unknowns, measurements, solve(measurements, unknowns, start))


@lru_cache(maxsize=4)
def _on_table(
    shape: ObjectShape,
    trajectories: tuple[Trajectory, ...],
    in_air: tuple[SetupErrors, ...],
    support: JoinedSupport,
    errors: ModelErrors,
    unknown_bias: bool,
) -> OnTable | None:
    """Measurement of the trials on the table; None without any at constant speed.

    Cached, since the misfit of every method needs that of the same trials. `in_air` are the setups of the lifts, whose
    errors the trials on the table share.
    """
    windows = observe(shape, trajectories, errors)
    if windows is None or bool(windows.accelerated.all()):
        return None
    windows = replace(windows, setup=SetupErrors.largest([windows.setup, *in_air]))
    if unknown_bias:
        windows = replace(windows, bias=windows.bias + torch.tensor(FULL_SCALE**2).diag())
    return OnTable.of(shape, windows, support, errors)
