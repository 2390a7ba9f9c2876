"""Errors of a setup: what each is predicted to change is the change of the wrenches where the setup really is so."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.baselines.optimizers import LeastSquares
from estimators.hidden_states.estimator import HiddenStates
from estimators.particles.windows import PLANAR
from estimators.posterior.on_table import OnTable
from estimators.posterior.priors import priors
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object, turns
from estimators.wrench.model import ModelErrors, ParticleModel
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors
from tests.fakes.flawed_bench import held_beside, turns_beside
from tests.helpers.answers import ask, claimed, trials_of, true_values, windows_of

OBJECT, BESIDE = drawn_object(0), np.array([0.01, 0.015])
ACTIONS = [
    Rotate(grasp, duration=2.5, pivot=tuple(OBJECT.shape.grasps[grasp].position + BESIDE), back=back)
    for grasp, back in ((0, True), (1, False), (2, True))
]


def test_windows_belong_to_their_caller():
    trials = turns(OBJECT, [0])
    first = windows_of(OBJECT, trials)
    before = first.wrench.clone()
    first.wrench.mul_(2.0)
    assert_allclose(windows_of(OBJECT, trials).wrench, before, rtol=0)


def change(trials, setup=EXACT_SETUP, **errors):
    """Change of the planar wrenches that errors of a setup are predicted to make."""
    windows, theta = replace(windows_of(OBJECT, trials), setup=setup), true_values(OBJECT)
    on_table = OnTable.of(OBJECT.shape, windows, "own_weight", ModelErrors())

    def rows(theta):
        predict = torch.vmap(lambda window: on_table.predict(theta, window))
        return predict(on_table.table.windows)[:, PLANAR].numpy().ravel()

    off = {name: torch.as_tensor(value, dtype=torch.float64) for name, value in errors.items()}
    return rows(theta | off) - rows(theta)


def wrenches(trials):
    return windows_of(OBJECT, trials).wrench.numpy().ravel()


@pytest.mark.parametrize("millimeters", [0.0, 0.5, 1.0, 2.0, 5.0])
def test_a_known_foot_near_the_pivot_drags_as_in_the_mean_over_the_errors_of_its_place(millimeters):
    foot = OBJECT.shape.particles[np.argmin(np.linalg.norm(OBJECT.shape.particles - [0.0, 0.02], axis=1))]
    beside = Rotate(0, duration=2.5, pivot=(float(foot[0]) + 1e-3 * millimeters, float(foot[1])))
    model, exact = ParticleModel.of(OBJECT.shape), windows_of(OBJECT, [analytic_trial(OBJECT, beside)])
    stated = SetupErrors(grasp_offset=5e-4, particle_offset=5e-4)
    each = torch.ones(len(model.particles), dtype=torch.float64)
    sharp = exact.table(model, 1e-6).dragged(each)
    offsets = torch.tensor(np.random.default_rng(0).normal(0, 5e-4 * 2**0.5, (2000, 2)))
    mean = torch.vmap(lambda offset: sharp.rows({"grasp_offset": offset}), chunk_size=500)(offsets).mean(0)
    faded = replace(exact, setup=stated).table(model, 1e-6).dragged(each).rows({})
    assert_allclose(faded[:, :2], mean[:, :2], atol=0.12)  # a foot drags 1 N
    if 0 < millimeters < 1:
        assert float((sharp.rows({}) - mean)[:, :2].norm(dim=1).min()) > 0.4


def test_groups_of_more_friction_drag_more():
    more = replace(OBJECT, truth=replace(OBJECT.truth, mass=OBJECT.truth.mass * [1.02, 1, 1, 1, 1, 1]))
    plain, harder = ([analytic_trial(obj, Slide(0, 0.3))] for obj in (OBJECT, more))
    assert_allclose(change(plain, group_friction=[0.02, 0, 0, 0, 0, 0]), wrenches(harder) - wrenches(plain), atol=1e-6)


def test_a_gain_of_all_axes_scales_the_wrench():
    plain = [analytic_trial(OBJECT, action) for action in ACTIONS]
    scaled = change(plain, gain=[0.01] * 6).reshape(-1, 3)
    assert_allclose(scaled, 0.01 * wrenches(plain).reshape(-1, 3), atol=1e-5)


def test_where_all_move_alike_the_pattern_of_contact_does_not_matter():
    few = SetupErrors(contact_points=3)
    shape = priors(OBJECT.shape, few, ModelErrors(), 1.0, 1).blocks["contact_points"].mean.shape
    pattern = 0.1 * np.random.default_rng(0).standard_normal(shape)
    pattern[:, :2] = 0.0  # those that carry a group off its middle
    slid = change([analytic_trial(OBJECT, Slide(0, 0.3))], few, contact_points=pattern)
    turned = change([analytic_trial(OBJECT, ACTIONS[0])], few, contact_points=pattern)
    assert np.abs(slid).max() < 1e-9 and np.abs(turned).max() > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("method", [HiddenStates(), LeastSquares()], ids=["hidden_states", "least_squares"])
def test_errors_that_are_stated_widen_the_answers_own(method):
    setups = EXACT_SETUP, SetupErrors(grasp_offset=0.001, group_friction=0.03)
    exact, wide = (ask(OBJECT, [replace(t, setup=setup) for t in trials_of(OBJECT)], method) for setup in setups)
    assert exact.status == wide.status == "ok"
    assert (claimed(wide) > 2 * claimed(exact)).all()


def test_a_grasp_offset_that_is_stated_explains_the_trials_and_one_that_is_not_does_not():
    shifts = 0.0015 * np.random.default_rng(0).standard_normal((6, 2))
    turned = turns_beside(OBJECT, BESIDE)
    trials = [held_beside(OBJECT, action, shift) for action, shift in zip(turned, shifts, strict=True)]
    trials += accelerated(OBJECT)
    answer = ask(OBJECT, trials)
    assert answer.status == "unexplained" and answer.diagnostics["misfit"] > 3
    answer = ask(OBJECT, [replace(t, setup=SetupErrors(grasp_offset=0.0015)) for t in trials])
    assert answer.status == "ok" and answer.diagnostics["misfit"] < 2
