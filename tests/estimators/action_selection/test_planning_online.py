"""The next touch from what was felt, in a world of exact friction."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.action_selection.design import NORMAL_MEAN, Guess
from estimators.action_selection.online import Decision, OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.posterior.estimator import Bayes
from estimators.testing.analytic_world import analytic_trial, drawn_object
from testbed.actions.accelerate import Accelerate
from testbed.actions.lift import Lift
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import Sensing, preset
from testbed.trajectory import Trajectory
from tests.fakes.analytic_push import analytic_pushes
from tests.fakes.lifted_world import lifted


def policy(obj: ObjectModel, goal: Goal, **changes: object) -> OnlinePolicy:
    guess = Guess(obj.total_mass, preset("ft300s"))
    return replace(
        OnlinePolicy(guess, goal, candidates=120, estimator=HiddenStates()),
        **changes,  # pyright: ignore[reportArgumentType]
    )


def run(obj: ObjectModel, chooser: OnlinePolicy, most: int = 12, **world: object) -> tuple[list[Trajectory], Decision]:
    trials: list[Trajectory] = []
    for seed in range(most):
        decision = chooser.decide(obj.shape, trials)
        if decision.action is None:
            return trials, decision
        assert isinstance(decision.action, Rotate | Accelerate | Slide)
        trials.append(analytic_trial(obj, decision.action, seed=seed, **world))  # pyright: ignore[reportArgumentType]
    return trials, chooser.decide(obj.shape, trials)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_it_touches_until_the_masses_are_known(seed):
    obj = drawn_object(seed)
    chooser = policy(obj, Goal(until=0.02))
    trials, last = run(obj, chooser, noise=0.05)
    assert last.why == "the target is met" and last.nad <= 0.02 and 2 <= len(trials) <= 8
    assert last.estimate is not None and last.estimate.distribution is not None
    assert normalized_absolute_difference(obj.shape, last.estimate.distribution, obj.truth) < 0.04
    nad = [chooser.decide(obj.shape, trials[:n]).nad for n in range(len(trials) + 1)]
    assert (np.diff(nad) < 0).all()


def test_time_and_trials_end_it_too():
    obj = drawn_object(0)
    first = policy(obj, Goal(until=1e-4, most=1))
    trials, last = run(obj, first)
    assert len(trials) == 1 and "1 trials were made" in last.why
    _, short = run(obj, policy(obj, Goal(budget_s=4.0)))
    assert "the budget is spent" in short.why and short.nad > 0.4


def test_what_failed_is_not_asked_for_again():
    obj = drawn_object(0)
    chooser = policy(obj, Goal())
    first = chooser.decide(obj.shape, []).action
    assert isinstance(first, Rotate)
    slipped = replace(analytic_trial(obj, first), status="slipped", reason="it slipped")
    decision = chooser.decide(obj.shape, [slipped])
    assert decision.action not in (None, first) and decision.nad == chooser.decide(obj.shape, []).nad


@pytest.mark.slow
def test_trials_that_contradict_each_other_teach_nothing():
    obj = drawn_object(0)
    chooser = policy(obj, Goal(until=0.02))
    trials, _ = run(obj, chooser, noise=0.02)
    turned = [replace(trials[0], wrench_on_object_world=-trials[0].wrench_on_object_world), *trials[1:]]
    last = chooser.decide(obj.shape, turned)
    assert last.estimate is not None and last.estimate.status == "contradictory"
    assert last.nad == last.even_nad == chooser.decide(obj.shape, []).nad and last.why != "the target is met"


@pytest.mark.slow
def test_an_answer_is_no_surer_than_it_says_itself():
    obj, wide = drawn_object(0), 10.0

    class Modest(HiddenStates):
        def estimate(self, shape, weight, trajectories, seed):
            found = super().estimate(shape, weight, trajectories, seed)
            return found if found.covariance is None else replace(found, covariance=wide**2 * found.covariance)

    trials, last = run(obj, policy(obj, Goal(until=0.02)), noise=0.05)
    modest = policy(obj, Goal(until=0.02), estimator=Modest()).decide(obj.shape, trials)
    assert modest.estimate is not None and modest.estimate.covariance is not None and modest.action is not None
    count = obj.shape.particles_per_group
    its_own = np.sqrt(np.diag(modest.estimate.covariance)) * count
    np.testing.assert_allclose(modest.standard_error, its_own)
    assert modest.nad == pytest.approx(NORMAL_MEAN * its_own.sum() / obj.total_mass) and modest.nad > last.nad


@pytest.mark.slow
def test_a_kind_of_touch_that_an_answer_needs_is_made_after_however_many_of_another():
    obj = drawn_object(0)

    class Careful(HiddenStates):
        def estimate(self, shape, weight, trajectories, seed):
            found = super().estimate(shape, weight, trajectories, seed)
            enough = any(isinstance(t.action, Accelerate) for t in trajectories)
            return found if enough else replace(found, covariance=None, status="underdetermined")

    chooser = policy(obj, Goal(until=0.1, most=100), estimator=Careful())
    count = obj.shape.n_m + obj.shape.n_mu + 1
    turns = [
        analytic_trial(obj, Rotate(0, duration=4.0, back=True, pivot=(0.05 * i, 0.01)), seed=i) for i in range(count)
    ]
    last = chooser.decide(obj.shape, turns)
    assert last.nad < 0.1 and last.even_nad > 0.3 and not last.answered and isinstance(last.action, Accelerate)
    met = chooser.decide(obj.shape, [*turns, analytic_trial(obj, last.action, seed=count)])
    assert met.answered and met.why == "the target is met"


@pytest.mark.slow
def test_a_lift_that_was_felt_counts():
    obj = load_object("L2")
    chooser = policy(obj, Goal())
    chooser = replace(chooser, guess=replace(chooser.guess, supports=("rigid",)), estimator=Bayes("rigid"))
    table = [
        analytic_trial(obj, action, rigid=True, noise=0.05)
        for action in (Rotate(2, duration=6.0, back=True), Accelerate(2))
    ]
    before = chooser.decide(obj.shape, table)
    after = chooser.decide(obj.shape, [*table, lifted(obj, Lift(2), errors=1.0)])
    assert after.nad < 0.8 * before.nad
    assert (after.standard_error <= before.standard_error * 1.05).all()


@pytest.mark.slow
def test_trials_that_disagree_are_believed_less_and_the_odd_one_is_done_again():
    obj = drawn_object(0)
    chooser = policy(obj, Goal(until=1e-4))
    trials, _ = run(obj, policy(obj, Goal(until=1e-4, most=6)), noise=0.02)
    calm = chooser.decide(obj.shape, trials)
    assert calm.why != "" or calm.action not in [t.action for t in trials]
    odd = 4
    pushed = replace(trials[odd], wrench_on_object_world=trials[odd].wrench_on_object_world * 1.1)
    upset = chooser.decide(obj.shape, [*trials[:odd], pushed, *trials[odd + 1 :]])
    assert upset.nad > 2 * calm.nad
    assert "disagree" in upset.why and upset.action == trials[odd].action
    again = chooser.decide(obj.shape, [*trials[:odd], pushed, *trials[odd + 1 :], trials[odd]])
    assert again.action != trials[odd].action  # once is enough


@pytest.mark.slow
def test_what_cannot_be_gripped_is_pushed_until_it_is_known():
    obj = drawn_object(3, ["11", "11", "11"])
    ungripped = replace(obj, shape=replace(obj.shape, grasps=()))
    chooser = policy(ungripped, Goal(until=0.06), estimator=HiddenStates())
    chooser = replace(chooser, guess=replace(chooser.guess, sensing=Sensing("exact")), candidates=15)
    trials: list[Trajectory] = []
    while (decision := chooser.decide(ungripped.shape, trials)).action is not None:
        assert isinstance(decision.action, Push) and len(trials) < 12
        trials += analytic_pushes(ungripped, [decision.action])
    assert decision.why == "the target is met" and decision.estimate is not None
    assert decision.estimate.distribution is not None
    assert normalized_absolute_difference(obj.shape, decision.estimate.distribution, obj.truth) < 0.08
