"""From trials with lifts to inertial parameters: recoveries in a world of Newton's law alone."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.inertial import (
    InertialParameters,
    column_parts,
    consistent_inertia,
    ellipsoid_of,
    homogeneous_parts,
    least_squares_inertia,
    lift_equations,
    part_ranges,
    places_of,
    solid_parts,
    true_body,
)
from testbed.actions.lift import Lift
from testbed.errors import InvalidValueError
from testbed.objects.model import Solid
from tests.fakes.lifted_world import lifted
from tests.helpers.blocks import blocks

OBJECT = blocks(["10", "11"], [0.5, 0.1, 0.3])
SHORT = Lift(0, hold=1.4)


def test_without_noise_every_method_finds_the_truth_from_a_lift():
    shape, truth = OBJECT.shape, true_body(OBJECT)
    lifts = [lifted(OBJECT, SHORT), lifted(OBJECT, Lift(1, hold=1.4))]
    for trials in (lifts[:1], lifts):
        equations = lift_equations(shape, trials)
        assert equations.rank == 10 and equations.misfit < 1e-9
        by_parts = homogeneous_parts(equations, column_parts(shape))
        bounded = consistent_inertia(equations, ellipsoid_of(shape))
        for found in (least_squares_inertia(equations), bounded, by_parts):
            assert_allclose(found.parameters.vector, truth.vector, atol=1e-8)
        assert by_parts.part_mass is not None
        assert_allclose(by_parts.part_mass, OBJECT.group_mass, atol=1e-8)
        least, most = part_ranges(equations, *places_of(shape)).T
        assert (least < OBJECT.group_mass).all() and (most > OBJECT.group_mass).all()


def test_columns_weigh_and_turn_as_the_object_does():
    truth = true_body(OBJECT)
    assert truth.mass == pytest.approx(OBJECT.total_mass)
    assert_allclose(truth.center_of_mass[:2], OBJECT.center_of_mass, atol=1e-12)
    assert truth.inertia[2, 2] == pytest.approx(OBJECT.inertia_cm)


def test_a_solid_turns_as_its_box():
    corners = np.array([[x, y, z] for x in (0.1, 0.3) for y in (0.0, 0.05) for z in (0.0, 0.02)])
    squares = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    faces = [face for a, b, c, d in squares for face in ((a, b, c), (a, c, d))]
    (found,) = solid_parts([Solid(corners, np.array(faces), 0.7)])
    sides = np.array([0.2, 0.05, 0.02]) ** 2
    assert_allclose(found.center_of_mass, [0.2, 0.025, 0.01], atol=1e-12)
    assert_allclose(found.inertia, 0.7 / 12 * np.diag(sides.sum() - sides), atol=1e-12)


def test_a_trial_without_lifts_is_refused():
    with pytest.raises(InvalidValueError, match="no lift"):
        lift_equations(OBJECT.shape, [])


@pytest.mark.slow
def test_nine_in_ten_intervals_hold_from_lifts():
    """Bias, noise and an offset in the grip, drawn as told."""
    rng, truth, hold, inside = np.random.default_rng(0), true_body(OBJECT), [], []

    def numbers(of: InertialParameters) -> np.ndarray:
        return np.concatenate([[of.mass], of.center_of_mass, np.diag(of.inertia)])

    for seed in range(20):
        offset = rng.standard_normal(3) * [5e-4, 5e-4, 1e-3]
        trial = lifted(OBJECT, SHORT, offset=(offset[0], offset[1], offset[2]), errors=1.0, seed=seed)
        equations = lift_equations(OBJECT.shape, [trial])
        low, high = least_squares_inertia(equations).interval(numbers)
        hold.append((low <= numbers(truth)) & (numbers(truth) <= high))
        least, most = part_ranges(equations, *places_of(OBJECT.shape)).T
        inside.append((least <= OBJECT.group_mass) & (OBJECT.group_mass <= most))
    assert 0.82 < np.mean(hold) < 0.98
    assert np.mean(inside) > 0.9
