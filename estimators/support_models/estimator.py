"""Estimator that chooses the support model: Algorithm 1 on own weight, under one rigid body all masses that fit."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float

from estimators.base import Estimate, HiddenStateEstimate
from estimators.hidden_states.estimator import NO_DATA, HiddenStates
from estimators.particles.lifts import LiftedRows, lifted_rows
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.support_models.fit import SupportFit, fit_support
from estimators.support_models.materials import rank_assignments
from estimators.support_models.polytope import MassPolytope
from estimators.support_models.selection import DECISIVE, support_test
from estimators.wrench.model import RIGID, ModelErrors, ParticleModel, inertia_of
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import is_number

UNFIT = 1e-4
"""p-value below which the materials given are taken not to be the object's."""
NARROW = 0.1
"""Width of the widest range, as a part of M, below which the masses of one rigid body are taken as determined."""
MISSED = 3.0
"""Standard errors by which every map of masses >= 0 may miss what was measured, before an answer is `unexplained`: at
the edge of what masses can make, the errors that are claimed shrink to nothing."""
MOST_LISTED = 8
"""Ranges that a message lists."""


@dataclass(frozen=True)
class SupportAware:
    """Tests which support model holds, and estimates by it.

    Lifts, where there are any, add M, c and second moments in the air, whatever the support on the table.

    On own weight the estimate is Algorithm 1's. Under one rigid body friction shows M and c only: the estimate is the
    mean of all masses that agree with M, c and I_cm, with their covariance, and the message gives their ranges. With
    materials it is the most probable assignment of them.
    """

    materials_kg: tuple[float, ...] = ()
    """Masses that a whole mass group may have, kg; empty where they are not known."""
    materials_kg_m3: tuple[float, ...] = ()
    """Densities that a mass group may have, kg/m^3, in place of masses; a group is as high as the object."""
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
        """Estimate from turns, slides and accelerated turns; `seed` for the draws within the polytope.

        Raises:
            InvalidValueError: no weight, or more materials than can be ranked.
        """
        begin = time.perf_counter()
        if not shape.stands_in_groups:
            return replace(self._one_body(shape, weight, trajectories, seed), seconds=time.perf_counter() - begin)
        own = HiddenStates().estimate(shape, weight, trajectories, seed)
        if shape.chain is not None:  # links rest on their own weight, or nothing is known of their loads
            return own
        observed, of_rigid = (observe(shape, trajectories, errors) for errors in (ModelErrors(), RIGID))
        if own.distribution is None or observed is None or of_rigid is None:
            return own
        assert weight is not None
        lifted = lifted_rows(shape, weight, trajectories)
        answer = self._answer(shape, weight, observed, of_rigid, lifted, own, seed)
        return replace(answer, seconds=time.perf_counter() - begin)

    def _one_body(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate of an object that can only be one rigid body: there is no support to choose."""
        observed = observe(shape, trajectories, RIGID)
        if observed is None or not (~observed.accelerated).any():
            return Estimate(None, "no_data", NO_DATA)
        if weight is None or not (np.isfinite(weight) and weight > 0):
            raise InvalidValueError("weight", weight, "M as weighed, a finite number > 0, kg")
        lifted = lifted_rows(shape, weight, trajectories)
        fit = fit_support(shape, weight, observed, "rigid", RIGID, lifted)
        known = "M, c and the second moments" if len(lifted.rows) else "M, c and I_cm" if fit.pivots else "M and c"
        nothing = Estimate(None, "assumption_violated")
        answer = self._rigid(shape, fit, nothing, seed, known)
        if self.materials_kg or self.materials_kg_m3:
            answer = self._with_materials(shape, (fit,), answer)
        elif max(answer.diagnostics[f"most_{g}_kg"] - answer.diagnostics[f"least_{g}_kg"] for g in range(shape.n_m)) < (
            NARROW * weight
        ):
            answer = replace(answer, status="ok", message="")
        if answer.diagnostics["polytope_miss"] > MISSED:
            why = f"no masses of the parts have the {known} that were measured: an error is larger than stated"
            return replace(answer, status="unexplained", message=_joined(why, answer.message))
        if not fit.misfit.explains:
            why = (
                f"one rigid body on its points of contact does not explain the wrenches: misfit {fit.misfit.value:.2g}"
            )
            return replace(answer, status="unexplained", message=_joined(why, answer.message))
        return answer

    def _answer(
        self,
        shape: ObjectShape,
        weight: float,
        observed: Observations,
        of_rigid: Observations,
        lifted: LiftedRows,
        own: Estimate,
        seed: int,
    ) -> Estimate:
        test = support_test(shape, weight, of_rigid, level=self.false_alarms, lifted=lifted)
        numbers = ("p_own_weight", "p_rigid", "log10_bayes_factor", "moment_ratio", "moment_ratio_error")
        found = own.diagnostics | {name: getattr(test, name) for name in numbers}
        own = replace(own, diagnostics=found, assumes="")  # it is tested
        rigid = test.log10_bayes_factor < -DECISIVE
        # the test leaves the spread of the gripper's load open; given the support, it is known
        as_rigid = fit_support(shape, weight, of_rigid, "rigid", RIGID, lifted)
        known = "M, c and the second moments" if len(lifted.rows) else "M, c and I_cm"
        answer = self._rigid(shape, as_rigid, own, seed, known) if rigid else own
        if self.materials_kg or self.materials_kg_m3:
            as_own = fit_support(shape, weight, observed, "own_weight", ModelErrors(), lifted)
            fits = {"rigid": (as_rigid,), "own_weight": (as_own,), "between": (as_rigid if rigid else as_own,)}
            answer = self._with_materials(shape, fits.get(test.kind, (as_own, as_rigid)), answer)
        if test.kind == "own_weight" and answer.status != "unexplained":
            return answer
        message = _joined(test.sentence if test.kind != "own_weight" else "", answer.message)
        if test.kind == "rigid":
            return replace(answer, status="assumption_violated", message=message)
        assert own.distribution is not None and own.covariance is not None
        # the answer may be wrong by as much as the other support's is elsewhere
        on_rigid = MassPolytope(*as_rigid.on_mass()).posterior(seed)
        other = (own.distribution.mass, own.covariance) if rigid else on_rigid
        share = 1 / (1 + 10**test.log10_bayes_factor) if test.kind == "undecided" else 0.5
        status = {"between": "assumption_violated", "undecided": "underdetermined"}.get(test.kind, answer.status)
        return replace(_either(answer, *other, share), status=status, message=message)

    def _rigid(self, shape: ObjectShape, fit: SupportFit, own: Estimate, seed: int, known: str) -> Estimate:
        """Estimate from the masses that agree with `known`, the numbers that one rigid body shows, in words."""
        count = shape.particles_per_group
        polytope = MassPolytope(*fit.on_mass())
        mean, covariance = polytope.posterior(seed)
        low, high = (end * count for end in polytope.ranges(self.confidence))
        model = ParticleModel.of(shape)
        whole = inertia_of(model, model.particle_mass(torch.tensor(mean)))
        hidden = HiddenStateEstimate(
            own.hidden.mass if own.hidden else float(whole.mass),
            float(whole.about_com) if fit.pivots is not None else np.nan,
            whole.com.numpy(),
            np.zeros(0),
            (),
            f"{shape.n_m} masses from {known} alone, under one rigid body",
        )
        ranges = [f"{name} {a:.3f} to {b:.3f} kg" for name, a, b in zip(shape.group_names, low, high, strict=True)]
        listed = ", ".join(ranges[:MOST_LISTED]) + (", ..." if len(ranges) > MOST_LISTED else "")
        ends = {f"{end}_{g}_kg": float(v) for end, side in (("least", low), ("most", high)) for g, v in enumerate(side)}
        return Estimate(
            MassDistribution(mean, fit.friction),
            "underdetermined",
            f"{known} hold the masses to ({100 * self.confidence:g} %): {listed}",
            covariance=covariance,
            hidden=hidden,
            diagnostics=own.diagnostics | fit.misfit.diagnostics | ends | {"polytope_miss": polytope.inside[1]},
        )

    def _with_materials(self, shape: ObjectShape, fits: tuple[SupportFit, ...], answer: Estimate) -> Estimate:
        """The most probable assignment of the materials, or the answer as it was where none fits.

        Where the support is not decided, by the first of its fits with which any assignment agrees.
        """
        count = shape.particles_per_group
        if self.materials_kg:
            options = np.tile(self.materials_kg, (shape.n_m, 1))
        else:
            options = np.outer(count * shape.cell**2 * shape.height, self.materials_kg_m3)
        known = [fit.on_mass() for fit in fits]
        each = [rank_assignments(rows / count, values, options) for rows, values in known]
        ranked = next((ranks for ranks in each if ranks.fits >= UNFIT), each[0])
        numbers = answer.diagnostics | {"assignment_misfit": ranked.misfit, "assignment_fits": ranked.fits}
        if ranked.fits < UNFIT:
            why = "no assignment of the materials given agrees with the trials"
            return replace(answer, message=_joined(why, answer.message), diagnostics=numbers)
        assert answer.distribution is not None
        chosen = options[np.arange(shape.n_m), ranked.material[0]]
        many, best = ranked.holding(0.9), float(ranked.probability[0])
        numbers["assignment_probability"] = best
        numbers["assignments_holding_90"] = float(many) if many is not None else np.inf
        refuted = answer.status == "unexplained"  # by the masses that fit best, so by these too
        several = f"{many}" if many is not None else f"more than {len(ranked.probability)}"
        message = (
            f"{several} assignments of the materials hold 90 % of the probability; the best has {100 * best:.3g} %"
        )
        return replace(
            answer,
            distribution=MassDistribution(chosen / count, answer.distribution.friction),
            covariance=ranked.covariance(options) / np.outer(count, count),
            status="unexplained" if refuted else "ok" if many == 1 else "underdetermined",
            message=_joined("" if many == 1 else message, answer.message if refuted else ""),
            diagnostics=numbers,
        )


def _either(
    answer: Estimate, mean: Float[np.ndarray, "n_m"], covariance: Float[np.ndarray, "n_m n_m"], share: float
) -> Estimate:
    """The answer with errors that allow for another one, whose probability is `share`; kg and kg^2 a particle."""
    assert answer.distribution is not None and answer.covariance is not None
    apart = mean - answer.distribution.mass
    both = (1 - share) * answer.covariance + share * (covariance + np.outer(apart, apart))
    return replace(answer, covariance=both)


def _joined(first: str, second: str) -> str:
    return "; ".join(filter(None, [first, second]))
