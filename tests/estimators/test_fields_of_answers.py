"""Every field of an answer is checked when the answer is made."""

from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.base import Estimate
from estimators.testing.analytic_world import drawn_object
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution

MASSES = MassDistribution(np.array([0.1, 0.2]), np.array([0.5]))


def answer(**fields: Any) -> Estimate:
    return Estimate(**{"distribution": MASSES, "status": "ok"} | fields)


@pytest.mark.parametrize(
    ("fields", "said"),
    [
        ({"status": "fine"}, "Estimate.status: got 'fine'"),
        ({"distribution": np.ones(2)}, "a MassDistribution, or None"),
        ({"distribution": None}, "a MassDistribution where the status is ok"),
        ({"distribution": MassDistribution(np.array([4e300, 0.1]), np.array([0.5]))}, "at most 1000 kg per particle"),
        ({"covariance": np.full((2, 2), np.nan)}, "Estimate.covariance: got '4 NaN'"),
        ({"covariance": np.diag([-1e-4, 1e-4])}, "variances >= 0"),
        ({"covariance": np.array([[1.0, 0.5], [0.0, 1.0]])}, "a symmetric matrix"),
        ({"covariance": np.ones(2)}, r"Estimate.covariance: got 'shape \(2,\)'"),
        ({"covariance": np.ones((2, 3))}, "as many rows as columns"),
        ({"diagnostics": [1.0]}, "a dict of numbers by name"),
        ({"diagnostics": "misfit 1"}, "a dict of numbers by name"),
        ({"diagnostics": None}, "a dict of numbers by name"),
        ({"diagnostics": {"steps": np.ones(3)}}, r"Estimate.diagnostics\['steps'\]"),
        ({"diagnostics": {3: 1.0}}, "a number, by a name"),
        ({"message": None}, "Estimate.message: got None; allowed: text"),
        ({"assumes": 3}, "Estimate.assumes: got 3; allowed: text"),
        ({"seconds": float("nan")}, "Estimate.seconds: got nan"),
        ({"traces": [1]}, "a tuple of Traces"),
        ({"hidden": {}}, "a HiddenStateEstimate, or None"),
        ({"identifiability": "rank 3"}, "an Identifiability, or None"),
    ],
)
def test_a_field_of_another_kind_is_refused_by_its_name(fields: dict[str, Any], said: str):
    with pytest.raises(InvalidValueError, match=said):
        answer(**fields)


def test_what_is_not_observed_may_have_an_infinite_error():
    found = answer(covariance=np.diag([np.inf, -1e-17]), diagnostics={"rank": 1, "left": np.float32(0.5)})
    assert found.covariance is not None
    assert found.covariance.tolist() == [[np.inf, 0.0], [0.0, 0.0]]


def test_masses_and_errors_are_those_of_whole_groups():
    obj = drawn_object(0)
    count, known = obj.shape.particles_per_group, Estimate(obj.truth, "ok", covariance=np.diag(np.full(6, 4e-6)))
    mass, error = known.group_mass(obj.shape), known.group_error(obj.shape)
    assert mass is not None and error is not None
    assert_allclose(mass, obj.group_mass)
    assert_allclose(error, 2e-3 * count)
    none = Estimate(None, "no_data")
    assert none.group_mass(obj.shape) is None and none.group_error(obj.shape) is None
