"""Answer judged by its misfit: the one rule for the status of every method, heft's own and others'."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

from estimators.base import Estimate
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.misfit import Misfit
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.support_models.fit import fit_support
from estimators.wrench.model import RIGID, ModelErrors
from estimators.wrench.support import ASSUMPTION
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory

ERRORS = {"own_weight": ModelErrors(), "rigid": RIGID}
"""Errors of the model on each support."""
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
        named = [support for support, words in ASSUMPTION.items() if words == answer.assumes]
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
    support: str, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], at: MassDistribution
) -> Misfit | None:
    """Misfit of masses and frictions on one support; None on one that the object cannot have, or without windows."""
    if (support == "own_weight" and not shape.stands_in_groups) or (support == "rigid" and shape.chain is not None):
        return None
    windows = observe(shape, trajectories, ERRORS[support])
    if windows is None or bool(windows.accelerated.all()):
        return None
    return misfit_on(support, shape, weight, windows, at, ERRORS[support])


def misfit_on(
    support: str,
    shape: ObjectShape,
    weight: float | None,
    windows: Observations,
    at: MassDistribution,
    errors: ModelErrors,
) -> Misfit:
    """Misfit of masses and frictions on one support; infinite for an object without mass.

    Args:
        support: "own_weight" or "rigid".
        shape: geometry and groups.
        weight: M as weighed, kg, or None.
        windows: windows, some at constant speed.
        at: masses and frictions.
        errors: errors of the model.
    """
    total = float(at.mass @ shape.particles_per_group)
    if total <= 0:
        return Misfit(math.inf, MANY)
    if support == "own_weight":
        return TrialWindows.about(shape, weight or total, windows, errors).misfit_of_masses(at)
    fit = fit_support(shape, weight or total, windows, "rigid", errors, at=at)
    return fit.misfit.or_of_inertia(shape, fit.pivots, at)
