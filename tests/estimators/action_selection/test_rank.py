"""The rank-driven policy, and the rank that turns can have."""

from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from estimators.action_selection.rank import (
    RANK_DRIVEN,
    RankDriven,
    between_particles,
    held_out_grasp,
    predicted_rank,
)
from estimators.base import ActionPolicy
from estimators.testing.analytic_world import analytic_trial
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object


def test_the_policy_asks_until_the_rank_is_full():
    shape = (obj := load_object("L1")).shape
    policy = RankDriven(pivots=1, accelerated=3, duration=2.0)
    assert isinstance(policy, ActionPolicy)
    seen = []
    while (action := policy.next(shape, seen)) is not None:
        assert isinstance(action, Accelerate | Rotate)
        seen.append(analytic_trial(obj, action))
    turns = [t.action for t in seen if isinstance(t.action, Rotate)]
    assert predicted_rank(shape, turns) == 6
    assert predicted_rank(shape, turns[:-1]) < 6
    assert sum(isinstance(t.action, Accelerate) for t in seen) == 3


def test_the_policy_takes_every_grasp_before_any_again_and_only_those_allowed():
    obj = load_object("I1")
    policy = RankDriven(pivots=4, accelerated=0, grasps=(1, 2, 4, 5))
    seen = []
    while (action := policy.next(obj.shape, seen)) is not None:
        assert isinstance(action, Rotate)
        seen.append(analytic_trial(obj, action))
    assert sorted(t.action.grasp for t in seen) == [1, 2, 4, 5]
    assert RankDriven(grasps=()).next(obj.shape, []) is None
    assert RankDriven(most=1).next(obj.shape, seen) is None


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


@pytest.mark.parametrize(("name", "enough"), [("I1", 3), ("L1", 2), ("F1", 2)])
def test_as_many_turns_as_the_shape_needs_can_fill_the_rank(name, enough):
    shape = load_object(name).shape
    fewer, ranks = (
        [predicted_rank(shape, [Rotate(g) for g in some]) for some in combinations(range(len(shape.grasps)), k)]
        for k in (enough - 1, enough)
    )
    assert max(fewer) < 6 == max(ranks)
    assert name != "I1" or min(ranks) < 6  # not every choice does


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
