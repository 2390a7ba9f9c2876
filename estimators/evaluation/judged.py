"""Answer judged by its misfit: the one rule for the status of every method, heft's own and others'."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from estimators.base import Estimate
from estimators.particles.misfit import Misfit
from estimators.posterior.estimator import posterior_of
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import ASSUMPTION, SupportModel
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory

SAME_WEIGHT = 0.01
"""Part of M within which masses count as weighed: then the search is no cause of another inertia."""
MANY = 1_000_000
"""Degrees of freedom of a misfit whose method does not state them: such a misfit is no chance."""


def judged(answer: Estimate, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory]) -> Estimate:
    """The answer with its misfit, and `unexplained` in place of `ok` where its masses do not explain the trials.

    A misfit that the method itself states counts: it may know of more than masses and friction. Otherwise it is
    computed on the support that `assumes` names, or on the one that fits better. Any other status stays.

    Args:
        answer: answer of a method.
        shape: geometry and groups.
        weight: M as weighed, kg, or None.
        trajectories: trials that the method was given.
    """
    if answer.distribution is None:
        return answer
    numbers, stated = answer.diagnostics, answer.diagnostics.get("misfit", math.nan)
    if math.isnan(stated):
        named: list[SupportModel] = [support for support, words in ASSUMPTION.items() if words == answer.assumes]
        each = [_measured(support, shape, weight, trajectories, answer.distribution) for support in named or ASSUMPTION]
        found = min(filter(None, each), key=lambda misfit: misfit.value, default=None)
        if found is None:
            return answer
        numbers = numbers | found.diagnostics
    else:
        found = Misfit(stated, int(numbers.get("misfit_freedom", MANY)))
    if answer.status != "ok" or found.explains:
        return replace(answer, diagnostics=numbers)
    message = "; ".join(filter(None, [answer.message, found.reason]))
    return replace(answer, status=found.status, message=message, diagnostics=numbers)


def _measured(
    support: SupportModel,
    shape: ObjectShape,
    weight: float | None,
    trajectories: Sequence[Trajectory],
    at: MassDistribution,
) -> Misfit | None:
    """Misfit of masses and frictions on one support; None on one that the object cannot have, or without windows."""
    if (support == "own_weight" and not shape.stands_in_groups) or (support == "rigid" and shape.chain is not None):
        return None
    return misfit_on(support, shape, weight, trajectories, at)


def misfit_on(
    support: SupportModel,
    shape: ObjectShape,
    weight: float | None,
    trajectories: Sequence[Trajectory],
    at: MassDistribution,
    errors: ModelErrors | None = None,
) -> Misfit | None:
    """Misfit of masses and frictions on one support, with the most likely nuisances; None without trials.

    Args:
        support: support model.
        shape: geometry and groups.
        weight: M as weighed, kg, or None.
        trajectories: trials, some at constant speed.
        at: masses and frictions; without mass their misfit is infinite.
        errors: errors of the model, those of the support if left out.
    """
    total = float(at.mass @ shape.particles_per_group)
    if total <= 0:
        return Misfit(math.inf, MANY)
    found = posterior_of(shape, weight or total, trajectories, support, errors=errors, at=at)
    if found is None:
        return None
    misfit, weighed = found.explained, abs(total / (weight or total) - 1) < SAME_WEIGHT
    if misfit.explains or (misfit.inertia is not None and weighed):
        return misfit
    best = posterior_of(shape, weight or total, trajectories, support, errors=errors)
    assert best is not None
    return replace(misfit, least=best.explained.value)
