"""The posterior: the Gaussian away from bounds, and what differs from it elsewhere."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from estimators.hidden_states.estimator import HiddenStates
from estimators.identifiability.posterior import Likelihood, Posterior, friction_profile, sample_posterior
from estimators.testing.analytic_world import accelerated, drawn_object, turns
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel

L2 = load_object("L2")


@dataclass(frozen=True)
class Answered:
    """An object's estimate from analytic trials, and their likelihood."""

    obj: ObjectModel
    answer: Estimate
    likelihood: Likelihood

    @staticmethod
    def of(obj: ObjectModel, *, inertia: bool = True) -> Answered:
        data = turns(obj, noise=0.3) + (accelerated(obj) if inertia else [])
        answer = HiddenStates().estimate(obj.shape, obj.total_mass, data, 0)
        assert answer.distribution is not None
        return Answered(obj, answer, HiddenStates().likelihood(obj.shape, obj.total_mass, data, answer.distribution))

    @property
    def masses(self) -> MassDistribution:
        assert self.answer.distribution is not None
        return self.answer.distribution

    def sample(self, seed: int = 0, **options: Any) -> Posterior:
        return sample_posterior(self.likelihood, self.masses, seed, covariance=self.answer.covariance, **options)


@pytest.fixture(scope="module")
def l2() -> Answered:
    return Answered.of(L2)


@pytest.mark.slow
def test_away_from_the_bounds_it_is_the_gaussian(l2):
    found, report = l2.sample(steps=2000), l2.answer.identifiability
    assert found.independent > 500
    assert_allclose(found.mass.std(axis=0), report.standard_error, rtol=0.1)
    assert_allclose(found.friction.std(axis=0), report.friction_error, rtol=0.1)


@pytest.mark.slow
def test_at_a_bound_every_draw_is_a_mass():
    mass = np.array([0.4, 0.4, 0.0, 0.4, 0.4, 0.4]) / L2.shape.particles_per_group
    case = Answered.of(replace(L2, truth=MassDistribution(mass, L2.truth.friction)))
    found = case.sample(steps=1500)
    low, high = found.interval(0.9)[2]
    assert case.answer.covariance is not None
    error = np.sqrt(case.answer.covariance[2, 2]) * L2.shape.particles_per_group[2]
    assert (found.mass >= 0).all() and 0 < low < high < 3 * error


@pytest.mark.slow
def test_frictions_that_cannot_be_separated_spread_widely():
    obj = drawn_object(0, friction_groups=2)
    case = Answered.of(obj, inertia=False)
    assert case.answer.status == "underdetermined"
    found = sample_posterior(case.likelihood, obj.truth, 0, steps=2000)
    assert (np.ptp(found.friction, axis=0) > obj.truth.friction).all()
    assert_allclose(found.mass.sum(axis=1), obj.total_mass, atol=0.01)
    with pytest.raises(InvalidValueError, match="friction groups"):
        friction_profile(case.likelihood, np.array([0.5]))


def test_equal_seeds_give_equal_draws_and_few_walkers_are_refused(l2):
    first, again = (l2.sample(3, steps=50) for _ in range(2))
    assert (first.mass == again.mass).all()
    with pytest.raises(InvalidValueError, match="walkers"):
        l2.sample(walkers=10)


def test_the_profile_of_friction_is_least_at_the_answer(l2):
    center, error = l2.masses.friction[0], l2.answer.identifiability.friction_error[0]
    least, masses = friction_profile(l2.likelihood, center + error * np.array([-1.0, 0.0, 1.0]))
    # one standard error costs half a unit of log likelihood
    assert_allclose(least - least[1], [0.5, 0.0, 0.5], atol=0.1)
    assert_allclose(masses[1], l2.masses.mass * L2.shape.particles_per_group, rtol=0.02)
