"""A wrong weight, which no residual of friction shows, is told by the inertia of accelerated turns."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.estimator import HiddenStates
from estimators.testing.recorded import load_block
from scenarios.views.weight_check import check_weight
from testbed.robot.calibration.motion import wrong_motion

BLOCK = load_block("T-own_weight")


@pytest.mark.parametrize(("part", "ok"), [pytest.param(1.0, True, marks=pytest.mark.slow), (1.1, False)])
def test_a_weight_that_is_off_by_a_tenth_is_detected(part: float, ok: bool):
    shape, trials, weight = BLOCK.model.shape, BLOCK.trials("ft300s"), part * BLOCK.weighed("ft300s")
    answer = HiddenStates().estimate(shape, weight, trials, 0)
    finding = check_weight(shape, weight, trials, answer)
    assert finding is not None
    assert finding.ok == ok
    assert_allclose(finding.value, 1 / part, atol=0.03)
    assert ("weigh the object again" in finding.text) == (not ok)
    turned = [trial for trial in trials if not trial.action.accelerated]
    assert check_weight(shape, weight, turned, answer) is None
    assert (check_weight(shape, weight, trials, replace(answer, status="unexplained")) is None) == ok  # by friction
    assert check_weight(shape, weight, trials, replace(answer, status="contradictory")) is None


def test_a_wrong_sign_is_reported_once():
    trials = [t for t in BLOCK.clean if not t.action.accelerated]
    assert wrong_motion(BLOCK.model.shape, trials) == []
    turned = [replace(t, wrench_on_object_world=-t.wrench_on_object_world) for t in trials]
    (said,) = wrong_motion(BLOCK.model.shape, turned)
    assert "friction would have to push; sign or rotation is wrong" in said
    weak = [replace(t, wrench_on_object_world=np.zeros_like(t.wrench_on_object_world)) for t in trials]
    assert all("friction" not in text for text in wrong_motion(BLOCK.model.shape, weak))
