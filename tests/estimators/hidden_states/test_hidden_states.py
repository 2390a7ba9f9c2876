"""Algorithm 1 in a world of exact Coulomb friction."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.estimator import HiddenStates
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.testing.conformance import opposed
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from tests.fakes.flawed_bench import biased
from tests.helpers.answers import ask, claimed, found, nad, trials_of

# Here the center of a turn is known exactly; the default blurs the directions of particles within 0.08 mm of it
METHOD = HiddenStates(pivot_error=0.0)
EXACT = 1e-6
L2 = load_object("L2")
CARRIED = {"lift": 0.5, "moment": (0.004, -0.003)}
# NAD of the own-weight answer to exact rigid data: what no sensor can mend
RIGID_FLOOR = {"I1": 0.0, "I2": 37.1, "L1": 0.0, "L2": 10.7, "F1": 0.0, "F2": 34.7}


IN_A_ROW = ("I1", "I2", 2, 5)
"""Objects whose grasps lie in one row."""


@pytest.mark.parametrize("name", [*RIGID_FLOOR, *range(6)])
def test_masses_frictions_center_and_inertia_are_recovered(name):
    obj = load_object(name) if isinstance(name, str) else drawn_object(name)
    answer = ask(obj, trials_of(obj), METHOD)
    assert answer.status == "ok" and nad(obj, answer) < EXACT
    assert_allclose(found(answer).friction, obj.truth.friction, rtol=1e-5)
    assert answer.hidden is not None
    assert bool(answer.hidden.unobserved) == (name in IN_A_ROW)
    if not answer.hidden.unobserved:
        assert_allclose(answer.hidden.center_of_mass, obj.center_of_mass, atol=2e-6)
        assert_allclose(answer.hidden.inertia_cm, obj.inertia_cm, rtol=1e-4)


@pytest.mark.parametrize("seed", range(3))
def test_masses_are_recovered_where_the_center_of_a_turn_wanders(seed):
    obj = drawn_object(seed)
    assert nad(obj, ask(obj, turns(obj, wander=0.006))) < 8e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["I2", "L2", "F2"])
def test_the_load_of_the_gripper_is_taken_into_account(name):
    obj = load_object(name)
    steady = turns(obj, **CARRIED)
    error = nad(obj, ask(obj, steady + accelerated(obj, **CARRIED), replace(METHOD, refinements=6)))
    assert error < 1e-4
    planar = [replace(t, wrench_on_object_world=t.wrench_on_object_world * [1, 1, 0, 0, 0, 1]) for t in steady]
    assert nad(obj, ask(obj, planar, METHOD)) > 10 * error


def test_two_friction_groups_are_told_apart_by_the_inertia_alone():
    obj = drawn_object(1, friction_groups=2)
    answer = ask(obj, trials_of(obj), METHOD)
    assert answer.status == "ok" and nad(obj, answer) < 1e-4
    assert_allclose(found(answer).friction, obj.truth.friction, rtol=1e-4)
    without = ask(obj, turns(obj), METHOD)
    assert without.status == "underdetermined" and without.message
    assert np.isinf(claimed(without)).any()


@pytest.mark.parametrize("name", RIGID_FLOOR)
def test_one_rigid_body_gives_the_known_wrong_answer(name):
    obj = load_object(name)
    assert 100 * nad(obj, ask(obj, turns(obj, rigid=True), METHOD)) == pytest.approx(RIGID_FLOOR[name], abs=0.6)


def test_a_bias_common_to_there_and_back_does_no_harm():
    obj = load_object("I2")
    bias, stated = np.array([0.2, -0.2, 0, 0, 0, 0.01]), np.array([0.2, 0.2, 0.0, 0.0, 0.0, 0.01])
    assert nad(obj, ask(obj, [biased(t, bias, stated) for t in turns(obj)], METHOD)) < 0.01
    assert nad(obj, ask(obj, [biased(t, 0.7 * bias) for t in turns(obj)], METHOD)) < 0.2


@pytest.mark.parametrize(
    ("trials", "status"),
    [
        ([], "no_data"),
        ([replace(t, status="slipped", reason="") for t in turns(L2)], "no_data"),
        (accelerated(L2), "no_data"),
        ([analytic_trial(L2, Slide(0, direction=d)) for d in (0.0, 1.0, 2.0)], "underdetermined"),
        ([analytic_trial(L2, Rotate(0, duration=2.5))], "underdetermined"),
        ([*opposed(L2)[:1], *trials_of(L2)[1:]], "contradictory"),
    ],
    ids=["none", "failed", "accelerated alone", "slides alone", "one turn", "signs turned"],
)
def test_too_little_and_contradictions_are_a_status_and_no_number(trials, status):
    answer = ask(L2, trials)
    assert (answer.status, answer.distribution) == (status, None) and answer.message


@pytest.mark.parametrize(
    ("name", "rigid", "status"),
    [("F2", False, "ok"), ("I2", True, "unexplained"), ("L2", True, "unexplained"), ("F2", True, "unexplained")],
)
def test_own_weight_is_refuted_where_the_misfit_shows_it_and_an_assumption_everywhere(name, rigid, status):
    obj = load_object(name)
    answer = ask(obj, trials_of(obj, rigid=rigid))
    assert (answer.status, bool(answer.message)) == (status, status != "ok")
    assert answer.assumes == "every mass group rests on its own weight"
    assert (nad(obj, answer) > 0.1) == rigid
