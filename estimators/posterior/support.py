"""Choice of the support model from the data: own weight, one rigid body, or between the two.

Under own weight each group's load is even over its feet, and the masses that friction shows have the second moment
that acceleration shows. Under one rigid body the loads are affine over all feet, and friction shows M and c alone.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from scipy.special import ndtr

from estimators.posterior.estimator import posterior_of
from estimators.posterior.on_table import OnTable
from estimators.posterior.posterior import Posterior
from estimators.posterior.solver import solve
from estimators.wrench.model import RIGID
from estimators.wrench.support import ERRORS
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory

SupportKind = Literal["own_weight", "rigid", "between", "undecided"]
DECISIVE = 2.0
"""log10 of the Bayes factor from which one model is taken over the other."""
EVIDENCE = "log10_bayes_factor", "rigid_share", "rigid_share_error"
"""Entries of `Estimate.diagnostics` by a support test: fields of `SupportTest`."""
LOADS = 1.0, 0.3, 0.1
"""Sizes of the gripper's load over that stated, among which a choice of the support averages. Ours."""
CLEAR = 20.0
"""log10 of a Bayes factor at the stated load beyond which smaller loads change no choice. Ours."""
FEW_ROUNDS, NEGLIGIBLE = 4, 30.0
"""Rounds of a search for one material, and the log of the factor by which it may then be less likely and still be
searched on. Ours."""
MAX_MISFIT = 10.0
"""Misfit beyond which one rigid body does not explain the wrenches either."""
STIFF = 0.9
"""Share of springs at which a search starts near one rigid body: beyond it loads hardly change."""
SOFT = 0.2
"""Share of springs above which the errors of one rigid body are tried first: with those of own weight a share of 0.6
was off by three standard errors. Ours."""
NEARLY = 0.03
"""Difference of the share from 1 up to which a body counts as rigid: simulated ones have 0.97 to 1.02. Ours."""
MOST = 1.5
"""Largest share that is printed: fits of trials that no support explains have any. Ours."""


@dataclass(frozen=True, eq=False)
class SupportTest:
    """Evidence of the data for each support model."""

    kind: SupportKind
    log10_bayes_factor: float
    """Bayes factor of own weight over one rigid body: positive speaks for own weight."""
    rigid_share: float
    """Share of springs between the groups in the loads, as in `Springs.joined`: 0 on own weight, 1 under one rigid
    body."""
    rigid_share_error: float
    """Standard error of that share; about 1 where the trials do not show it."""
    shared: Posterior | None = None
    """Posterior with springs between the groups, where neither model holds and springs explain the trials."""

    @property
    def diagnostics(self) -> dict[str, float]:
        """Entries of `Estimate.diagnostics`."""
        return {name: getattr(self, name) for name in EVIDENCE}

    @property
    def sentence(self) -> str:
        """Finding in a sentence."""
        sentences = {
            "own_weight": "every group rests on its own weight",
            "rigid": "the weight is spread as under one rigid body, not group by group",
            "between": "the weight is spread neither group by group nor as under one rigid body: check the trials",
            "undecided": "own weight and one rigid body cannot be told apart: the wrenches are alike under both",
        }
        if self.shared is not None:
            sentences["between"] = "the weight is spread as by springs between the groups"
        share, error = 100 * self.rigid_share, 100 * self.rigid_share_error
        part = f"; rigid to {share:.0f} +- {error:.2g} %" if -NEARLY < self.rigid_share < MOST else ""
        return f"{sentences[self.kind]} (Bayes factor 10^{self.log10_bayes_factor:.1f} for own weight{part})"


def support_test(
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    own: Posterior,
    rigid: Posterior,
    level: float = 0.01,
) -> SupportTest:
    """Choice between the posteriors of two support models.

    The Bayes factor assigns both models the errors of one rigid body, up to a common factor, so that neither wins by
    smaller stated errors. It averages over the gripper's load at the stated size and below: without a load, the model
    in which a load changes friction more would otherwise lose. One material throughout has the same prior probability
    as unequal masses. Springs between the groups are then fitted from the likelier model: if their share differs from
    that of the model, neither model holds. Springs are tried too where the likelier model does not explain the trials.

    Args:
        shape: geometry and groups.
        weight: M, kg.
        trajectories: trials.
        own: their posterior on own weight.
        rigid: their posterior under one rigid body.
        level: probability of refusing own weight where it holds.
    """
    alike = posterior_of(shape, weight, trajectories, "own_weight", errors=RIGID, near=own)
    assert alike is not None
    bayes = _bayes_factor(alike, rigid, shape, weight)
    likelier, near, end = ("own_weight", own, 0.0) if bayes >= -DECISIVE else ("rigid", rigid, 1.0)
    start, errors = min(end, STIFF), ERRORS[likelier]
    sprung = posterior_of(shape, weight, trajectories, "springs", errors=errors, near=near, rigid_share=start)
    assert sprung is not None
    share, error = _share(sprung, near, end)
    refuted = 2 * ndtr(-abs(share - end) / error) < level and (end == 0 or abs(share - end) > NEARLY)
    tried = refuted or not near.explained.explains
    shared = _springs(shape, weight, trajectories, (alike, rigid), near, sprung) if tried else None
    if shared is not None:
        share, error = map(float, shared.of("rigid_share"))
        return SupportTest("between", bayes, share, error, shared)
    if refuted or (likelier == "rigid" and rigid.misfit > MAX_MISFIT):
        kind = "between"
    elif likelier == "rigid":
        kind = "rigid"
    else:
        kind = "own_weight" if bayes > DECISIVE else "undecided"
    return SupportTest(kind, bayes, share, error)


def _share(sprung: Posterior, near: Posterior, end: float) -> tuple[float, float]:
    """Share of springs and its standard error, by the posterior with springs and the one at an end without.

    The likelihood ratio to that end bounds the error from below: far from the end the share trades off against errors
    of the setup, and the curvature at its optimum is too large.
    """
    share, error = map(float, sprung.of("rigid_share"))
    prior = float(sprung.optimum.z[sprung.unknowns.at["rigid_share"]].square())
    gained = near.deviance - (sprung.deviance - prior)
    return share, max(error, abs(share - end) / math.sqrt(max(gained, 1.0)))


def _springs(
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    ends: tuple[Posterior, Posterior],
    likelier: Posterior,
    sprung: Posterior,
) -> Posterior | None:
    """Posterior of springs between the groups, where they explain the trials; None where they do not.

    Soft springs have the errors of the likelier model, as in the test itself; stiff ones, and those of trials that this
    model does not explain, have those of one rigid body. They have to be decisively likelier than either model alone
    with the same errors, at a share that springs can have.
    """
    share, found = float(sprung.of("rigid_share")[0]), list[tuple[Posterior, Posterior]]()
    if share > SOFT or not (sprung.explained.explains and likelier.explained.explains):
        starts = zip(ends, (STIFF / 2, STIFF), strict=True)
        fits = [
            posterior_of(shape, weight, trajectories, "springs", near=each, rigid_share=start) for each, start in starts
        ]
        found.append((max(filter(None, fits), key=_evidence), max(ends, key=_evidence)))
    if sprung.explained.explains and share <= STIFF / 2:
        found.append((sprung, likelier))
    return next((shared for shared, alone in found if _holds(shared, alone)), None)


def _evidence(fit: Posterior) -> float:
    return fit.log_evidence_to_scale


def _holds(shared: Posterior, alone: Posterior) -> bool:
    """True if springs of a possible share explain the trials, decisively better than none."""
    possible = float(shared.of("rigid_share")[0]) > -NEARLY
    return possible and shared.explained.explains and _evidence(shared) - _evidence(alone) > DECISIVE * math.log(10)


def _bayes_factor(own: Posterior, rigid: Posterior, shape: ObjectShape, weight: float) -> float:
    """log10 of the Bayes factor of own weight over one rigid body, with equal priors of all `LOADS`."""
    found: tuple[list[float], list[float]] = ([], [])
    log10 = 0.0
    for part in LOADS:
        for evidence, posterior in zip(found, (own, rigid), strict=True):
            fit = _with_load(posterior, part)
            evidence.append(fit.log_evidence_to_scale)
            if part == LOADS[0] or evidence[1] > evidence[0] - NEGLIGIBLE:
                evidence.append(_of_one_material(fit, shape, weight))
        on_own, on_rigid = (float(torch.logsumexp(torch.tensor(each), 0)) for each in found)
        log10 = (on_own - on_rigid) / math.log(10)
        if part == LOADS[0] and abs(log10) >= CLEAR:
            break
    return log10


def _of_one_material(posterior: Posterior, shape: ObjectShape, weight: float) -> float:
    """Log evidence of one material throughout; after `FEW_ROUNDS` of the search where it is negligible."""
    even = torch.full((shape.n_m,), weight / float(shape.particles_per_group.sum()), dtype=torch.float64)
    fit = posterior.given(even, FEW_ROUNDS)
    if not fit.optimum.converged and fit.log_evidence_to_scale > posterior.log_evidence_to_scale - NEGLIGIBLE:
        fit = posterior.given(even)
    return fit.log_evidence_to_scale


def _with_load(posterior: Posterior, part: float) -> Posterior:
    """Posterior with the stated size of the gripper's load scaled by `part`."""
    if part == 1:
        return posterior
    smaller = [m.with_load(part) if isinstance(m, OnTable) else m for m in posterior.measurements]
    return Posterior(posterior.unknowns, smaller, solve(smaller, posterior.unknowns, posterior.optimum.z))
