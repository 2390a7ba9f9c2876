"""The rules of the conformance kit: what keeps to the protocol passes, and every breach is caught."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimators.base import Estimate, Estimator, Trace
from estimators.hidden_states.estimator import HiddenStates
from estimators.testing import conformance as rules
from estimators.testing.conformance import CONFORMANCE, WITHOUT_DRAWS
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory

REAL = HiddenStates()
BAD_LUCK = np.random.default_rng(0)


def answering(change: Callable[[Estimate, ObjectShape], Estimate], *, forgiving: bool = False) -> Estimator:
    """The real estimator with its answer changed; a forgiving one leaves out trials of another object."""

    def estimate(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        if forgiving:
            trajectories = [t for t in trajectories if getattr(t.action, "grasp", 0) < len(shape.grasps)]
        return change(REAL.estimate(shape, weight, trajectories, seed), shape)

    return cast(Estimator, SimpleNamespace(estimate=estimate))


def fragile() -> Estimator:
    """An estimator that takes only trials that went well."""

    def estimate(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        if not all(t.ok for t in trajectories):
            raise RuntimeError("a trial did not end well")
        return REAL.estimate(shape, weight, trajectories, seed)

    return cast(Estimator, SimpleNamespace(estimate=estimate))


def careless() -> Estimator:
    """An estimator whose batch gives every draw the answer of the first."""

    def estimate_many(
        shape: ObjectShape, weights: Sequence[float | None], draws: Sequence[Sequence[Trajectory]], seeds: Sequence[int]
    ) -> list[Estimate]:
        return [REAL.estimate(shape, weights[0], draws[0], seeds[0])] * len(draws)

    return cast(Estimator, SimpleNamespace(estimate=REAL.estimate, estimate_many=estimate_many))


def with_masses(of: Callable[[np.ndarray, ObjectShape], np.ndarray]) -> Estimator:
    """The real estimator with its masses changed."""

    def change(answer: Estimate, shape: ObjectShape) -> Estimate:
        if answer.distribution is None:
            return answer
        changed = MassDistribution(of(answer.distribution.mass, shape), answer.distribution.friction)
        return replace(answer, distribution=changed, covariance=None)

    return answering(change)


def guessing(answer: Estimate, shape: ObjectShape) -> Estimate:
    if answer.distribution is not None:
        return answer
    return replace(answer, status="ok", distribution=MassDistribution(np.ones(shape.n_m), np.ones(shape.n_mu)))


RAGGED = (Trace("steps", (2.0, 1.0), (0.0,), 1.0, np.empty((0, 0))),)
BREACHES: dict[Callable[..., None], Estimator] = {
    rules.answers_in_the_shapes_groups: with_masses(lambda mass, _: mass[:-1]),
    rules.gives_the_same_answer_to_the_same_seed: with_masses(lambda mass, _: mass * BAD_LUCK.uniform(0.9, 1.1)),
    rules.doubles_the_masses_when_all_wrenches_double: with_masses(lambda _, shape: np.full(shape.n_m, 0.1)),
    rules.does_not_care_for_the_order_of_particles: with_masses(
        lambda mass, shape: np.where(np.arange(shape.n_m) == shape.mass_group[0], 2, 1) * mass
    ),
    rules.does_not_care_for_the_order_of_groups: with_masses(
        lambda mass, _: mass * np.append(2, np.ones(len(mass) - 1))
    ),
    rules.takes_extra_trajectories: fragile(),
    rules.says_so_when_there_is_too_little: answering(guessing),
    rules.traces_its_way: answering(lambda answer, _: replace(answer, traces=RAGGED)),
    rules.answers_many_draws_as_one_by_one: careless(),
    rules.refuses_trials_of_another_shape: answering(lambda answer, _: answer, forgiving=True),
    rules.does_not_hide_that_trajectories_contradict_each_other: answering(
        lambda answer, shape: replace(guessing(answer, shape), status="ok", diagnostics={"loss": 1.0})
    ),
}


@pytest.mark.parametrize("rule", BREACHES, ids=lambda rule: rule.__name__)
def test_a_breach_is_caught(rule):
    assert isinstance(BREACHES[rule], Estimator)
    with pytest.raises((AssertionError, RuntimeError, pytest.fail.Exception)):
        rule(BREACHES[rule])


def test_every_rule_has_a_breach():
    assert {*BREACHES} == {*CONFORMANCE, *WITHOUT_DRAWS}


@pytest.mark.slow
def test_an_estimator_is_given_no_truth():
    given: list[Any] = []

    def estimate(shape: Any, weight: Any, trajectories: Any, seed: Any) -> Estimate:
        given.extend([shape, weight, seed, *trajectories])
        return REAL.estimate(shape, weight, trajectories, seed)

    spy = cast(Estimator, SimpleNamespace(estimate=estimate))
    for rule in (*CONFORMANCE, *WITHOUT_DRAWS):
        rule(spy)
    assert {type(value) for value in given} <= {ObjectShape, float, int, Trajectory}
    inside = [part for value in given if isinstance(value, Trajectory) for part in vars(value).values()]
    assert not any(isinstance(part, ObjectModel | MassDistribution) for part in inside)
