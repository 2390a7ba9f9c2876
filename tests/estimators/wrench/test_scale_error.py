"""Error of the scale: every method and every prediction counts it alike."""

from dataclasses import replace

import numpy as np
import pytest

from estimators.identifiability.information import Assumptions, expected, observed
from estimators.registry import build_method
from estimators.testing.analytic_world import drawn_object, turns
from testbed.sensing.presets import preset
from testbed.worlds.setup_errors import SetupErrors

OBJECT, SCALE = drawn_object(2), SetupErrors(scale=0.02)
TRIALS = [replace(trial, setup=SCALE) for trial in turns(OBJECT, noise=0.05)]


@pytest.mark.parametrize("method", ["hidden_states", "least_squares", "support_aware"])
def test_a_method_knows_the_object_no_better_than_the_scale(method: str):
    found = build_method(method, {}).estimate(OBJECT.shape, OBJECT.total_mass, TRIALS, 0)
    assert found.covariance is not None
    count = OBJECT.shape.particles_per_group
    assert np.sqrt(count @ found.covariance @ count) == pytest.approx(SCALE.scale, rel=0.1)


@pytest.mark.parametrize("made", [True, False], ids=["observed", "expected"])
def test_a_report_knows_the_object_no_better_than_the_scale(made: bool):
    actions, assumptions = [trial.action for trial in TRIALS], Assumptions(setup=SCALE)
    report = (
        observed(OBJECT.shape, OBJECT.truth, TRIALS, assumptions)
        if made
        else expected(OBJECT.shape, OBJECT.truth, actions, preset("ft300s"), assumptions)
    )
    assert np.sqrt(report.covariance.sum()) == pytest.approx(SCALE.scale, rel=0.1)
