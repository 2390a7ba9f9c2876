"""Planning: candidates as a box, information that adds, the best designs, plans that end for a reason, training."""

import math
from dataclasses import replace
from itertools import combinations
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest
import torch

from estimators.action_selection.box import SIZE, ActionBox
from estimators.action_selection.candidates import REACH, ActionFamily, clear_of_particles
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import NORMAL_MEAN, Belief, Design, Guess, prior_belief, steady
from estimators.action_selection.greedy import PlannedPolicy, batch_plan, greedy_plan
from estimators.action_selection.plan import FeasibilityLog, Goal, Plan
from estimators.action_selection.random import random_pushes
from estimators.action_selection.trained import SHIPPED, TrainedIndex, TrainedPolicy
from estimators.identifiability.information import Assumptions, expected, predicted_information, prior_information
from estimators.identifiability.predicted import predicted_lift, predicted_windows
from estimators.posterior.in_air import InAir
from estimators.posterior.on_table import OnTable
from estimators.posterior.posterior import Posterior
from estimators.posterior.priors import priors
from estimators.posterior.scale import Scale, Weighing
from estimators.posterior.solver import Measurement, Optimum
from estimators.testing.analytic_world import analytic_trial
from testbed import Accelerate, InvalidValueError, Lift, Push, Rotate, Slide, load_object, preset, world
from testbed.actions.base import TableAction
from testbed.sensing.windows import steady_windows
from testbed.simulation.motion import plan_motion
from testbed.simulation.settings import SimulationSettings
from testbed.worlds.setup_errors import EXACT_SETUP

FT300S = preset("ft300s")
L2, F2 = load_object("L2"), load_object("F2").shape
LONG = ((0.0,) * 3, (0.0,) * 3, (5.0, 0.0, 0.0))
"""Weights that prefer long actions."""


def guess(name: str, **changes: object) -> Guess:
    return replace(Guess(load_object(name).total_mass, FT300S), **changes)


def design(name: str, count: int, seed: int = 0, **changes: object) -> tuple[Design, Belief]:
    shape = load_object(name).shape
    candidates = ActionFamily().sample(shape, range(len(shape.grasps)), count, seed)
    return Design.of(shape, candidates, guess(name, **changes)), prior_belief(shape, guess(name, **changes))


TRIALS = (
    Rotate(4, pivot=(0.01, 0.06), duration=5.0, back=True),
    Rotate(2, pivot=(-0.04, 0.02)),
    Slide(0, 0.7),
    Accelerate(1),
    Accelerate(1, start_speed=-0.15, accelerations=tuple(-a for a in Accelerate(1).accelerations)),
    Accelerate(3),
    Rotate(4, pivot=(0.01, 0.06), duration=5.0, back=True),
    Lift(2, hold=1.5, swings=2),
)


@pytest.mark.parametrize("world_name", ["ideal", "lab"])
@pytest.mark.parametrize("support", ["own_weight", "rigid"])
def test_information_of_trials_adds_up_to_that_of_all_together(support, world_name):
    """Oracle: errors that are drawn anew in each trial as unknowns of all trials together."""
    model, assumptions = L2, Assumptions(support, setup=world(world_name).stated)
    shape, errors = model.shape, assumptions.model_errors
    windows = predicted_windows(shape, TRIALS, FT300S, assumptions.setup, errors)
    assert windows is not None
    unknowns = priors(shape, assumptions.setup, errors, model.total_mass, len(TRIALS))
    z = unknowns.start(mass=torch.tensor(model.truth.mass), friction=torch.tensor(model.truth.friction))
    on_table = OnTable.of(shape, windows, support, errors)
    on_table = on_table.predicting(*on_table.at(unknowns, z))
    weighing = Weighing.of(shape, max(FT300S.scale, 1e-6), assumptions.setup)
    measurements: list[Measurement] = [on_table, Scale(model.total_mass, weighing)]
    if support == "rigid":
        windows = predicted_lift(TRIALS[-1], FT300S, assumptions.setup)
        measurements.append(InAir.of(shape, len(TRIALS) - 1, windows, model.total_mass))
    none = Optimum(z, torch.zeros(0), 1, True)
    together = Posterior(unknowns, measurements, none).of_masses_and_frictions.numpy()
    root = predicted_information(shape, model.truth, TRIALS, FT300S, assumptions).root(weighing)
    size = np.sqrt(np.diag(together))
    np.testing.assert_allclose(root.T @ root / np.outer(size, size), together / np.outer(size, size), atol=1e-5)


@pytest.mark.parametrize("action", [Accelerate(1), Rotate(2, pivot=(-0.04, 0.02), back=True), Slide(0, 0.7)])
def test_planned_windows_have_the_spin_and_the_acceleration_of_a_record(action: TableAction):
    planned, found = predicted_windows(L2.shape, [action], FT300S), steady_windows(analytic_trial(L2, action))
    assert planned is not None
    recorded = np.array([(each.spin_square, each.acceleration[2]) for each in found])
    np.testing.assert_allclose(planned.spin_square, recorded[:, 0], rtol=0.05, atol=1e-6)
    np.testing.assert_allclose(planned.acceleration[:, 2], recorded[:, 1], rtol=0.02, atol=1e-6)


def test_a_lift_adds_its_information_to_a_rigid_body_alone():
    model, lift = L2, Lift(2, hold=1.5, swings=2)
    rigid, own = (
        predicted_information(model.shape, model.truth, [lift], FT300S, Assumptions(support)).information()
        for support in ("rigid", "own_weight")
    )
    of_masses = slice(model.shape.n_m), slice(model.shape.n_m)
    assert rigid[of_masses].all() and not own[of_masses].any()


def test_the_errors_of_a_plan_are_those_of_the_report():
    model, shape = load_object("F2"), F2
    pivots = {0: (0.01, 0.04), 2: (0.03, -0.04), 1: (-0.04, -0.09)}
    actions = [Rotate(grasp, pivot=pivot, back=True) for grasp, pivot in pivots.items()]
    alone = predicted_information(shape, model.truth, actions, FT300S, Assumptions())
    weighing = Weighing.of(shape, FT300S.scale, EXACT_SETUP)
    information = prior_information(shape, weighing, Assumptions()) + alone.information()
    belief = Belief(information[None], shape.particles_per_group, model.total_mass)
    report = expected(shape, model.truth, actions, FT300S)
    np.testing.assert_allclose(belief.standard_error, report.standard_error, rtol=1e-6)
    assert belief.expected_nad == pytest.approx(NORMAL_MEAN * report.standard_error.sum() / model.total_mass, rel=1e-6)


@pytest.mark.parametrize("criterion", ["A", "D", "I"])
def test_the_update_is_the_inverse_done_afresh(criterion):
    small, before = design("L2", 40, supports=("own_weight", "rigid"))
    small = replace(small, criterion=criterion)
    belief = before.after(small.information_of([5]))
    afresh = [small.value(belief.after(small.information_of([i]))) for i in range(len(small.candidates))]
    np.testing.assert_allclose(small.values_after(belief), afresh, rtol=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_small_plans_are_as_good_as_the_best_of_all_sets(seed):
    small, before = design("L2", 14, seed)
    small = replace(small, time=RobotTime(around=1e6))  # next to alike for all

    def least(size: int) -> float:
        """Criterion after the best of all sets of so many candidates, one of them at constant speed."""
        sets = combinations(range(len(small.candidates)), size)
        begun = [chosen for chosen in sets if any(steady(small.candidates[c]) for c in chosen)]
        return min(small.value(before.after(small.information_of(chosen))) for chosen in begun)

    found = batch_plan(small, before, Goal(most=3, budget_s=4e6), FeasibilityLog())
    assert len(found.steps) == 3 and found.steps[-1].criterion == pytest.approx(least(3))
    one = greedy_plan(small, before, Goal(most=1), FeasibilityLog()).steps[0]
    assert one.criterion == pytest.approx(least(1))


@pytest.mark.parametrize(
    ("name", "turns"), [("L2", 2), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("I1", 3), ("F2", 2)))]
)
def test_a_plan_is_as_short_as_it_can_be(name, turns):
    model = load_object(name)
    turns_alone = ActionFamily(slides=False, accelerated=False)
    policy = PlannedPolicy(guess(name), goal=Goal(until=0.03), candidates=600, family=turns_alone)
    plan = policy.plan(model.shape)
    assert [type(action) for action in plan.actions] == [Rotate] * turns
    report = expected(model.shape, model.truth, plan.actions, FT300S)
    assert report.rank == report.unknowns
    one = expected(model.shape, model.truth, plan.actions[:1], FT300S)  # three rows and six loads
    assert one.rank < one.unknowns
    assert plan.after.expected_nad <= 0.03 < plan.steps[-2].belief.expected_nad


def test_errors_fall_with_every_step_and_time_adds_up():
    plan = PlannedPolicy(guess("L2"), goal=Goal(budget_s=70.0), candidates=600).plan(L2.shape)
    nad = [plan.before.expected_nad, *(step.belief.expected_nad for step in plan.steps)]
    assert len(plan.steps) >= 3 and (np.diff(nad) < 0).all()
    assert plan.seconds == pytest.approx(RobotTime().total(L2.shape, plan.actions))
    assert plan.seconds <= 70.0 and "budget is spent" in plan.why


@pytest.mark.parametrize("plan", [greedy_plan, batch_plan])
def test_a_target_that_is_met_before_any_trial_needs_no_plan(plan):
    small, before = design("L2", 14)
    found = plan(small, before, Goal(until=1.0), FeasibilityLog())
    assert not found.steps and found.seconds == 0 and "target is met" in found.why


@pytest.mark.slow
def test_exchange_makes_a_plan_no_longer_and_no_worse():
    whole, before = design("I2", 600)
    for goal in (Goal(until=0.02), Goal(budget_s=80.0)):
        first, better = (plan(whole, before, goal, FeasibilityLog()) for plan in (greedy_plan, batch_plan))
        if goal.until is not None:
            assert better.seconds <= first.seconds + 1e-9 and better.after.expected_nad <= goal.until
        else:
            assert better.after.expected_nad <= first.after.expected_nad * (1 + 1e-9) and better.seconds <= 80.0


@pytest.mark.slow
def test_a_lift_is_planned_for_a_rigid_body_alone():
    """Under one rigid body it parts the second moments, and shows them better than an arm that swings on the table."""

    def planned(name: str, support: str, *, lifts: bool = True) -> Plan:
        settings = {"goal": Goal(budget_s=80.0), "candidates": 400, "family": ActionFamily(lifts=lifts)}
        return PlannedPolicy(guess(name, supports=(support,)), **settings).plan(load_object(name).shape)

    for name in ("L2", "F2"):
        some, none = (planned(name, "rigid", lifts=lifts) for lifts in (True, False))
        assert any(isinstance(action, Lift) for action in some.actions)
        assert some.after.expected_nad < 0.8 * none.after.expected_nad
    assert not any(isinstance(action, Lift) for action in planned("L2", "own_weight").actions)


@pytest.mark.slow
def test_a_plan_excludes_and_lists_refused_actions():
    free = PlannedPolicy(guess("L2"), goal=Goal(most=3), candidates=500)
    wanted = free.plan(L2.shape).actions[0].grasp
    asked = []

    def not_there(action):
        asked.append(action)
        return "out of reach" if action.grasp == wanted else ""

    plan = replace(free, feasible=not_there).plan(L2.shape)
    assert len(plan.steps) == 3 and all(action.grasp != wanted for action in plan.actions)
    assert {why for _, why in plan.rejected} == {"out of reach"}
    assert len(asked) == len(set(asked)) < 500


@pytest.mark.slow
@pytest.mark.parametrize(
    ("settings", "why"),
    [
        ({"candidates": 8, "grasps": ()}, "nothing to grip"),
        ({"candidates": 200, "goal": Goal(budget_s=5.0)}, "the budget is spent: 5 s are left"),
        ({"candidates": 100, "feasible": lambda _: "no"}, "the bench can do none"),
    ],
    ids=["no grasp", "no time", "no bench"],
)
def test_an_empty_plan_has_a_reason(settings, why):
    plan = PlannedPolicy(guess("L2"), **settings).plan(L2.shape)
    assert not plan.steps and why in plan.why


@pytest.mark.slow
def test_an_object_without_grasps_is_pushed_and_a_plan_ends_without_useful_actions():
    plan = PlannedPolicy(guess("L2"), candidates=8, goal=Goal(most=2)).plan(replace(L2.shape, grasps=()))
    assert len(plan.steps) == 2 and all(isinstance(action, Push) for action in plan.actions)
    goal = Goal(until=0.01, most=30)
    rigid = PlannedPolicy(guess("L2", supports=("rigid",)), goal=goal, candidates=100).plan(L2.shape)
    assert rigid.why == "no action teaches more" and rigid.after.expected_nad > 0.1


@pytest.mark.parametrize("kind", ["random", "greedy", "batch"])
def test_a_policy_goes_through_its_plan_and_around_what_failed(kind):
    policy = PlannedPolicy(guess("F2"), kind, goal=Goal(most=3), candidates=300)
    plan, done = policy.plan(F2), cast("list[Any]", [])
    while (action := policy.next(F2, done)) is not None:
        done.append(SimpleNamespace(action=action, ok=True))
    assert tuple(d.action for d in done) == plan.actions
    done[:] = [SimpleNamespace(action=plan.actions[0], ok=False)]
    assert policy.next(F2, done) not in (None, plan.actions[0])


def test_candidates_stay_in_reach_and_clear_of_particles():
    shape = load_object("I2").shape
    family = ActionFamily()
    found = family.sample(shape, range(len(shape.grasps)), 1000, 1)
    assert found == family.sample(shape, range(len(shape.grasps)), 1000, 1)
    turns = [action for action in found if isinstance(action, Rotate)]
    assert len(turns) > 800 and {np.sign(t.speed) for t in turns} == {-1.0, 1.0}
    assert {t.grasp for t in turns} == set(range(len(shape.grasps)))
    assert clear_of_particles(shape, np.array([t.pivot for t in turns])).all()
    for turn in turns[::40]:
        path = turn.centered_path(shape, abs(turn.speed) * (turn.duration + 0.4))
        distance = np.linalg.norm(path.tool_pose(np.linspace(-0.5, 0.5, 7))[:, :2], axis=1)
        assert REACH[0] < distance.min() and distance.max() < REACH[1]
    assert family.sample(shape, [], 10, 0) == ()


@pytest.mark.slow
def test_pushes_are_drawn_where_asked_for_or_where_nothing_else_is_left():
    shape, beside = L2.shape, ActionFamily(pushes=True)
    ungripped = replace(shape, grasps=())
    assert not any(isinstance(action, Push) for action in ActionFamily().sample(shape, [0, 1], 200, 0))
    kinds = [isinstance(action, Push) for action in beside.sample(shape, [0, 1], 200, 0)]
    assert 0 < sum(kinds) < len(kinds) / 10
    for drawn in (beside.sample(shape, [], 30, 0), ActionFamily().sample(ungripped, [], 30, 0)):
        assert len(drawn) == 30 and all(isinstance(action, Push) for action in drawn)
    both = Design.of(shape, [*drawn[:3], Rotate(0)], guess("L2"))
    assert both.novel([drawn[1]]).tolist() == [True, False, True, True]  # another push there says the same
    way = RobotTime()
    assert way.between(shape, drawn[0], drawn[1]) > way.between(shape, drawn[0], drawn[0]) == way.rise


def test_robot_time_is_that_of_the_simulated_bench():
    shape, settings = L2.shape, SimulationSettings()
    half = Accelerate(0, (1.0, -1.0, 1.5, -1.5))
    moves = (Rotate(0, duration=2.3, back=True), Rotate(1, duration=3.0), Slide(0, duration=1.7), half)
    pushes = (random_pushes(shape, 1, 0)[0], replace(random_pushes(shape, 1, 1)[0], speed=0.05, length=0.05))
    for action in (*moves, *pushes, Lift(4), Lift(4, tilt=0.0, hold=1.7)):
        samples = len(plan_motion(action, shape, settings).q)
        assert RobotTime().of(action) == pytest.approx((samples - 1) / settings.rate, abs=0.02)


BOX_GRASPS = (0, 2, 3)


def box(**family: object) -> ActionBox:
    return ActionBox(F2, BOX_GRASPS, ActionFamily(**family))  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("direction", [-3.5, 3.5, 6.1, 40.0])
def test_a_slide_beyond_half_a_turn_is_the_same_slide(direction):
    again = box().action(box().point(Slide(0, direction)))
    assert isinstance(again, Slide)
    assert math.remainder(again.direction - direction, math.tau) == pytest.approx(0.0, abs=5.1e-5)


def test_every_candidate_of_a_family_is_a_point_within_its_limits():
    whole = box()
    drawn = whole.family.sample(F2, BOX_GRASPS, 120, 0)
    assert {type(action) for action in drawn} == set(whole.kinds) > set(box(slides=False).kinds)
    assert box(slides=False).kinds == (Rotate, Accelerate)
    assert box(slides=False, accelerated=False).kinds == (Rotate,)
    for action in drawn:
        again = whole.action(whole.point(action).astype(np.float32))
        assert whole.refusal(action) == ""
        assert (type(again), again.grasp) == (type(action), action.grasp)
        assert again.seconds == pytest.approx(action.seconds)
        if isinstance(action, Rotate) and isinstance(again, Rotate):
            assert again.pivot == action.pivot
            assert again.speed == pytest.approx(action.speed, abs=5.1e-5)
        elif isinstance(action, Slide) and isinstance(again, Slide):
            assert again.direction == pytest.approx(action.direction, abs=5.1e-5)
        else:
            assert again == action
        assert whole.action(whole.point(again).astype(np.float32)) == again  # rounded once, for good


def test_every_point_is_an_action_of_the_family():
    whole, rng = box(), np.random.default_rng(0)
    corners = np.array(np.meshgrid(*[[-1.0, 1.0]] * SIZE)).reshape(SIZE, -1).T
    for point in [*corners, *rng.uniform(-1, 1, (200, SIZE)), np.full(SIZE, 7.0)]:
        action = whole.action(point)
        assert action.grasp in BOX_GRASPS
        if isinstance(action, Rotate):
            low, high = whole.family.duration
            assert low <= action.duration <= high
            assert 6 - 0.01 <= abs(np.degrees(action.speed)) <= 12 + 0.01
            arm = np.linalg.norm(action.center(F2) - F2.grasps[action.grasp].position)
            assert arm <= whole.family.arm + 1e-4
            assert whole.action(whole.point(action)) == action and type(action.speed) is float


@pytest.mark.parametrize(
    ("action", "why"),
    [
        (Rotate(0, pivot=tuple(F2.particles[0]), back=True), "particle"),  # pyright: ignore[reportArgumentType]
        (Rotate(0, speed=0.2, pivot=(0.19, 0.003), back=True), "reach"),
        (Slide(0, duration=40.0), "table"),
    ],
)
def test_actions_outside_the_family_are_refused(action, why):
    assert why in box().refusal(action)


@pytest.mark.parametrize(
    ("call", "field"),
    [
        (lambda: box().action(np.zeros(3)), "action"),
        (lambda: box().action(np.full(SIZE, np.nan)), "action"),
        (lambda: box().point(Lift(0)), "action"),
        (lambda: box().point(Rotate(1)), "action"),
        (lambda: box(slides=False).point(Slide(0)), "action"),
        (lambda: box(pushes=True), "ActionBox.family"),
        (lambda: ActionBox(F2, ()), "ActionBox.grasps"),
        (lambda: Goal(until=-0.1), "Goal.until"),
        (lambda: Goal(budget_s=0.0), "Goal.budget_s"),
        (lambda: Goal(most=0), "Goal.most"),
        (lambda: TrainedIndex(budget_s=0.0), "TrainedIndex.budget_s"),
    ],
)
def test_wrong_points_actions_and_goals_are_refused(call, field):
    with pytest.raises(InvalidValueError) as error:
        call()
    assert error.value.field == field


def test_zero_weights_are_greedy_and_weights_of_time_change_it():
    made, before = design("I1", 30)
    greedy, zero, long = (
        greedy_plan(made, before, Goal(budget_s=60.0), FeasibilityLog(), *index)
        for index in ((), (TrainedIndex(),), (TrainedIndex(LONG),))
    )
    assert zero.actions == greedy.actions
    assert long.steps[0].seconds > greedy.steps[0].seconds


def test_a_file_of_weights_is_the_same_again(tmp_path: Path):
    TrainedIndex(LONG, 60.0).save(tmp_path / "w.json", objects=3)
    assert TrainedIndex.load(tmp_path / "w.json") == TrainedIndex(LONG, 60.0)
    assert TrainedIndex.load(SHIPPED).weights != TrainedIndex().weights, "those that heft comes with are not greedy's"
    policy = TrainedPolicy(1.0, (0, 1), file=str(tmp_path / "w.json"), most=2, candidates=40).policy
    assert (policy.goal, policy.index) == (Goal(budget_s=60.0, most=2), TrainedIndex(LONG, 60.0))


@pytest.mark.parametrize("text", [None, "{", '{"weights": [[1, 2]], "budget_s": 3}', '{"budget_s": 3}', "[1]"])
def test_another_file_is_refused(text: str | None, tmp_path: Path):
    if text is not None:
        (tmp_path / "w.json").write_text(text, encoding="utf-8")
    with pytest.raises(InvalidValueError):
        TrainedIndex.load(tmp_path / "w.json")
