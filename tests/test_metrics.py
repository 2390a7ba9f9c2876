"""NAD as the paper defines it."""

from __future__ import annotations

import numpy as np
import pytest
from analytic_world import drawn_object

from estimators.metrics import normalized_absolute_difference
from testbed.errors import InvalidValueError
from testbed.objects import MassDistribution, ObjectShape

OBJECT = drawn_object(0)
FRICTION = np.array([0.5])


def masses(values: np.ndarray) -> MassDistribution:
    return MassDistribution(values, FRICTION)


@pytest.mark.parametrize("seed", range(4))
def test_nad_is_the_sum_over_particles(seed):
    found = np.random.default_rng(seed).uniform(0, 0.1, OBJECT.shape.n_m)
    particles = np.abs(found[OBJECT.shape.mass_group] - OBJECT.particle_mass).sum() / OBJECT.total_mass
    assert normalized_absolute_difference(OBJECT.shape, masses(found), OBJECT.truth) == pytest.approx(particles)


def test_nad_is_zero_for_the_truth_alone():
    assert normalized_absolute_difference(OBJECT.shape, OBJECT.truth, OBJECT.truth) == 0
    nearly = masses(OBJECT.truth.mass + 1e-9 * np.eye(OBJECT.shape.n_m)[0])
    assert normalized_absolute_difference(OBJECT.shape, nearly, OBJECT.truth) > 0


def test_friction_does_not_count():
    slippery = MassDistribution(OBJECT.truth.mass, OBJECT.truth.friction / 2)
    assert normalized_absolute_difference(OBJECT.shape, slippery, OBJECT.truth) == 0


def test_all_mass_in_the_wrong_place_is_two():
    first, last = np.eye(OBJECT.shape.n_m)[[0, -1]]
    assert normalized_absolute_difference(OBJECT.shape, masses(first), masses(last)) == pytest.approx(2)


def test_the_unit_of_mass_does_not_count():
    found = np.linspace(0.01, 0.05, OBJECT.shape.n_m)
    once = normalized_absolute_difference(OBJECT.shape, masses(found), OBJECT.truth)
    grams = normalized_absolute_difference(OBJECT.shape, masses(1e3 * found), masses(1e3 * OBJECT.truth.mass))
    assert grams == pytest.approx(once)


def test_a_group_counts_for_each_of_its_particles():
    shape = ObjectShape(np.array([[0.0, 0], [1, 0], [2, 0], [3, 0]]), np.array([0, 1, 1, 1]), np.zeros(4, int), 1, 1)
    # one particle of 4 against three of 1: 1 too few in each of the three, 1 too many in the one
    found, truth = masses(np.array([5.0, 0.0])), masses(np.array([4.0, 1.0]))
    assert normalized_absolute_difference(shape, found, truth) == pytest.approx(4 / 7)


def test_masses_that_do_not_fit_the_shape_are_refused_by_name():
    short = masses(np.ones(OBJECT.shape.n_m - 1))
    with pytest.raises(InvalidValueError, match=r"estimate\.mass"):
        normalized_absolute_difference(OBJECT.shape, short, OBJECT.truth)
    with pytest.raises(InvalidValueError, match=r"truth\.mass"):
        normalized_absolute_difference(OBJECT.shape, OBJECT.truth, short)
