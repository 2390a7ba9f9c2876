"""Estimator that chooses the support model: posterior on own weight, or mean of the masses of one rigid body."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch

from estimators.base import Estimate, HiddenStateEstimate
from estimators.particles.observe import NO_DATA, NO_LINKS
from estimators.posterior.estimator import posterior_of
from estimators.posterior.in_air import InAir
from estimators.posterior.posterior import Posterior
from estimators.posterior.support import DECISIVE, support_test
from estimators.support_models.materials import rank_assignments
from estimators.support_models.polytope import MassPolytope
from estimators.wrench.model import ParticleModel, inertia_of
from estimators.wrench.support import ASSUMPTION
from testbed.errors import InvalidValueError, listed
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import is_number

UNFIT = 1e-4
"""p-value below which the given materials are rejected."""
NARROW = 0.1
"""Width of the widest range, relative to M, below which the masses of one rigid body count as determined."""
WEIGHT_ERROR = 0.01
"""Relative error of the weight where the misfit of contradictory trials widens all errors. Ours."""
MAX_MISS = 3.0
"""Standard errors by which all maps of masses >= 0 may miss the measurements before an estimate is `unexplained`: near
the boundary of possible masses the stated errors vanish."""
MOST_LISTED = 8
"""Largest number of ranges in a message."""


@dataclass(frozen=True)
class SupportAware:
    """Tests which support model holds, and estimates by it.

    Lifts add M, c and second moments, independently of the support on the table.

    On own weight the estimate is that of the joint posterior. Under one rigid body friction shows M and c only: the
    estimate is the mean of all masses that agree with M, c and I_cm, with their covariance, and the message states
    their ranges. With materials it is their most probable assignment.
    """

    materials_kg: tuple[float, ...] = ()
    """Masses that a whole mass group may have, kg; empty where they are not known."""
    materials_kg_m3: tuple[float, ...] = ()
    """Densities that a mass group may have, kg/m^3, instead of masses; a group is as high as the object."""
    false_alarms: float = 0.01
    """Probability of refusing own weight where it holds."""
    confidence: float = 0.9
    """Joint probability of the ranges of the masses."""

    def __post_init__(self) -> None:
        for name in ("materials_kg", "materials_kg_m3"):
            values = getattr(self, name)
            if not isinstance(values, tuple) or not all(is_number(v) and v > 0 for v in values):
                raise InvalidValueError(f"SupportAware.{name}", values, "numbers > 0, or an empty list")
        if self.materials_kg and self.materials_kg_m3:
            allowed = "masses or densities, not both"
            raise InvalidValueError("SupportAware.materials_kg_m3", self.materials_kg_m3, allowed)
        for name in ("false_alarms", "confidence"):
            value = getattr(self, name)
            if not (is_number(value) and 0 < value < 1):
                raise InvalidValueError(f"SupportAware.{name}", value, "a number > 0 and < 1")

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate from trials on the table and lifts; `seed` is that of the draws within the polytope.

        Raises:
            InvalidValueError: no weight, or more materials than can be ranked.
        """
        begin = time.perf_counter()
        answer = self._answer(shape, weight, trajectories, seed)
        return replace(answer, seconds=time.perf_counter() - begin)

    def _answer(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        rigid = posterior_of(shape, weight, trajectories, "rigid") if shape.chain is None else None
        if not shape.stands_in_groups:  # one rigid body: no support to choose
            return Estimate(None, "no_data", NO_DATA) if rigid is None else self._one_body(shape, weight, rigid, seed)
        own = posterior_of(shape, weight, trajectories)
        if own is None:
            return Estimate(None, "no_data", NO_DATA if shape.chain is None else NO_LINKS)
        if rigid is None or shape.n_m == 1:  # links and single groups rest on their own weight
            return replace(own.leaning().estimate(shape), assumes=ASSUMPTION["own_weight"])
        assert weight is not None
        return self._either(shape, weight, trajectories, own, rigid, seed)

    def _one_body(self, shape: ObjectShape, weight: float | None, rigid: Posterior, seed: int) -> Estimate:
        """Estimate of an object that can only be one rigid body."""
        assert weight is not None
        known, answer = _known(rigid), self._rigid(shape, weight, rigid, {}, seed)
        if self.materials_kg or self.materials_kg_m3:
            answer = self._with_materials(shape, (rigid,), answer)
        elif max(answer.diagnostics[f"most_{g}_kg"] - answer.diagnostics[f"least_{g}_kg"] for g in range(shape.n_m)) < (
            NARROW * weight
        ):
            answer = replace(answer, status="ok", message="")
        if answer.diagnostics["polytope_miss"] > MAX_MISS:
            why = f"no masses of the parts have the {known} that were measured: an error is larger than stated"
            return replace(answer, status="unexplained", message=_joined(why, answer.message))
        if not rigid.explained.explains:
            why = (
                "one rigid body on its points of contact does not explain the wrenches: misfit "
                f"{rigid.explained.value:.2g}"
            )
            return replace(answer, status="unexplained", message=_joined(why, answer.message))
        return answer

    def _either(
        self,
        shape: ObjectShape,
        weight: float,
        trajectories: Sequence[Trajectory],
        own: Posterior,
        rigid: Posterior,
        seed: int,
    ) -> Estimate:
        test = support_test(shape, weight, trajectories, own, rigid, self.false_alarms)
        own = own.leaning()  # the test has the same prior for both supports
        as_rigid, on_own = test.log10_bayes_factor < -DECISIVE, own.estimate(shape)
        on_own = replace(on_own, diagnostics=on_own.diagnostics | test.diagnostics)
        holds = test.kind == "own_weight" and on_own.status != "unexplained"
        on_rigid = on_own if holds else self._rigid(shape, weight, rigid, test.diagnostics, seed)
        answer = on_rigid if as_rigid else on_own
        if test.shared is not None:
            answer = test.shared.estimate(shape)
            answer = replace(answer, diagnostics=answer.diagnostics | test.diagnostics)
        if self.materials_kg or self.materials_kg_m3:
            fits = {"rigid": (rigid,), "own_weight": (own,), "between": (test.shared or (rigid if as_rigid else own),)}
            answer = self._with_materials(shape, fits.get(test.kind, (own, rigid)), answer)
        if holds:
            return answer
        message = _joined(test.sentence if test.kind != "own_weight" else "", answer.message)
        if test.kind == "rigid":
            return replace(answer, status="assumption_violated", message=message)
        # the covariance includes the difference to the estimate of the other support
        other = on_own if as_rigid else on_rigid
        if test.shared is not None:
            return replace(answer, status="assumption_violated", message=message)
        share = 1 / (1 + 10**test.log10_bayes_factor) if test.kind == "undecided" else 0.5
        status = {"between": "assumption_violated", "undecided": "underdetermined"}.get(test.kind, answer.status)
        return replace(_with_other(answer, other, share), status=status, message=message)

    def _rigid(
        self, shape: ObjectShape, weight: float, rigid: Posterior, numbers: dict[str, float], seed: int
    ) -> Estimate:
        """Estimate from the masses that agree with the quantities that one rigid body shows."""
        count, known = shape.particles_per_group, _known(rigid)
        rows, values = rigid.mass_equations()
        if not rigid.explained.explains:  # their errors are widened by the misfit; the weight holds as it did
            rows = np.vstack([rows, count / (WEIGHT_ERROR * weight)])
            values = np.append(values, 1 / WEIGHT_ERROR)
        polytope = MassPolytope(rows, values)
        mean, covariance = polytope.posterior(seed)
        low, high = (end * count for end in polytope.ranges(self.confidence))
        model = ParticleModel.of(shape)
        whole = inertia_of(model, model.particle_mass(torch.tensor(mean)))
        hidden = HiddenStateEstimate(
            float(whole.mass),
            float(whole.about_com) if known != "M and c" else np.nan,
            whole.com.numpy(),
            np.zeros(0),
            (),
            f"{shape.n_m} masses from {known} alone, under one rigid body",
        )
        ranges = [f"{name} {a:.3f} to {b:.3f} kg" for name, a, b in zip(shape.group_names, low, high, strict=True)]
        holds = rigid.explained.explains and polytope.inside[1] <= MAX_MISS
        ends = {f"{end}_{g}_kg": float(v) for end, side in (("least", low), ("most", high)) for g, v in enumerate(side)}
        return Estimate(
            MassDistribution(mean, rigid.unknowns.values(rigid.mode)["friction"].numpy()),
            "underdetermined",
            f"{known} hold the masses to ({100 * self.confidence:g} %): {listed(ranges, MOST_LISTED)}" if holds else "",
            covariance=covariance,
            hidden=hidden,
            diagnostics=rigid.diagnostics | numbers | ends | {"polytope_miss": polytope.inside[1]},
        )

    def _with_materials(self, shape: ObjectShape, fits: tuple[Posterior, ...], answer: Estimate) -> Estimate:
        """The most probable assignment of the materials, or the answer as it was where none fits.

        Where the support is not decided, by the first of its fits with which any assignment agrees. Frictions and
        misfit are those of the fit at the masses chosen.
        """
        count = shape.particles_per_group
        if self.materials_kg:
            options = np.tile(self.materials_kg, (shape.n_m, 1))
        else:
            options = np.outer(count * shape.cell**2 * shape.height, self.materials_kg_m3)
        known = [fit.mass_equations() for fit in fits]
        each = [rank_assignments(rows / count, values, options) for rows, values in known]
        fit, ranked = next((pair for pair in zip(fits, each, strict=True) if pair[1].fits >= UNFIT), (fits[0], each[0]))
        numbers = answer.diagnostics | {"assignment_misfit": ranked.misfit, "assignment_fits": ranked.fits}
        if ranked.fits < UNFIT:
            why = "no assignment of the materials given agrees with the trials"
            return replace(answer, message=_joined(why, answer.message), diagnostics=numbers)
        assert answer.distribution is not None
        chosen = options[np.arange(shape.n_m), ranked.material[0]]
        many, best = ranked.holding(0.9), float(ranked.probability[0])
        numbers["assignment_probability"] = best
        numbers["assignments_holding_90"] = float(many) if many is not None else np.inf
        chosen_fit = fit.given(torch.tensor(chosen / count))
        if many == 1:  # else the frictions of other assignments count too
            numbers |= chosen_fit.diagnostics
        refuted = answer.status == "unexplained"  # the best masses are refuted, and so are these
        several = f"{many}" if many is not None else f"more than {len(ranked.probability)}"
        message = (
            f"{several} assignments of the materials hold 90 % of the probability; the best has {100 * best:.3g} %"
        )
        return replace(
            answer,
            distribution=MassDistribution(chosen / count, chosen_fit.of("friction")[0].numpy()),
            covariance=ranked.covariance(options) / np.outer(count, count),
            status="unexplained" if refuted else "ok" if many == 1 else "underdetermined",
            message=_joined("" if many == 1 else message, answer.message if refuted else ""),
            diagnostics=numbers,
        )


def _known(rigid: Posterior) -> str:
    """Names of the quantities that one rigid body shows."""
    if any(isinstance(each, InAir) for each in rigid.measurements):
        return "M, c and the second moments"
    return "M, c and I_cm" if rigid.swung else "M and c"


def _with_other(answer: Estimate, other: Estimate, share: float) -> Estimate:
    """The estimate with the covariance of a mixture with another one, whose probability is `share`."""
    assert answer.distribution is not None and answer.covariance is not None
    assert other.distribution is not None and other.covariance is not None
    apart = other.distribution.mass - answer.distribution.mass
    both = (1 - share) * answer.covariance + share * (other.covariance + np.outer(apart, apart))
    return replace(answer, covariance=both)


def _joined(first: str, second: str) -> str:
    return "; ".join(filter(None, [first, second]))
