"""Test of the weighing: inertia from accelerated turns against the inertia of an answer's masses.

Friction determines masses only up to a factor, which the weighing sets; torque over acceleration determines their
absolute size. A wrong weight scales all masses alike and leaves no residual of friction. The misfit includes the
inertia too, with a larger tolerance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.base import Estimate
from estimators.evaluation.judged import misfit_on
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.masses import inertia_map
from estimators.hidden_states.trial_windows import TrialWindows
from testbed.objects.model import ObjectShape
from testbed.robot.calibration.trial import Finding
from testbed.trajectory import Trajectory

ALLOWED, SURE = 0.02, 2.0
"""Tolerance of the inertia: a relative error plus a number of standard errors; known blocks have up to 4 %."""


def check_weight(
    shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], found: Estimate
) -> Finding | None:
    """Finding on the weight; None without accelerated turns, or without an answer whose friction explains the trials.

    Args:
        shape: geometry and groups.
        weight: weighed mass M [kg].
        trajectories: trials.
        found: estimate from the trials.
    """
    trials = TrialWindows.of(shape, weight, trajectories, HiddenStates().errors)
    if trials is None or found.distribution is None or found.hidden is None:
        return None
    misfit = misfit_on("own_weight", shape, weight, trajectories, found.distribution)
    by_inertia = found.status == "unexplained" and misfit is not None and misfit.inertia is not None
    if found.status not in ("ok", "underdetermined") and not by_inertia:
        return None
    pivots = trials.pivot_inertias(found.distribution, found.hidden.friction_load)
    if pivots is None:
        return None
    inertia = inertia_map(shape, pivots.pivot) @ found.distribution.mass
    weights = np.linalg.solve(pivots.covariance, inertia)
    ratio, error = float(weights @ pivots.inertia / (weights @ inertia)), float((weights @ inertia) ** -0.5)
    ok = abs(ratio - 1) <= ALLOWED + SURE * error
    text = f"accelerated turns show {100 * ratio:.0f} +- {100 * error:.0f} % of the inertia that these masses have"
    advice = (
        "" if ok else f": weigh the object again ({weight:.3g} kg), or check the torque's unit and the object's size"
    )
    return Finding("inertia", ok, ratio, text + advice)
