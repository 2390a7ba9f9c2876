"""Policies: by rank, of stop-and-go lifts, of random pushes, and online choice from the estimate so far."""

from dataclasses import replace
from functools import cache, partial
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from estimators import ActionPolicy, Bayes, HiddenStates
from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.design import NORMAL_MEAN, Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import Decision, OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.action_selection.random import TRIES, RandomDrags, RandomPushes, random_pushes
from estimators.action_selection.rank import (
    RANK_DRIVEN,
    RankDriven,
    between_particles,
    held_out_grasp,
    held_out_turns,
    predicted_rank,
)
from estimators.action_selection.stop_and_go import StopAndGo
from estimators.testing.analytic_world import analytic_trial, drawn_object, record
from scenarios.policies import Policy
from testbed import Accelerate, Action, Lift, ObjectModel, Push, Rotate, Sensing, Slide, Trajectory, load_object, preset
from testbed.errors import InvalidValueError
from testbed.simulation.settings import SimulationSettings
from tests.fakes.analytic_push import analytic_pushes
from tests.fakes.lifted_world import lifted
from tests.helpers.answers import claimed
from tests.helpers.answers import nad as off

L2, F2 = load_object("L2").shape, load_object("F2").shape


def actions_of(policy, shape=L2, refused=(), failed=()):
    """All actions that a policy asks for, of which some fail."""
    done = []
    while (action := policy.next(shape, done)) is not None:
        assert action not in refused
        status = {"status": "slipped", "reason": "it slipped"} if action in failed else {}
        done.append(replace(record(action=action), **status))
    return [t.action for t in done]


def test_the_policy_takes_every_grasp_before_any_again_and_only_those_allowed():
    shape = load_object("I1").shape
    assert all(isinstance(policy, ActionPolicy) for policy in POLICIES)
    actions = actions_of(RankDriven(pivots=4, accelerated=0, grasps=(1, 2, 4, 5)), shape)
    assert all(isinstance(action, Rotate) for action in actions)
    assert sorted(action.grasp for action in actions) == [1, 2, 4, 5]
    assert RankDriven(grasps=()).next(shape, []) is None is RandomDrags(grasps=()).next(shape, [])
    assert RankDriven(most=1).next(shape, [record(action=action) for action in actions]) is None


WEIGHED = Guess(1.0, preset("ft300s").stated)
POLICIES = (RankDriven(), RandomDrags(), StopAndGo(), PlannedPolicy(WEIGHED), OnlinePolicy(WEIGHED))
WRONG_COUNTS: tuple[Any, ...] = ("3", 2.5, -1)
WRONG_NUMBERS: tuple[Any, ...] = (1.5, "a", 0)
REFUSED = [
    *(
        (lambda policy=policy, grasp=grasp: replace(policy, grasps=(grasp,)).next(L2, []), rf"grasps: got {grasp!r}")
        for policy in POLICIES
        for grasp in (-1, 99, "1")
    ),
    *((partial(RankDriven, pivots=wrong), r"pivots.*allowed: an integer >= ") for wrong in WRONG_COUNTS),
    *(
        (partial(kind, **{name: wrong}), rf"^{kind.__name__}\.{name}: .*allowed: an integer >= 0")
        for kind, name in ((RandomPushes, "pushes"), (RandomDrags, "drags"), (StopAndGo, "lifts"))
        for wrong in WRONG_COUNTS
    ),
    *(
        (partial(replace, policy, **change), f"^{type(policy).__name__}.{next(iter(change))}: ")
        for policy in (PlannedPolicy(WEIGHED), OnlinePolicy(WEIGHED))
        for change in ({"criterion": "E"}, {"candidates": 0})
    ),
    (partial(RankDriven, most=0), r"most.*allowed: an integer >= "),
    *(
        (partial(ActionFamily().sample, L2, [0], wrong, 0), r"^count.*allowed: an integer >= ")
        for wrong in WRONG_NUMBERS
    ),
]


@pytest.mark.parametrize(("call", "message"), REFUSED)
def test_a_wrong_grasp_or_count_is_refused(call, message):
    with pytest.raises(InvalidValueError, match=message):
        call()


def test_the_policy_asks_until_the_rank_is_full():
    shape, policy = load_object("L1").shape, RankDriven(pivots=1, accelerated=3, duration=2.0)
    assert isinstance(policy, ActionPolicy)
    actions = actions_of(policy, shape)
    turns = [action for action in actions if isinstance(action, Rotate)]
    assert predicted_rank(shape, turns) == 6
    assert predicted_rank(shape, turns[:-1]) < 6
    assert sum(isinstance(action, Accelerate) for action in actions) == 3 == len(actions) - len(turns)


@pytest.mark.parametrize(("name", "turns"), [("I1", 3), ("L1", 2), ("F1", 2)])
def test_the_published_policy_turns_one_way_about_grasps_until_the_rank_is_full(name, turns):
    shape = load_object(name).shape
    actions = RANK_DRIVEN["published"].predicted_actions(shape)
    assert all(isinstance(action, Accelerate) for action in actions[:3])
    moved = [action for action in actions[3:] if isinstance(action, Rotate)]
    assert moved == [Rotate(action.grasp) for action in moved] and len(moved) == len(actions) - 3
    assert len(moved) == turns == len({action.grasp for action in moved})
    assert predicted_rank(shape, moved) == 6 > predicted_rank(shape, moved[:-1])


def test_the_published_policy_slides_only_where_turns_about_all_grasps_leave_the_rank_open():
    shape = load_object("I1").shape
    first, *rest = replace(RANK_DRIVEN["published"], grasps=(0,)).predicted_actions(shape)[3:]
    slides = [action for action in rest if isinstance(action, Slide)]
    assert isinstance(first, Rotate) and len(slides) == len(rest) > 0
    reached = [predicted_rank(shape, [first, *slides[:n]]) for n in range(len(slides) + 1)]
    assert reached == sorted(reached) and reached[0] < reached[-1]
    assert reached[-1] == predicted_rank(shape, [first, Slide(0), Slide(0, np.pi / 2)])
    assert not any(isinstance(a, Slide) for a in RankDriven(grasps=(0,)).predicted_actions(shape))


@pytest.mark.parametrize("kind", [*RANK_DRIVEN])
def test_steps_from_the_published_policy_to_ours_share_their_grasps(kind):
    shape = load_object("L1").shape
    grasps = [action.grasp for action in RANK_DRIVEN[kind].predicted_actions(shape) if isinstance(action, Rotate)]
    ours = [action.grasp for action in RankDriven().predicted_actions(shape) if isinstance(action, Rotate)]
    assert grasps == ours[: len(grasps)]


def test_turns_go_about_points_between_particles():
    for grid in (1, 2, 3, 4, 5):
        shape = load_object("L1", grid).shape
        for grasp in shape.grasps:
            point = between_particles(shape, grasp.position)
            center = grasp.position if point is None else np.array(point)
            assert np.linalg.norm(shape.particles - center, axis=1).min() > shape.cell / 4


@pytest.mark.parametrize("name", ["I1", "L1", "F1"])
def test_a_turn_shows_three_numbers_and_in_a_straight_row_two(name):
    shape, rng = load_object(name).shape, np.random.default_rng(0)
    low, high = shape.particles.min(axis=0) - 0.05, shape.particles.max(axis=0) + 0.05
    drawn = [[Rotate(0, pivot=tuple(rng.uniform(low, high))) for _ in range(2)] for _ in range(60)]
    assert max(predicted_rank(shape, turns[:1]) for turns in drawn) == 3  # so one turn never shows six loads
    assert max(predicted_rank(shape, turns) for turns in drawn) == 6
    if name == "I1":  # two that lie in its row show no force along it
        in_row = [[Rotate(0, pivot=(float(x), 0.0)) for x in rng.uniform(low[0], high[0], 3)] for _ in range(60)]
        assert max(predicted_rank(shape, turns[:2]) for turns in in_row) == 4
        assert max(predicted_rank(shape, turns) for turns in in_row) == 6


@pytest.mark.parametrize("name", ["I1", "L1", "F2", "hammer"])
def test_a_grasp_is_held_out_only_where_the_others_show_as_much(name):
    shape = load_object(name).shape
    grasps = tuple(range(len(shape.grasps)))
    drawn = {held_out_grasp(shape, grasps, seed) for seed in range(20)}
    assert len(drawn) > 1 and drawn <= set(grasps)
    for spared in drawn:
        left = [Rotate(grasp) for grasp in grasps if grasp != spared]
        assert predicted_rank(shape, left) == predicted_rank(shape, [Rotate(grasp) for grasp in grasps])
    assert held_out_grasp(shape, grasps[:3], 0) is None, "three are left for the trials"


@pytest.mark.parametrize("name", ["I1", "L2", "wrench"])
@pytest.mark.parametrize("particles", [2, 3])
def test_held_out_turns_differ_and_go_about_points_between_particles(name, particles):
    shape = load_object(name, particles).shape
    for seed in range(5):
        turns = held_out_turns(shape, [1], 6, 18.0, seed)
        assert len({(turn.pivot, turn.speed) for turn in turns}) == 6
        assert held_out_turns(shape, [1], 2, 18.0, seed) == turns[:2]
        if name != "wrench":
            pivots = np.array([turn.pivot for turn in turns])
            assert np.linalg.norm(shape.particles - pivots[:, None], axis=2).min() > shape.cell / 2


def test_it_lifts_by_the_innermost_grasps_and_goes_on_to_others():
    inner = sorted(range(len(L2.grasps)), key=lambda g: float(np.linalg.norm(L2.grasps[g].position)))
    lifts = [Lift.stop_and_go(g) for g in inner]
    assert actions_of(StopAndGo(lifts=2)) == lifts[:2]
    assert actions_of(StopAndGo(lifts=1), failed=lifts[:1]) == lifts[:2]
    assert actions_of(StopAndGo(lifts=1, refused={lifts[0]: "no"}), refused=lifts[:1]) == lifts[1:2]
    assert actions_of(StopAndGo(lifts=99)) == lifts
    turns = RankDriven(1, accelerated=1)
    both = actions_of(StopAndGo(lifts=1, before=turns))
    assert both == [*actions_of(turns), lifts[0]]


def test_a_scenario_asks_for_lifts():
    settings = SimulationSettings()
    assert Policy(kind="stop_and_go").build((0, 1), L2, settings) == StopAndGo(2, (0, 1))
    ours = Policy(lifts=1).build((0, 1), L2, settings)
    assert ours == StopAndGo(1, (0, 1), Policy().build((0, 1), L2, settings))
    assert Policy(lifts=3).expected_trials() == Policy().expected_trials() + 3
    pushed, turned = load_object("scenarios/library/objects/rectangle_2x3.toml").shape, load_object("L2").shape
    for policy, shape, trials in (
        (Policy(pushes=10), pushed, 1 + 10),
        (Policy(pushes=10), turned, Policy().expected_trials()),
        (Policy(pushes=10), None, Policy().expected_trials()),
        (Policy(kind="greedy", pushes=10), turned, Policy(kind="greedy").expected_trials()),
    ):
        assert policy.expected_trials(shape) == trials
    assert Policy(kind="stop_and_go", held_out=0).expected_trials() == 3
    for kind in ("greedy", "package:Class"):
        with pytest.raises(ValueError, match="lifts"):
            Policy(kind=kind, lifts=1)
    assert Policy(kind="greedy", assumed_support="rigid", lifts=1).lifts_last is None


def test_lifts_that_stop_and_go_are_among_the_candidates():
    drawn = ActionFamily(lifts=True).sample(L2, range(3), 2000, 0)
    lifts = [action for action in drawn if isinstance(action, Lift)]
    assert {Lift(g) for g in range(3)} | {Lift.stop_and_go(g) for g in range(3)} <= set(lifts)
    assert {action.poses for action in lifts} >= {2, 4}


@pytest.mark.slow
def test_random_pushes_meet_the_whole_outline_and_are_repeatable():
    found = random_pushes(F2, 200, 4)
    assert found[:20] == random_pushes(F2, 20, 4) != random_pushes(F2, 20, 5)
    ways = {tuple(push.face(F2).normal.round().tolist()) for push in found}  # each has a face before it
    assert len(ways) == 4 and len({push.face(F2).group for push in found}) == F2.n_m
    assert np.abs([push.curvature for push in found]).max() > 1


def test_the_policy_tries_others_where_one_is_refused_or_fails_and_ends():
    refused, made = {}, []
    policy = RandomPushes(4, seed=1, refused=refused)
    while (action := policy.next(F2, made)) is not None:
        if len(refused) < 2:
            refused[action] = "reach"
        else:
            made.append(SimpleNamespace(action=action, ok=len(made) != 1))
    assert len(made) == 5 and len({*refused, *(t.action for t in made)}) == 7
    hopeless = RandomPushes(2, refused={action: "no" for action in random_pushes(F2, TRIES * 2, 0)})
    assert hopeless.next(F2, []) is None


@pytest.mark.parametrize(("grasps", "pushed"), [(None, False), ((0,), True)], ids=["enough", "too few"])
def test_pushes_follow_turns_that_leave_masses_open(grasps: tuple[int, ...] | None, pushed: bool):
    turns = replace(RANK_DRIVEN["reversed_pairs"], accelerated=1, pivots=2, grasps=grasps)
    kinds = [type(action) for action in actions_of(RandomPushes(2, before=turns))]
    assert kinds[:3] == [Accelerate, Rotate, Rotate] and kinds.count(Push) == 2 * pushed
    assert not pushed or kinds[-2:] == [Push, Push]


def test_pushes_follow_where_every_turn_is_refused():
    refused: dict[Action, str] = {Accelerate(0): "reach"}
    before = replace(RANK_DRIVEN["reversed_pairs"], grasps=(0,), refused=refused)
    assert isinstance(RandomPushes(2, refused=refused, before=before).next(F2, []), Push)


def policy(obj: ObjectModel, goal: Goal, **changes: object) -> OnlinePolicy:
    guess = Guess(obj.total_mass, preset("ft300s"))
    made = OnlinePolicy(guess, goal, candidates=120, estimator=HiddenStates())
    return replace(made, **changes)  # pyright: ignore[reportArgumentType]


def run(obj: ObjectModel, chooser: OnlinePolicy, most: int = 12, **world: object) -> tuple[list[Trajectory], Decision]:
    trials: list[Trajectory] = []
    for seed in range(most):
        decision = chooser.decide(obj.shape, trials)
        if decision.action is None:
            return trials, decision
        assert isinstance(decision.action, Rotate | Accelerate | Slide)
        trials.append(analytic_trial(obj, decision.action, seed=seed, **world))  # pyright: ignore[reportArgumentType]
    return trials, chooser.decide(obj.shape, trials)


@cache
def known(seed: int) -> tuple[ObjectModel, OnlinePolicy, list[Trajectory], Decision]:
    """Drawn object with its trials up to masses known within 2 %."""
    obj = drawn_object(seed)
    chooser = policy(obj, Goal(until=0.02))
    return obj, chooser, *run(obj, chooser, noise=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("seed", [0, 2])
def test_an_online_run_ends_with_known_masses(seed):
    obj, chooser, trials, last = known(seed)
    assert last.why == "the target is met" and last.nad <= 0.02 and 2 <= len(trials) <= 8
    assert last.estimate is not None and off(obj, last.estimate) < 0.04
    nad = [chooser.decide(obj.shape, trials[:n]).nad for n in range(len(trials) + 1)]
    assert (np.diff(nad) < 0).all()


def test_time_and_number_of_trials_end_a_run():
    obj = drawn_object(0)
    first = policy(obj, Goal(until=1e-4, most=1))
    trials, last = run(obj, first)
    assert len(trials) == 1 and last.why == "the limit of trials (1) is reached"
    _, short = run(obj, policy(obj, Goal(budget_s=4.0)))
    assert "the budget is spent" in short.why and short.nad > 0.4


def test_a_failed_action_is_not_repeated():
    obj = drawn_object(0)
    chooser = policy(obj, Goal())
    first = chooser.decide(obj.shape, []).action
    assert isinstance(first, Rotate)
    slipped = replace(analytic_trial(obj, first), status="slipped", reason="it slipped")
    decision = chooser.decide(obj.shape, [slipped])
    assert decision.action not in (None, first) and decision.nad == chooser.decide(obj.shape, []).nad


@pytest.mark.slow
def test_contradictory_trials_add_no_information():
    obj = drawn_object(0)
    chooser = policy(obj, Goal(until=0.02))
    trials, _ = run(obj, chooser, noise=0.02)
    turned = [replace(trials[0], wrench_on_object_world=-trials[0].wrench_on_object_world), *trials[1:]]
    last = chooser.decide(obj.shape, turned)
    assert last.estimate is not None and last.estimate.status == "contradictory"
    assert last.nad == last.even_nad == chooser.decide(obj.shape, []).nad and last.why != "the target is met"


@pytest.mark.slow
def test_the_larger_error_of_answer_and_planner_counts():
    (obj, _, trials, last), wide = known(0), 10.0

    class Modest(HiddenStates):
        def estimate(self, shape, weight, trajectories, seed):
            found = super().estimate(shape, weight, trajectories, seed)
            return found if found.covariance is None else replace(found, covariance=wide**2 * found.covariance)

    modest = policy(obj, Goal(until=0.02), estimator=Modest()).decide(obj.shape, trials)
    assert modest.estimate is not None and modest.action is not None
    its_own = claimed(modest.estimate) * obj.shape.particles_per_group
    np.testing.assert_allclose(modest.standard_error, its_own)
    assert modest.nad == pytest.approx(NORMAL_MEAN * its_own.sum() / obj.total_mass) and modest.nad > last.nad


@pytest.mark.slow
def test_an_accelerated_turn_follows_any_number_of_steady_turns():
    obj = drawn_object(0)

    class Careful(HiddenStates):
        def estimate(self, shape, weight, trajectories, seed):
            found = super().estimate(shape, weight, trajectories, seed)
            enough = any(isinstance(t.action, Accelerate) for t in trajectories)
            return found if enough else replace(found, covariance=None, status="underdetermined")

    chooser = policy(obj, Goal(until=0.1, most=100), estimator=Careful())
    count = obj.shape.n_m + obj.shape.n_mu + 1
    actions = [Rotate(0, duration=4.0, back=True, pivot=(0.05 * i, 0.01)) for i in range(count)]
    turns = [analytic_trial(obj, action, seed=i) for i, action in enumerate(actions)]
    last = chooser.decide(obj.shape, turns)
    assert last.nad < 0.1 and last.even_nad > 0.3 and not last.answered and isinstance(last.action, Accelerate)
    met = chooser.decide(obj.shape, [*turns, analytic_trial(obj, last.action, seed=count)])
    assert met.answered and met.why == "the target is met"


@pytest.mark.slow
def test_a_lift_reduces_the_error():
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
def test_disagreeing_trials_raise_the_error_and_the_worst_is_repeated():
    obj = drawn_object(0)
    chooser = policy(obj, Goal(until=1e-4))
    trials, _ = run(obj, policy(obj, Goal(until=1e-4, most=6)), noise=0.02)
    calm = chooser.decide(obj.shape, trials)
    assert calm.why != "" or calm.action not in [t.action for t in trials]
    odd = 4
    pushed = replace(trials[odd], wrench_on_object_world=trials[odd].wrench_on_object_world * 1.1)
    disagreeing = [*trials[:odd], pushed, *trials[odd + 1 :]]
    upset = chooser.decide(obj.shape, disagreeing)
    assert upset.nad > 2 * calm.nad
    assert "disagree" in upset.why and upset.action == trials[odd].action
    assert chooser.decide(obj.shape, [*disagreeing, trials[odd]]).action != trials[odd].action  # once is enough


@pytest.mark.slow
def test_an_object_without_grasps_is_pushed_until_the_target_is_met():
    obj = drawn_object(3, ["11", "11", "11"])
    ungripped = replace(obj, shape=replace(obj.shape, grasps=()))
    chooser = policy(ungripped, Goal(until=0.06), estimator=HiddenStates())
    chooser = replace(chooser, guess=replace(chooser.guess, sensing=Sensing("exact")), candidates=15)
    trials: list[Trajectory] = []
    while (decision := chooser.decide(ungripped.shape, trials)).action is not None:
        assert isinstance(decision.action, Push) and len(trials) < 12
        trials += analytic_pushes(ungripped, [decision.action])
    assert decision.why == "the target is met" and decision.estimate is not None
    assert off(obj, decision.estimate) < 0.08
