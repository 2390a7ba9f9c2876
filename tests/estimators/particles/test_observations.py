"""What the trials say: a window's mean friction is the mean over its motion."""

from __future__ import annotations

import pytest

from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.testing.analytic_world import drawn_object, turns


@pytest.mark.parametrize("seed", range(3))
def test_masses_come_back_where_the_centre_of_a_turn_wanders(seed: int):
    obj = drawn_object(seed)
    answer = HiddenStates().estimate(obj.shape, obj.total_mass, turns(obj, wander=0.006), 0)
    assert answer.distribution is not None
    assert normalized_absolute_difference(obj.shape, answer.distribution, obj.truth) < 8e-4
