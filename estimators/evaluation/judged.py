"""Status of an answer by its misfit: one rule for all methods, heft's own and others."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from typing import get_args

import numpy as np
from jaxtyping import Float

from estimators.base import Estimate
from estimators.identifiability.report import hardly_known
from estimators.particles.misfit import Misfit
from estimators.posterior.estimator import posterior_of
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import ASSUMPTION, JoinedSupport, SupportModel
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import SetupErrors

SAME_WEIGHT = 0.01
"""Part of M within which masses add up to the weight: then a wrong inertia is no error of the search."""
FAR, ABOUT = 1.1, 0.5
"""Ratio of the masses to the weight that is reported as a disagreement, and part of the weight within which the sum of
masses of groups is recognized."""
SURE = 3.0
"""Largest distance of the masses from the weight of an answer with status `ok`, in standard errors."""
DRY = 0.05, 2.0
"""Range of frictions of dry surfaces; outside it a unit or the weight is likely wrong. Ours."""
MANY = 1_000_000
"""Degrees of freedom of a misfit whose method states none, so that no misfit above the limit counts as chance."""


def judged(answer: Estimate, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory]) -> Estimate:
    """The answer with its misfit, and a status other than `ok` if its masses are not known or do not fit the trials.

    `underdetermined` where its own covariance hardly tells a group from none (`hardly_known`), `unexplained` where the
    misfit is too large. A misfit that the method itself states counts: it may know of more than masses and friction.
    Otherwise it is computed on the support that `assumes` names, or on the one that fits better. Any other status
    stays.

    Args:
        answer: answer of a method.
        shape: geometry and groups.
        weight: M as weighed, kg, or None.
        trajectories: trials that the method was given.
    """
    at = answer.distribution
    if at is None:
        return answer
    for why in filter(None, [_not_the_weight(at.mass, shape, weight), _not_dry(at.friction)]):
        answer = _with_sentence(answer, why)
    numbers, found = answer.diagnostics, None
    if math.isnan(stated := numbers.get("misfit", math.nan)):
        supports: list[JoinedSupport] = [support for support, words in ASSUMPTION.items() if words == answer.assumes]
        supports = supports or list(get_args(SupportModel))
        if not shape.stands_in_groups:
            supports = [support for support in supports if support == "rigid"]
        if shape.chain is not None:
            supports = [support for support in supports if support == "own_weight"]
        each = [misfit_on(support, shape, weight, trajectories, at) for support in supports]
        found = min(filter(None, each), key=lambda misfit: misfit.value, default=None)
        answer = replace(answer, diagnostics=numbers | (found.diagnostics if found else {}))
    else:
        freedom = numbers.get("misfit_freedom", MANY)
        found = Misfit(stated, int(freedom) if math.isfinite(freedom) else MANY)
    if answer.status != "ok":
        return answer
    if found is not None and not found.explains:
        return _with_sentence(replace(answer, status=found.status), found.reason)
    if weight and (why := _off_the_weight(answer, shape, weight, trajectories)):
        return _with_sentence(replace(answer, status="unexplained"), why)
    loose = "" if answer.covariance is None else hardly_known(shape, at.mass, answer.covariance)
    return _with_sentence(replace(answer, status="underdetermined"), loose) if loose else answer


def _with_sentence(answer: Estimate, why: str) -> Estimate:
    """The answer with another sentence in its message."""
    return replace(answer, message="; ".join(filter(None, [answer.message, why])))


def _off_the_weight(answer: Estimate, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory]) -> str:
    """Distance of the masses from the weight, in words, if it is beyond the answer's own errors; else empty."""
    if answer.covariance is None or answer.distribution is None or not np.isfinite(answer.covariance).all():
        return ""
    count, stated = shape.particles_per_group, SetupErrors.largest([trial.setup for trial in trajectories])
    off = float(count @ answer.distribution.mass) - weight
    own = float(np.sqrt(max(count @ answer.covariance @ count, 0.0)))
    sure = abs(off) > SURE * math.hypot(own, SAME_WEIGHT * weight, ModelErrors.weight_error, stated.scale)
    return f"its masses differ from the weight by {off:+.3g} kg, with a stated error of {own:.2g} kg" if sure else ""


def _not_dry(friction: Float[np.ndarray, "n_mu"]) -> str:
    """Frictions outside `DRY`, in words; empty without any."""
    few, many = DRY
    odd = [f"{mu:.2g}" for mu in friction if not few <= mu <= many]
    return f"friction {', '.join(odd)}: is the weight, or the unit of the force, another?" if odd else ""


def _not_the_weight(mass: Float[np.ndarray, "n_m"], shape: ObjectShape, weight: float | None) -> str:
    """Disagreement of masses of particles, kg, with the weight, in words; empty if they agree."""
    times = float(shape.particles_per_group @ mass) / weight if weight else 1.0
    if 1 / FAR < times < FAR:
        return ""
    of_groups = weight is not None and abs(float(mass.sum()) / weight - 1) < ABOUT
    hint = ": these are masses of groups, where the mean mass of a particle of each is due" if of_groups else ""
    return f"the masses of all particles add up to {times:.3g} times the weight{hint}"


def misfit_on(
    support: JoinedSupport,
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
    return replace(misfit, least=_least(shape, weight or total, tuple(trajectories), support, errors))


@lru_cache(maxsize=8)
def _least(
    shape: ObjectShape,
    weight: float,
    trajectories: tuple[Trajectory, ...],
    support: JoinedSupport,
    errors: ModelErrors | None,
) -> float:
    """Misfit of the masses and frictions that fit best: the same for every method that fits the same trials worse."""
    best = posterior_of(shape, weight, trajectories, support, errors=errors)
    assert best is not None
    return best.explained.value
