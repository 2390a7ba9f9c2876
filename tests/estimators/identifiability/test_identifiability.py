"""Identifiability: open directions by name, the bound against the scatter, infinity where nothing is seen."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.action_selection.pushes import random_pushes
from estimators.action_selection.rank import between_particles
from estimators.hidden_states.estimator import HiddenStates
from estimators.identifiability.information import (
    Assumptions,
    expected,
    observed,
    predicted_information,
    prior_information,
)
from estimators.identifiability.report import identifiability
from estimators.particles import friction_system
from estimators.testing.analytic_push import analytic_pushes
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from estimators.wrench.weighing import Weighing
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.presets import Sensing, preset
from testbed.worlds.presets import world
from testbed.worlds.setup_errors import EXACT_SETUP

NAMES = ("I1", "I2", "L1", "L2", "F1", "F2")


def all_turns(obj: ObjectModel) -> list[Action]:
    shape = obj.shape
    beside = [between_particles(shape, grasp.position) for grasp in shape.grasps]
    back_and_forth = [Rotate(g, pivot=pivot, back=True) for g, pivot in enumerate(beside)]
    return [Weigh(), *map(Accelerate, range(len(shape.grasps))), *back_and_forth]


def of_rows(rows: list[list[float]]):
    """Identifiability of rows of unit error over the masses of L2 and its friction."""
    obj = load_object("L2")
    return identifiability(obj.shape, obj.truth, 1e3 * np.array(rows, dtype=float))


@pytest.mark.parametrize("name", NAMES)
def test_on_own_weight_every_mass_is_seen(name):
    obj = load_object(name)
    report = expected(obj.shape, obj.truth, all_turns(obj), preset("ft300s"))
    assert report.rank == report.unknowns == obj.shape.n_m + 1
    assert np.isfinite(report.standard_error).all()
    assert report.unobservable == ()
    assert report.sentence == "all 7 masses and frictions are observed"


@pytest.mark.parametrize(("name", "rank"), [("I2", 4), ("L2", 5), ("F2", 5)])
def test_under_one_rigid_body_only_weight_center_and_inertia_are_seen(name, rank):
    obj = load_object(name)
    report = expected(obj.shape, obj.truth, all_turns(obj), preset("ideal"), Assumptions("rigid"))
    assert report.rank == rank
    assert np.isinf(report.standard_error).all()
    of_mass = report.open_directions[:, :-1]
    middles = np.array([obj.shape.particles[obj.shape.mass_group == g].mean(axis=0) for g in range(obj.shape.n_m)])
    assert_allclose(of_mass.sum(axis=1), 0, atol=1e-6)
    assert_allclose(of_mass @ middles, 0, atol=1e-6)
    assert_allclose(of_mass @ (middles**2).sum(axis=1), 0, atol=1e-6)
    assert_allclose(report.open_directions[:, -1], 0, atol=1e-6)


def test_open_directions_of_f2_under_one_rigid_body_by_name():
    obj = load_object("F2")
    report = expected(obj.shape, obj.truth, all_turns(obj), preset("ft300s"), Assumptions("rigid"))
    assert report.unobservable == ("the combination A1 - B1 - A3 + B3", "the combination A1 - 3 A2 + 3 A3 - A4")


def test_masses_that_only_change_places_are_named_as_a_sum():
    sums = of_rows([[1, 0, 0, 0, 0, 0, 0], [0, 1, 1, 0, 0, 0, 0], [0, 0, 0, 1, 1, 1, 0], [0, 0, 0, 0, 0, 0, 1]])
    assert sums.unobservable == ("B1 and C1 only as a sum", "A2, A3 and A4 only as a sum")
    assert np.isinf(sums.standard_error).tolist() == [False, True, True, True, True, True]
    assert (sums.rank, sums.unknowns) == (4, 7)


@pytest.mark.parametrize(
    ("rows", "open_"),
    [(np.eye(7)[[0, 1, 2, 3, 4, 6]], 5), (np.diag([1e-6, *[0.1] * 6]), 0)],
    ids=["untouched", "an error as large as the object"],
)
def test_a_mass_that_is_not_seen_is_named_alone(rows, open_):
    found = of_rows(rows.tolist())
    assert found.unobservable == (f"{found.group_names[open_]} not at all",)
    assert np.flatnonzero(np.isinf(found.standard_error)).tolist() == [open_]


@pytest.mark.parametrize(
    ("actions", "rank"),
    [
        ([Slide(g, direction) for g in range(5) for direction in (0.0, 1.0, 2.0)], 4),  # friction and center
        ([Weigh()], 1),
    ],
    ids=["slides", "weighing"],
)
def test_slides_and_a_weighing_leave_masses_open(actions, rank):
    obj = load_object("L2")
    report = expected(obj.shape, obj.truth, actions, preset("ft300s"))
    assert report.rank == rank and np.isinf(report.standard_error).any()


def test_a_better_sensor_and_more_trials_show_more():
    obj = load_object("L2")
    errors = {
        name: expected(obj.shape, obj.truth, all_turns(obj), preset(name)).standard_error
        for name in ("ideal", "low", "ft300s", "high")
    }
    assert (errors["ideal"] < errors["low"]).all()
    assert (errors["low"] < errors["high"]).all()
    twice = expected(obj.shape, obj.truth, 2 * all_turns(obj), preset("ft300s")).standard_error
    assert (twice < errors["ft300s"]).all()


def test_a_plan_says_what_the_trials_then_say():
    obj = drawn_object(0)
    actions = [t.action for t in (*accelerated(obj), *turns(obj))]
    seen = observed(obj.shape, obj.truth, [*accelerated(obj), *turns(obj)])
    quiet = replace(preset("ideal"), scale=Assumptions().model_errors.weight_error)
    planned = expected(obj.shape, obj.truth, actions, quiet)
    # a record trims its stretches by whole samples, and its slopes are measured
    assert_allclose(planned.standard_error, seen.standard_error, rtol=0.05)


def test_rows_are_derivatives_of_the_drag_which_is_bilinear():
    obj = drawn_object(1)
    slow = [replace(a, speed=1e-4) for a in all_turns(obj) if isinstance(a, Rotate)]  # hardly any centripetal force
    trials = predicted_information(obj.shape, obj.truth, slow, preset("ft300s"), Assumptions())
    steady = trials.rows[..., : trials.known].reshape(-1, trials.known)
    # what scales all masses up scales the friction down
    assert_allclose(steady[:, :-1] @ obj.truth.mass, steady[:, -1] * obj.truth.friction[0], rtol=1e-6, atol=1e-6)
    weighing = Weighing.of(obj.shape, 0.01, EXACT_SETUP)
    weighing = prior_information(obj.shape, weighing, Assumptions())[: obj.shape.n_m, : obj.shape.n_m]
    assert obj.truth.mass @ weighing @ obj.truth.mass == pytest.approx((obj.total_mass / 0.01) ** 2)


def test_every_answer_carries_the_report_and_too_few_turns_say_what_they_leave_open():
    obj = load_object("L2")
    answer, few = (
        HiddenStates().estimate(obj.shape, obj.total_mass, given, 0)
        for given in ([*accelerated(obj), *turns(obj)], turns(obj, [0]))
    )
    report = answer.identifiability
    assert report is not None and answer.covariance is not None and report.rank == report.unknowns
    particles = np.sqrt(np.diagonal(answer.covariance))
    assert_allclose(report.standard_error, particles * obj.shape.particles_per_group)
    assert few.status == "underdetermined" and few.identifiability is not None
    assert few.identifiability.rank < few.identifiability.unknowns and few.identifiability.unobservable
    assert np.isinf(few.identifiability.standard_error).any()


def test_a_grasp_that_is_not_there_is_refused():
    obj = load_object("L2")
    with pytest.raises(InvalidValueError, match="one of the shape's 5 grasps"):
        expected(obj.shape, obj.truth, [Rotate(9)], preset("ideal"))
    with pytest.raises(InvalidValueError, match="own_weight, rigid"):
        Assumptions("floating")


@pytest.mark.slow
def test_answers_scatter_as_the_bound_says():
    """In a world of exact Coulomb friction with white noise, Algorithm 1 reaches the Cramer-Rao bound, and says so."""
    obj = load_object("L2")
    exact = HiddenStates(
        force_error=0.0, torque_error=0.0, pivot_error=0.0, height_error=0.0, lift_error=0.0, weight_error=1e-6
    )
    off, claimed, noisy = [], [], []
    for seed in range(25):
        noisy = []
        for i, turn in enumerate(turns(obj)):
            rng = np.random.default_rng([seed, i])
            noise = 0.2 * np.array([1, 1, 1, 0.1, 0.1, 0.1]) * rng.standard_normal((len(turn.time_s), 6))
            noisy.append(replace(turn, wrench_on_object_world=turn.wrench_on_object_world + noise))
        answer = exact.estimate(obj.shape, obj.total_mass, noisy, 0)
        assert answer.distribution is not None and answer.covariance is not None
        claimed.append(np.sqrt(np.diag(answer.covariance)) * obj.shape.particles_per_group)
        off.append((answer.distribution.mass - obj.truth.mass) * obj.shape.particles_per_group)
    last = observed(obj.shape, obj.truth, noisy, Assumptions(errors=exact.errors))
    assert_allclose(np.sqrt(np.mean(np.square(off), axis=0)), last.standard_error, rtol=0.35)
    assert_allclose(np.mean(claimed, axis=0), last.standard_error, rtol=0.1)


SLAB = drawn_object(3, ["11", "11", "11"])
"""2 x 3 blocks, which no hand can grip."""


def brisk_pushes(shape: ObjectShape, count: int, seed: int, *, length: float = 0.06) -> list[Push]:
    return [replace(push, speed=0.05, length=length) for push in random_pushes(shape, count, seed)]


@pytest.mark.slow
def test_what_pushes_are_expected_to_show_is_what_they_show(monkeypatch):
    """At a model error of 1 %: a smaller one does not cover the change of force that a brief record counts as noise."""
    monkeypatch.setattr(friction_system, "PUSH_ERROR", 0.01)
    pushes = brisk_pushes(SLAB.shape, 6, 0, length=0.12)
    before = expected(SLAB.shape, SLAB.truth, pushes, Sensing("exact"))
    after = observed(SLAB.shape, SLAB.truth, analytic_pushes(SLAB, pushes))
    assert before.rank == after.rank == before.unknowns == 7
    assert_allclose(before.standard_error, after.standard_error, rtol=0.2)
    guessed = MassDistribution(np.full(6, SLAB.truth.mass.mean()), SLAB.truth.friction)
    elsewhere = expected(SLAB.shape, guessed, pushes, Sensing("exact"))  # where even masses would have gone
    assert_allclose(elsewhere.standard_error.mean(), before.standard_error.mean(), rtol=0.5)


@pytest.mark.slow
def test_a_camera_that_sees_less_shows_less():
    pushes = brisk_pushes(SLAB.shape, 5, 1)
    errors = [
        expected(SLAB.shape, SLAB.truth, pushes, preset(name), Assumptions(setup=world(place).stated)).standard_error
        for name, place in (("ft300s:camera=exact", "ideal"), ("ft300s", "ideal"), ("ft300s", "lab"))
    ]
    assert (errors[0] < errors[1]).all() and (errors[1] < errors[2]).all()


def test_pushes_and_turns_add_up():
    obj, where = load_object("L2"), Assumptions(setup=world("lab").stated)
    actions = [Rotate(0, pivot=(0.02, 0.05)), *brisk_pushes(obj.shape, 3, 0), Accelerate(1), Slide(2)]
    together = predicted_information(obj.shape, obj.truth, actions, preset("ft300s"), where)
    for index, action in enumerate(actions):
        alone = predicted_information(obj.shape, obj.truth, [action], preset("ft300s"), where)
        assert_allclose(alone.information(), together.information([index]), rtol=1e-6, atol=1e-9)
