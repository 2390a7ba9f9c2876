"""Choice of the support model from the data: own weight, one rigid body, or between the two.

Under own weight each group's load is even over its feet, and the masses that friction shows have the second moment
that acceleration shows. Under one rigid body the loads are affine over all feet, and friction shows M and c alone.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from scipy.stats import f as f_distribution

from estimators.particles.lifts import LiftedRows
from estimators.particles.windows import Observations
from estimators.support_models.fit import SupportFit, fit_support, prior_masses
from estimators.wrench.model import RIGID, ModelErrors
from testbed.objects.model import ObjectShape

SupportKind = Literal["own_weight", "rigid", "between", "undecided"]
DECISIVE = 2.0
"""log10 of the Bayes factor from which one model is taken over the other."""
UNLIKE = 10.0
"""Mean squared residual beyond which one rigid body does not explain the wrenches either."""


@dataclass(frozen=True, eq=False)
class SupportTest:
    """Evidence of the data for each support model."""

    kind: SupportKind
    p_own_weight: float
    """Probability of at least this much of a disagreement, were every group on its own weight."""
    p_rigid: float
    """Probability of at least this much of a disagreement, were the object one rigid body."""
    log10_bayes_factor: float
    """Bayes factor of own weight over one rigid body: positive speaks for own weight."""
    moment_ratio: float
    """I_cm from acceleration over that of the masses that friction shows on own weight; NaN without acceleration."""
    moment_ratio_error: float
    """Standard error of the ratio."""

    @property
    def violated(self) -> bool:
        """True if own weight is refuted: the status `assumption_violated`."""
        return self.kind in ("rigid", "between")

    @property
    def sentence(self) -> str:
        """Finding in plain words."""
        odds = f"p {self.p_own_weight:.2g} on own weight, {self.p_rigid:.2g} on one rigid body; Bayes factor "
        odds += f"10^{self.log10_bayes_factor:.1f} for own weight"
        sentences = {
            "own_weight": "every group rests on its own weight",
            "rigid": "the weight is spread as under one rigid body, not group by group",
            "between": "neither own weight nor one rigid body explains the wrenches: the support is something between, "
            "or the shape is not as given",
            "undecided": "own weight and one rigid body cannot be told apart: the wrenches are alike under both",
        }
        return f"{sentences[self.kind]} ({odds})"


def support_test(
    shape: ObjectShape,
    weight: float,
    observed: Observations,
    *,
    level: float = 0.01,
    errors: ModelErrors | None = None,
    lifted: LiftedRows | None = None,
) -> SupportTest:
    """Fit both support models to the same windows with the same errors, and choose between them.

    p-values are F tests of each model within one that holds both: on own weight, of a load that rises over all feet and
    of a wrong second moment; under one rigid body, of loads of each group's own. The errors count as stated, but as no
    better known than the residuals could tell. The Bayes factor is exact for Gaussian evidence linear about each fit;
    beforehand an object is as likely of one material throughout as of any other masses.

    Args:
        shape: geometry and groups.
        weight: M, kg.
        observed: windows with rank(Q) full, by `observe` with `RIGID`: no load of the gripper is taken for the sensor's
            error. Accelerated ones add the second moment.
        level: rate of false alarms.
        errors: errors of either model, the same for both: neither wins by its exactness.
        lifted: equations of lifts.
    """
    errors = errors or RIGID
    own = fit_support(shape, weight, observed, "own_weight", errors, lifted, spread_known=False)
    rigid = fit_support(shape, weight, observed, "rigid", errors, lifted, spread_known=False)
    p_own, ratio, ratio_error = _within_wider(own)
    p_rigid, _, _ = _within_wider(rigid)
    bayes = float(_log_evidence(own, shape, weight) - _log_evidence(rigid, shape, weight)) / math.log(10)
    kind = _kind(p_own, bayes, rigid.squares / len(rigid.target), level)
    return SupportTest(kind, p_own, p_rigid, bayes, ratio, ratio_error)


def _kind(p_own: float, bayes: float, misfit: float, level: float) -> SupportKind:
    if bayes < -DECISIVE:
        return "rigid" if misfit < UNLIKE else "between"
    if p_own < level:
        return "between"
    return "own_weight" if bayes > DECISIVE else "undecided"


def _within_wider(fit: SupportFit) -> tuple[float, float, float]:
    """p-value of a model against the wider one; on own weight also the ratio of second moments and its error.

    Only on own weight are the masses known without the second moment, so only there can it disagree.
    """
    n_mu, count, moments = len(fit.friction), len(fit.target), fit.known[fit.moments] @ fit.mass
    own = fit.support == "own_weight" and len(moments) > 0
    rows = count + len(fit.known)
    base = np.zeros((rows, n_mu + len(fit.mass)))
    base[:count] = np.hstack([fit.of_friction, fit.of_mass])
    base[count:, n_mu:] = fit.known
    extra = np.zeros((rows, fit.wider.shape[1] + own))
    extra[:count, : fit.wider.shape[1]] = fit.wider
    if own:
        extra[count + 1 : count + 1 + len(moments), -1] = moments
    values = np.concatenate([fit.target, fit.known_target])
    without, rank_without, _ = _least_squares(base, values)
    least, rank, solution = _least_squares(np.hstack([base, extra]), values)
    wider, freedom = rank - rank_without, max(rows - rank, 1)
    p = float(f_distribution.sf((without - least) / wider, wider, freedom)) if wider else 1.0
    if not own:
        return p, np.nan, np.nan
    whole = np.hstack([base, extra])
    covariance = np.linalg.pinv(whole.T @ whole, rcond=1e-12, hermitian=True)
    return p, float(1 + solution[-1]), float(np.sqrt(covariance[-1, -1]))


def _least_squares(design: np.ndarray, values: np.ndarray) -> tuple[float, int, np.ndarray]:
    """Least squared residual, rank and solution; columns are scaled first."""
    scale = np.maximum(np.linalg.norm(design, axis=0), 1e-300)
    solution, _, rank, _ = np.linalg.lstsq(design / scale, values, rcond=1e-6)
    missing = values - design @ (solution / scale)
    return float(missing @ missing), int(rank), solution / scale


def _log_evidence(fit: SupportFit, shape: ObjectShape, weight: float) -> float:
    """Log evidence of one material throughout or of any masses, each as likely."""
    mean, covariance = prior_masses(shape, weight)
    even = np.full(shape.n_m, weight / len(shape.particles))
    each = fit.log_evidence(even, np.zeros_like(covariance)), fit.log_evidence(mean, covariance)
    return float(np.logaddexp(*each) - np.log(2))
