"""Tests of predicted links: their motion, what slides and turns of them show, and plans of those."""

from functools import cache

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.action_selection.candidates import MOST_DRAGS, ActionFamily
from estimators.action_selection.design import Guess
from estimators.action_selection.drags import random_drags
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.identifiability.information import Assumptions, expected, observed
from estimators.identifiability.trailing import trailing_motions
from estimators.testing.analytic_links import analytic_links, drawn_chain
from estimators.testing.analytic_world import own_weight_loads
from testbed.actions.path import RAMP_TIME
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory

slow = pytest.mark.slow
IDEAL = preset("ideal")
CHAIN = drawn_chain(1)
DRAGS = (
    Slide(1, -2.6, duration=3.0),
    Rotate(2, np.radians(-10), 4.0, (0.04, 0.02)),
    Rotate(1, np.radians(10), 4.0, (-0.03, -0.02)),
)


@cache
def record_of(action: Rotate | Slide) -> Trajectory:
    return analytic_links(CHAIN, action)


def friction_of(obj: ObjectModel) -> np.ndarray:
    return obj.truth.friction[obj.shape.friction_group] * own_weight_loads(obj)


def turned_off(action: Rotate | Slide, step: float) -> float:
    """Greatest difference of a link's yaw from that of exact mechanics, once both are past their start, rad."""
    (motion,) = trailing_motions(
        CHAIN.shape, CHAIN.particle_mass, friction_of(CHAIN), [action], step, list(CHAIN.hinge_friction)
    )
    record = record_of(action)  # which moves at full speed at once
    assert record.camera is not None
    time = np.arange(1, len(motion.turned) + 1) * step - RAMP_TIME / 2
    kept = (time > 1.0) & (time < record.time_s[-1])
    assert kept.sum() > 1 / step
    yaw = record.camera.poses[:, :, 2] - record.camera.poses[0, :, 2]
    exact = np.stack([np.interp(time[kept], record.time_s, each) for each in yaw.T], 1)
    return float(np.abs(motion.turned[kept, :, 0] - exact).max())


@pytest.mark.parametrize(
    "action",
    [
        pytest.param(DRAGS[0], id="slide"),
        pytest.param(DRAGS[1], id="turn right", marks=slow),
        pytest.param(DRAGS[2], id="turn left", marks=slow),
    ],
)
def test_links_trail_as_exact_mechanics_have_it(action: Rotate | Slide):
    # a slide that starts at once throws the links by its jerk
    assert turned_off(action, 0.04) < (0.03 if isinstance(action, Slide) else 0.003)


@slow
def test_trials_show_what_is_expected_of_them():
    trials = [record_of(action) for action in DRAGS]
    assumptions = Assumptions(hinge_friction=CHAIN.hinge_friction)
    before = expected(CHAIN.shape, CHAIN.truth, DRAGS, IDEAL, assumptions)
    after = observed(CHAIN.shape, CHAIN.truth, trials)
    assert before.rank == after.rank == before.unknowns
    assert_allclose(before.standard_error, after.standard_error, rtol=0.25)
    assert_allclose(before.hinge_error, after.hinge_error, rtol=0.25)


def test_more_drags_leave_less_open():
    drags = random_drags(CHAIN.shape, range(len(CHAIN.shape.grasps)), 6, 0)
    reports = [expected(CHAIN.shape, CHAIN.truth, drags[:count], IDEAL) for count in (1, 3, 6)]
    assert [r.rank for r in reports] == sorted(r.rank for r in reports)
    errors = np.array([report.hinge_error for report in reports])
    assert (np.diff(errors, axis=0) <= 1e-12).all() and (errors > 0).all()


def test_candidates_of_links_are_slides_and_turns_one_way():
    family = ActionFamily(lifts=True, pushes=True)
    found = family.sample(CHAIN.shape, range(len(CHAIN.shape.grasps)), 4000, 0)
    assert 0.9 * MOST_DRAGS < len(found) <= MOST_DRAGS
    assert all(isinstance(each, Slide) or (isinstance(each, Rotate) and not each.back) for each in found)


@slow
def test_a_plan_teaches_more_than_random_drags():
    grasps = tuple(range(len(CHAIN.shape.grasps)))
    guess = Guess(CHAIN.total_mass, preset("ft300s"))
    policy = PlannedPolicy(guess, goal=Goal(most=4), candidates=100, grasps=grasps)
    planned: list[Rotate | Slide] = []
    trials: list[Trajectory] = []
    while (action := policy.next(CHAIN.shape, trials)) is not None:
        assert isinstance(action, (Rotate, Slide))
        planned.append(action)
        trials.append(analytic_links(CHAIN, action))
    assumptions = Assumptions(hinge_friction=CHAIN.hinge_friction)
    drawn = random_drags(CHAIN.shape, grasps, 4, 0)
    by_plan, by_chance = (
        expected(CHAIN.shape, CHAIN.truth, each, preset("ft300s"), assumptions) for each in (planned, drawn)
    )
    assert by_plan.standard_error.mean() < by_chance.standard_error.mean()


@slow
def test_the_next_touch_counts_on_hinges_as_they_were_estimated():
    guess = Guess(CHAIN.total_mass, IDEAL)
    policy = OnlinePolicy(guess, goal=Goal(most=6), candidates=40)
    decision = policy.decide(CHAIN.shape, [record_of(action) for action in DRAGS[:2]])
    assert decision.estimate is not None and decision.estimate.status == "ok"
    assert isinstance(decision.action, (Slide, Rotate))
