"""Moments of inertia by slope, then the center of mass and I_cm by the parallel-axis theorem."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.inertia import com_and_inertia
from estimators.particles.observe import observe
from estimators.particles.pivots import PivotInertia, inertia_map, pivot_inertias
from estimators.particles.windows import Observations
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object
from testbed.actions.accelerate import Accelerate
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.trajectory import Trajectory

OFF_ROW = np.array([[0.0, 0.0], [0.05, 0.01], [-0.02, 0.08], [0.03, -0.06]])
OBJECT = drawn_object(1)
L2, F2 = load_object("L2"), load_object("F2")


def about(obj: ObjectModel, points: np.ndarray) -> np.ndarray:
    """Moments of inertia about some points, cell by cell, kg m^2."""
    squares = np.sum((obj.shape.particles - np.asarray(points)[:, None]) ** 2, axis=2) + obj.shape.cell**2 / 6
    return squares @ obj.particle_mass


def exact_pivots(obj: ObjectModel, points: np.ndarray) -> PivotInertia:
    return PivotInertia(points, about(obj, points), np.full(len(points), 1e-12))


def observed(obj: ObjectModel, trajectories: list[Trajectory]) -> Observations:
    found = observe(obj.shape, trajectories)
    assert found is not None
    return found


def slopes(windows: Observations, relative_error: float = 0.0) -> PivotInertia:
    """I_j of turns about the grasp with an even load: friction is constant and the grasp point does not accelerate."""
    zero = np.zeros(len(windows))
    found = pivot_inertias(windows, zero, zero, relative_error)
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["I1", "I2", "L1", "L2", "F1", "F2"])
def test_the_slope_is_the_moment_of_inertia(name):
    obj = load_object(name)
    found = slopes(observed(obj, accelerated(obj)))
    assert len(found.pivot) == len(obj.shape.grasps)
    # the turn is steady to rounding; acceleration itself is a slope of samples
    assert_allclose(found.inertia, about(obj, found.pivot), rtol=1e-5)
    assert_allclose(inertia_map(obj.shape, found.pivot) @ obj.truth.mass, about(obj, found.pivot))


def test_turns_of_both_directions_about_one_point_are_one_pivot():
    there = Accelerate(1)
    back = Accelerate(1, tuple(-a for a in there.accelerations), start_speed=-there.start_speed)
    found = slopes(observed(L2, [analytic_trial(L2, there), analytic_trial(L2, back)]))
    assert_allclose(found.pivot, [L2.shape.grasps[1].position], atol=1e-9)
    assert_allclose(found.inertia, about(L2, found.pivot), rtol=1e-5)


def test_a_constant_of_every_trial_and_known_torques_are_taken_away():
    windows = observed(F2, [analytic_trial(F2, Accelerate(grasp)) for grasp in (0, 0, 2)])
    friction, inertial = np.random.default_rng(0).normal(size=(2, len(windows)))
    constant = np.array([0.3, -0.2, 0.1])[windows.trial]
    torque = windows.wrench.clone()
    torque[:, 2] += windows.wrench.new_tensor(friction + inertial + constant)
    corrected = pivot_inertias(replace(windows, wrench=torque), friction, inertial, 0.0)
    assert corrected is not None
    assert_allclose(corrected.inertia, slopes(windows).inertia, rtol=1e-9)


def test_the_variance_is_the_scatter_of_the_slopes():
    clean = observed(L2, [analytic_trial(L2, Accelerate(0))])
    noisy = observed(L2, [analytic_trial(L2, Accelerate(0), noise=0.2)])
    rng, runs = np.random.default_rng(0), []
    for _ in range(150):
        wrench = clean.wrench.clone()
        wrench[:, 2] += wrench.new_tensor(rng.standard_normal(len(wrench))) * noisy.covariance[:, 2, 2].sqrt()
        runs.append(slopes(replace(noisy, wrench=wrench)))
    scatter = np.std([run.inertia[0] for run in runs])
    claimed = np.sqrt(np.mean([run.variance[0] for run in runs]))
    assert claimed == pytest.approx(scatter, rel=0.3)
    bound = slopes(clean, relative_error=0.01)
    assert np.sqrt(bound.variance[0]) >= 0.01 * bound.inertia[0]


def test_no_accelerated_turn_gives_no_pivot():
    windows = observed(L2, accelerated(L2))
    empty = windows.where(~windows.accelerated)
    assert pivot_inertias(empty, np.zeros(0), np.zeros(0), 0.0) is None


@pytest.mark.parametrize("seed", range(4))
def test_center_and_inertia_come_back_from_pivots_off_one_row(seed):
    obj = drawn_object(seed)
    found = com_and_inertia(exact_pivots(obj, OFF_ROW), obj.total_mass)
    assert_allclose(found.center_of_mass, obj.center_of_mass, atol=1e-10)
    assert found.inertia_cm == pytest.approx(obj.inertia_cm, rel=1e-9)
    assert found.unobserved == ""


def test_the_answer_obeys_the_parallel_axis_theorem_and_moves_with_the_frame():
    pivots = exact_pivots(OBJECT, OFF_ROW)
    found = com_and_inertia(pivots, OBJECT.total_mass)
    squares = np.sum((OFF_ROW - found.center_of_mass) ** 2, axis=1)
    assert_allclose(found.inertia_cm + OBJECT.total_mass * squares, pivots.inertia)
    turn, shift = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([0.3, -0.2])
    moved = com_and_inertia(replace(pivots, pivot=OFF_ROW @ turn.T + shift), OBJECT.total_mass)
    assert_allclose(moved.center_of_mass, turn @ found.center_of_mass + shift, atol=1e-10)
    assert moved.inertia_cm == pytest.approx(found.inertia_cm)


def test_a_pivot_known_badly_hardly_counts():
    pivots = exact_pivots(OBJECT, OFF_ROW)
    wrong = replace(pivots, inertia=pivots.inertia * [1, 1, 1, 2], variance=np.array([1e-12, 1e-12, 1e-12, 1.0]))
    assert_allclose(com_and_inertia(wrong, OBJECT.total_mass).center_of_mass, OBJECT.center_of_mass, atol=1e-7)


def test_a_straight_row_gives_no_number_across_itself():
    row = np.array([[-0.1, 0.02], [0.0, 0.02], [0.05, 0.02]])
    found = com_and_inertia(exact_pivots(OBJECT, row), OBJECT.total_mass)
    assert found.center_of_mass[0] == pytest.approx(OBJECT.center_of_mass[0], abs=1e-10)
    assert np.isnan([found.center_of_mass[1], found.inertia_cm]).all()
    bound = OBJECT.inertia_cm + OBJECT.total_mass * (OBJECT.center_of_mass[1] - 0.02) ** 2
    assert "straight row" in found.unobserved
    assert f"= {bound:.6f} kg m^2" in found.unobserved


@pytest.mark.parametrize(
    ("points", "why"),
    [
        (np.array([[0.0, 0.0], [0.03, 0.03], [0.1, 0.1]]), "straight row"),
        (OFF_ROW[:2], "straight row"),
        (OFF_ROW[:1], "fewer than two pivots"),
        (None, "fewer than two pivots"),
    ],
    ids=["slanted row", "two", "one", "none"],
)
def test_too_few_pivots_give_no_center_and_say_why(points, why):
    found = com_and_inertia(None if points is None else exact_pivots(OBJECT, points), OBJECT.total_mass)
    assert np.isnan([*found.center_of_mass, found.inertia_cm]).all()
    assert why in found.unobserved
