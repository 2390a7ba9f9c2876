"""The posterior: the Gaussian where that is right, and what it is where that is wrong."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from estimators.hidden_states.estimator import HiddenStates
from estimators.identifiability.posterior import Likelihood, friction_profile, sample_posterior
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel

ESTIMATOR = HiddenStates()


def asked(obj: ObjectModel, *, inertia: bool = True) -> tuple[Estimate, Likelihood]:
    data = turns(obj, noise=0.3) + (accelerated(obj) if inertia else [])
    answer = ESTIMATOR.estimate(obj.shape, obj.total_mass, data, 0)
    assert answer.distribution is not None
    return answer, ESTIMATOR.likelihood(obj.shape, obj.total_mass, data, answer.distribution)


def with_mass(mass: list[float]) -> ObjectModel:
    obj = load_object("L2")
    each = np.array(mass) / obj.shape.particles_per_group
    return replace(obj, truth=MassDistribution(each, obj.truth.friction))


def test_away_from_the_bounds_it_is_the_gaussian():
    obj = load_object("L2")
    answer, evidence = asked(obj)
    assert answer.identifiability is not None and answer.distribution is not None
    found = sample_posterior(evidence, answer.distribution, 0, covariance=answer.covariance)
    assert found.independent > 500
    assert_allclose(found.mass.std(axis=0), answer.identifiability.standard_error, rtol=0.1)
    assert_allclose(found.friction.std(axis=0), answer.identifiability.friction_error, rtol=0.1)


def test_at_a_bound_every_draw_is_a_mass():
    obj = with_mass([0.4, 0.4, 0.0, 0.4, 0.4, 0.4])
    answer, evidence = asked(obj)
    assert answer.distribution is not None and answer.covariance is not None
    found = sample_posterior(evidence, answer.distribution, 0, covariance=answer.covariance)
    low, high = found.interval(0.9)[2]
    error = np.sqrt(answer.covariance[2, 2]) * obj.shape.particles_per_group[2]
    assert (found.mass >= 0).all()
    assert 0 < low < high < 3 * error


def test_frictions_that_cannot_be_told_apart_spread_widely():
    obj = drawn_object(0, friction_groups=2)
    answer, evidence = asked(obj, inertia=False)
    assert answer.status == "underdetermined" and answer.distribution is not None
    begin = MassDistribution(obj.truth.mass, obj.truth.friction)
    found = sample_posterior(evidence, begin, 0)
    assert (np.ptp(found.friction, axis=0) > obj.truth.friction).all()
    assert_allclose(found.mass.sum(axis=1), obj.total_mass, atol=0.01)


def test_the_same_seed_gives_the_same_draws():
    answer, evidence = asked(load_object("L2"))
    assert answer.distribution is not None
    first, again = (sample_posterior(evidence, answer.distribution, 3, steps=50) for _ in range(2))
    assert (first.mass == again.mass).all()


def test_the_profile_of_friction_is_least_at_the_answer():
    obj = load_object("L2")
    answer, evidence = asked(obj)
    assert answer.distribution is not None and answer.identifiability is not None
    centre, error = answer.distribution.friction[0], answer.identifiability.friction_error[0]
    least, masses = friction_profile(evidence, centre + error * np.array([-1.0, 0.0, 1.0]))
    # one standard error costs half a unit of log likelihood
    assert_allclose(least - least[1], [0.5, 0.0, 0.5], atol=0.1)
    assert_allclose(masses[1], answer.distribution.mass * obj.shape.particles_per_group, rtol=0.02)


def test_what_cannot_be_asked_is_refused():
    answer, evidence = asked(load_object("L2"))
    assert answer.distribution is not None
    with pytest.raises(InvalidValueError, match="at least 14"):
        sample_posterior(evidence, answer.distribution, 0, walkers=10)
    two = drawn_object(0, friction_groups=2)
    _, of_two = asked(two)
    with pytest.raises(InvalidValueError, match="sample the posterior"):
        friction_profile(of_two, np.array([0.5]))
