"""Columns of an inexact setup: each is the change of the wrenches where the setup really is so."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.baselines.optimizers import LeastSquares
from estimators.hidden_states.estimator import HiddenStates
from estimators.particles.friction_system import sensor_map
from estimators.particles.observe import observe
from estimators.particles.setup_effects import LinearRows, setup_effects
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.wrench.model import ParticleModel
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.model import GRAVITY
from testbed.worlds.setup_errors import SetupErrors
from tests.fakes.flawed_bench import held_beside, on_anisotropic_table

OBJECT, BESIDE = drawn_object(0), np.array([0.01, 0.015])
ACTIONS = [
    Rotate(grasp, duration=2.5, pivot=tuple(OBJECT.shape.grasps[grasp].position + BESIDE), back=back)
    for grasp, back in ((0, True), (1, False), (2, True))
]


def observed(trials):
    windows = observe(OBJECT.shape, trials)
    assert windows is not None
    return windows


def effects(trials, setup):
    windows = observed(trials)
    model = ParticleModel.of(OBJECT.shape)
    mass = model.particle_mass(torch.tensor(OBJECT.truth.mass))
    drag = model.particle_friction(torch.tensor(OBJECT.truth.friction)) * mass * GRAVITY
    to_wrench = sensor_map(windows, torch.zeros(len(windows), 3, 3, dtype=torch.float64))
    rows = LinearRows.of(windows, windows.table(model, spread=bool(setup.contact_points)), mass, drag, 0.0, setup)
    found = setup_effects(windows, rows, to_wrench, setup)
    return {kind: columns.numpy() for kind, columns in found.items()}


def wrenches(trials):
    return observed(trials).wrench.numpy().ravel()


@pytest.mark.parametrize("millimeters", [0.0, 0.5, 1.0, 2.0, 5.0])
def test_a_known_foot_near_the_pivot_drags_as_in_the_mean_over_the_errors_of_its_place(millimeters):
    foot = OBJECT.shape.particles[np.argmin(np.linalg.norm(OBJECT.shape.particles - [0.0, 0.02], axis=1))]
    beside = Rotate(0, duration=2.5, pivot=(float(foot[0]) + 1e-3 * millimeters, float(foot[1])))
    model, exact = ParticleModel.of(OBJECT.shape), observed([analytic_trial(OBJECT, beside)])
    stated = SetupErrors(grasp_offset=5e-4, particle_offset=5e-4)
    each = torch.ones(len(model.particles), dtype=torch.float64)
    sharp = exact.table(model, 1e-6).dragged(each)
    offsets = torch.tensor(np.random.default_rng(0).normal(0, 5e-4 * 2**0.5, (2000, 2)))
    mean = torch.vmap(lambda offset: sharp.rows({"grasp_offset": offset}), chunk_size=500)(offsets).mean(0)
    faded = replace(exact, setup=stated).table(model, 1e-6).dragged(each).rows({})
    assert_allclose(faded[:, :2], mean[:, :2], atol=0.12)  # a foot drags 1 N
    if 0 < millimeters < 1:
        assert float((sharp.rows({}) - mean)[:, :2].norm(dim=1).min()) > 0.4


def test_an_exact_setup_has_none():
    assert effects([analytic_trial(OBJECT, ACTIONS[0])], SetupErrors()) == {}


def test_a_grasp_offset_moves_the_object_in_the_hand():
    offset = np.array([1e-4, -5e-5])
    plain = [analytic_trial(OBJECT, action) for action in ACTIONS]
    beside = [held_beside(OBJECT, action, offset) for action in ACTIONS]
    columns = effects(plain, SetupErrors(grasp_offset=0.001))["grasp_offset"]
    predicted = columns @ (-offset / 0.001)
    assert_allclose(predicted, wrenches(beside) - wrenches(plain), atol=0.03 * np.abs(predicted).max())


@pytest.mark.parametrize(("part", "off"), [(0.01, 0.01), (0.1, 0.03)])
def test_an_anisotropic_table_drags_more_one_way(part, off):
    direction = 0.4  # friction along `direction` is over the mean by `part`, and across it under the mean by as much
    plain = [analytic_trial(OBJECT, action) for action in ACTIONS]
    grained = [on_anisotropic_table(OBJECT, t, (1 - part) / (1 + part), direction) for t in plain]
    columns = effects(plain, SetupErrors(anisotropy=part))["anisotropy"]
    c, s = np.cos(2 * direction), np.sin(2 * direction)
    predicted = columns @ [c, s, c * c / 3**0.5, c * s, s * s / 3**0.5]
    change = (1 - part**2) ** 0.5 * wrenches(grained) - wrenches(plain)
    assert_allclose(predicted, change, atol=off * np.abs(change).max())


def test_groups_of_more_friction_drag_more():
    more = replace(OBJECT, truth=replace(OBJECT.truth, mass=OBJECT.truth.mass * [1.02, 1, 1, 1, 1, 1]))
    plain, harder = ([analytic_trial(obj, Slide(0, 0.3))] for obj in (OBJECT, more))
    columns = effects(plain, SetupErrors(group_friction=0.02))["group_friction"]
    assert_allclose(columns[:, 0], wrenches(harder) - wrenches(plain), atol=1e-6)


@pytest.mark.parametrize("kind", ["gain", "crosstalk", "mounting_angle", "delay"])
def test_errors_of_the_sensor_are_parts_of_what_it_measures(kind):
    plain = [analytic_trial(OBJECT, action) for action in ACTIONS]
    doubled = [replace(t, wrench_on_object_world=2 * t.wrench_on_object_world) for t in plain]
    one, two = (effects(trials, SetupErrors(**{kind: 0.01}))[kind] for trials in (plain, doubled))
    assert_allclose(two, 2 * one, atol=1e-12)
    assert np.abs(one).max() > 1e-4


def test_a_gain_of_all_axes_scales_the_wrench():
    plain = [analytic_trial(OBJECT, action) for action in ACTIONS]
    columns = effects(plain, SetupErrors(gain=0.01))["gain"]
    force = columns.sum(axis=1).reshape(-1, 3)[:, :2]
    assert_allclose(force, 0.01 * wrenches(plain).reshape(-1, 3)[:, :2], atol=1e-9)


def test_where_all_move_alike_the_pattern_of_contact_does_not_matter():
    slid = effects([analytic_trial(OBJECT, Slide(0, 0.3))], SetupErrors(contact_points=3))["contact_points"]
    turned = effects([analytic_trial(OBJECT, ACTIONS[0])], SetupErrors(contact_points=3))["contact_points"]
    assert np.abs(slid).max() < 1e-9 and np.abs(turned).max() > 1e-3


@pytest.mark.parametrize("method", [HiddenStates(), LeastSquares()], ids=["hidden_states", "least_squares"])
def test_errors_that_are_stated_widen_the_answers_own(method):
    trials = turns(OBJECT) + accelerated(OBJECT)
    stated = [replace(t, setup=SetupErrors(grasp_offset=0.001, group_friction=0.03)) for t in trials]
    exact, wide = (method.estimate(OBJECT.shape, OBJECT.total_mass, given, 0) for given in (trials, stated))
    assert exact.status == wide.status == "ok"
    assert wide.covariance is not None and exact.covariance is not None
    assert (np.diag(wide.covariance) > 4 * np.diag(exact.covariance)).all()


def test_a_grasp_offset_that_is_stated_explains_the_trials_and_one_that_is_not_does_not():
    shifts = 0.0015 * np.random.default_rng(0).standard_normal((6, 2))
    grasps = [k % len(OBJECT.shape.grasps) for k in range(6)]
    pivots = [tuple(OBJECT.shape.grasps[g].position + BESIDE) for g in grasps]
    turned = [Rotate(g, duration=2.5, pivot=p, back=True) for g, p in zip(grasps, pivots, strict=True)]
    trials = [held_beside(OBJECT, action, shift) for action, shift in zip(turned, shifts, strict=True)]
    trials += accelerated(OBJECT)
    answer = HiddenStates().estimate(OBJECT.shape, OBJECT.total_mass, trials, 0)
    assert answer.status == "unexplained" and answer.diagnostics["misfit"] > 3
    stated = [replace(t, setup=SetupErrors(grasp_offset=0.0015)) for t in trials]
    answer = HiddenStates().estimate(OBJECT.shape, OBJECT.total_mass, stated, 0)
    assert answer.status == "ok" and answer.diagnostics["misfit"] < 2
