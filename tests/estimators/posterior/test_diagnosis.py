"""Tests of the diagnosis: it distinguishes the support, a single trial, the weight and errors of the setup."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.posterior.diagnosis import Cause, diagnose
from estimators.posterior.posterior import CAUSES
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object
from estimators.testing.recorded import load_block
from testbed.worlds.presets import world
from testbed.worlds.setup_errors import SetupErrors
from tests.fakes.flawed_bench import held_beside, on_anisotropic_table, turns_beside

BLOCK = load_block("I2-own_weight")
SHAPE, WEIGHT = BLOCK.model.shape, BLOCK.weighed("ft300s")
TRIALS = BLOCK.trials("ft300s")
OBJECT, BESIDE = drawn_object(0), (0.01, 0.015)


def diagnosed(shape, weight, trials):
    """Diagnosis of trials, some of them usable."""
    found = diagnose(shape, weight, trials)
    assert found is not None
    return found


def flipped(trial):
    wrench = {"sensor_wrench": -trial.sensor_wrench, "wrench_on_object_world": -trial.wrench_on_object_world}
    return replace(trial, **wrench)


def regripped(trial):
    return replace(trial, action=replace(trial.action, grasp=(trial.action.grasp + 1) % len(SHAPE.grasps)))


@pytest.mark.parametrize(
    "setup",
    [pytest.param(TRIALS[0].setup, id="exact"), pytest.param(world("lab").stated, id="lab", marks=pytest.mark.slow)],
)
def test_trials_that_agree_are_said_to(setup):
    found = diagnosed(SHAPE, WEIGHT, [replace(trial, setup=setup) for trial in TRIALS])
    assert found.misfit.by_chance
    assert found.verdict.endswith("the trials agree within the errors stated")
    assert set(found.trials) == set(range(len(TRIALS)))


@pytest.mark.slow
@pytest.mark.parametrize(("wrong", "number"), [(flipped, 4), (regripped, 3)])
def test_a_wrong_trial_is_named(wrong, number):
    trials = list(TRIALS)
    trials[number - 1] = wrong(trials[number - 1])
    found = diagnosed(SHAPE, WEIGHT, trials)
    assert f"trial {number} does not agree with the others" in found.verdict
    assert found.without < 1.5


@pytest.mark.slow
def test_a_wrong_weight_is_named():
    found = diagnosed(SHAPE, 1.2 * WEIGHT, TRIALS)
    assert found.odd_trial is None
    assert "weigh the object again" in found.verdict


@pytest.mark.slow
def test_one_rigid_body_comes_before_any_error_of_the_setup():
    block = load_block("I2-rigid")
    found = diagnosed(block.model.shape, block.weighed("ft300s"), block.trials("ft300s"))
    assert found.support is not None and found.support.kind == "rigid"
    assert "as under one rigid body" in found.verdict and "ask support_aware" in found.verdict


@pytest.mark.parametrize(
    "stated",
    [
        pytest.param(SetupErrors(), marks=pytest.mark.slow, id="exact"),
        pytest.param(SetupErrors(grasp_offset=0.0005, gain=0.01, crosstalk=0.01), id="smaller"),
    ],
)
def test_grasps_that_are_off_are_named_with_their_size(stated):
    shifts = 0.0015 * np.random.default_rng(2).standard_normal((6, 2))
    turned = zip(turns_beside(OBJECT, BESIDE), shifts, strict=True)
    trials = [held_beside(OBJECT, action, shift) for action, shift in turned] + accelerated(OBJECT)
    found = diagnosed(OBJECT.shape, OBJECT.total_mass, [replace(trial, setup=stated) for trial in trials])
    assert found.causes[0].name == "grasp_offset"
    assert found.causes[0].size == pytest.approx(np.sqrt(np.sum(shifts**2) / (2 * len(trials))), rel=0.15)
    assert found.verdict.endswith(CAUSES["grasp_offset"].cause)


@pytest.mark.slow
def test_friction_that_differs_by_direction_is_named_with_its_size():
    plain = [analytic_trial(OBJECT, action) for action in turns_beside(OBJECT, BESIDE)]
    trials = [on_anisotropic_table(OBJECT, trial, 0.85, 0.4) for trial in plain]
    found = diagnosed(OBJECT.shape, OBJECT.total_mass, trials)
    assert found.causes[0].name == "anisotropy"
    assert found.verdict.endswith(CAUSES["anisotropy"].cause)


def test_sizes_are_in_words():
    assert Cause("grasp_offset", 3.0, 0.0021, absurd=False).formatted == "2.1 mm"
