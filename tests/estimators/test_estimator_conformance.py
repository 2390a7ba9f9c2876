"""The conformance suite itself: what keeps to the protocol passes, and every breach is caught."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from estimators.base import Estimate, Estimator, Trace
from estimators.hidden_states.estimator import HiddenStates
from estimators.testing.conformance import (
    CONFORMANCE,
    WITHOUT_DRAWS,
    answers_in_the_shapes_groups,
    does_not_care_for_the_order_of_groups,
    does_not_care_for_the_order_of_particles,
    does_not_hide_that_trajectories_contradict_each_other,
    doubles_the_masses_when_all_wrenches_double,
    gives_the_same_answer_to_the_same_seed,
    refuses_trials_of_another_shape,
    says_so_when_there_is_too_little,
    takes_extra_trajectories,
    traces_its_way,
)
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory

REAL = HiddenStates()
BAD_LUCK = np.random.default_rng(0)


def answering(change: Callable[[Estimate, ObjectShape], Estimate]) -> Estimator:
    """The real estimator with its answer changed."""

    def estimate(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        return change(REAL.estimate(shape, weight, trajectories, seed), shape)

    return cast(Estimator, SimpleNamespace(estimate=estimate))


def with_mass(answer: Estimate, mass: np.ndarray) -> Estimate:
    if answer.distribution is None:
        return answer
    return replace(answer, distribution=MassDistribution(mass, answer.distribution.friction), covariance=None)


def masses(answer: Estimate, shape: ObjectShape) -> np.ndarray:
    return np.zeros(shape.n_m) if answer.distribution is None else answer.distribution.mass


def short(answer: Estimate, shape: ObjectShape) -> Estimate:
    return with_mass(answer, masses(answer, shape)[:-1])


def drawn(answer: Estimate, shape: ObjectShape) -> Estimate:
    return with_mass(answer, masses(answer, shape) * BAD_LUCK.uniform(0.9, 1.1))


def fixed(answer: Estimate, shape: ObjectShape) -> Estimate:
    return with_mass(answer, np.full(shape.n_m, 0.1))


def first_is_heavy(answer: Estimate, shape: ObjectShape) -> Estimate:
    return with_mass(answer, masses(answer, shape) * np.append(2.0, np.ones(shape.n_m - 1)))


def heavy_where_the_first_particle_is(answer: Estimate, shape: ObjectShape) -> Estimate:
    heavier = np.ones(shape.n_m)
    heavier[shape.mass_group[0]] = 2.0
    return with_mass(answer, masses(answer, shape) * heavier)


def confident(answer: Estimate, shape: ObjectShape) -> Estimate:
    del shape
    return replace(answer, status="ok", diagnostics={"loss": 1.0})


def ragged(answer: Estimate, shape: ObjectShape) -> Estimate:
    del shape
    return replace(answer, traces=(Trace("steps", (2.0, 1.0), (0.0,), 1.0, np.empty((0, 0))),))


def forgiving() -> Estimator:
    """An estimator that takes any trial for one of its object."""

    def estimate(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        mine = [t for t in trajectories if getattr(t.action, "grasp", 0) < len(shape.grasps)]
        return REAL.estimate(shape, weight, mine, seed)

    return cast(Estimator, SimpleNamespace(estimate=estimate))


def guessing(answer: Estimate, shape: ObjectShape) -> Estimate:
    if answer.distribution is not None:
        return answer
    return replace(answer, status="ok", distribution=MassDistribution(np.ones(shape.n_m), np.ones(shape.n_mu)))


def fragile() -> Estimator:
    """An estimator that takes only trials that went well."""

    def estimate(shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int) -> Estimate:
        if not all(t.ok for t in trajectories):
            raise RuntimeError("a trial did not end well")
        return REAL.estimate(shape, weight, trajectories, seed)

    return cast(Estimator, SimpleNamespace(estimate=estimate))


BREACHES: tuple[tuple[Callable[[Estimator], None], Estimator], ...] = (
    (answers_in_the_shapes_groups, answering(short)),
    (gives_the_same_answer_to_the_same_seed, answering(drawn)),
    (doubles_the_masses_when_all_wrenches_double, answering(fixed)),
    (does_not_care_for_the_order_of_particles, answering(heavy_where_the_first_particle_is)),
    (does_not_care_for_the_order_of_groups, answering(first_is_heavy)),
    (takes_extra_trajectories, fragile()),
    (says_so_when_there_is_too_little, answering(guessing)),
    (traces_its_way, answering(ragged)),
    (refuses_trials_of_another_shape, forgiving()),
    (does_not_hide_that_trajectories_contradict_each_other, answering(confident)),
)


@pytest.mark.parametrize(("holds", "fake"), BREACHES, ids=[holds.__name__ for holds, _ in BREACHES])
def test_a_breach_is_caught(holds, fake):
    assert isinstance(fake, Estimator)
    with pytest.raises((AssertionError, RuntimeError, pytest.fail.Exception)):
        holds(fake)


def test_every_rule_has_a_breach():
    assert {holds for holds, _ in BREACHES} == {*CONFORMANCE, *WITHOUT_DRAWS}


@pytest.mark.parametrize("holds", [*CONFORMANCE, *WITHOUT_DRAWS], ids=lambda f: f.__name__)
def test_an_estimator_is_handed_no_truth(holds):
    given: list[Any] = []

    def estimate(shape: Any, weight: Any, trajectories: Any, seed: Any) -> Estimate:
        given.extend([shape, weight, seed, *trajectories])
        return REAL.estimate(shape, weight, trajectories, seed)

    holds(cast(Estimator, SimpleNamespace(estimate=estimate)))
    kinds = {type(value) for value in given}
    assert kinds <= {ObjectShape, float, int, Trajectory}
    inside = [part for value in given if isinstance(value, Trajectory) for part in vars(value).values()]
    assert not any(isinstance(part, ObjectModel | MassDistribution) for part in inside)
