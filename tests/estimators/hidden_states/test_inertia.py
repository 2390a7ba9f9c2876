"""Moments of inertia by slope, then the centre of mass and I_cm by the parallel-axis theorem."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.hidden_states.inertia import com_and_inertia
from estimators.particles.pivots import PivotInertia, pivot_inertias
from estimators.particles.windows import Observations, observe
from estimators.testing.analytic_world import accelerated, analytic_trial, drawn_object
from testbed.actions.accelerate import Accelerate
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.trajectory import Trajectory

OFF_ROW = np.array([[0.0, 0.0], [0.05, 0.01], [-0.02, 0.08], [0.03, -0.06]])
ROW = np.array([[-0.1, 0.02], [0.0, 0.02], [0.05, 0.02]])


def about(obj: ObjectModel, point: np.ndarray) -> float:
    """Moment of inertia about a point, cell by cell, kg m^2."""
    squares = np.sum((obj.shape.particles - point) ** 2, axis=1) + obj.shape.cell**2 / 6
    return float(obj.particle_mass @ squares)


def exact_pivots(obj: ObjectModel, points: np.ndarray) -> PivotInertia:
    return PivotInertia(points, np.array([about(obj, p) for p in points]), np.full(len(points), 1e-12))


def observed(obj: ObjectModel, trajectories: list[Trajectory]) -> Observations:
    found = observe(obj.shape, trajectories)
    assert found is not None
    return found


def slopes(obj: ObjectModel, trajectories: list[Trajectory], relative_error: float = 0.0) -> PivotInertia:
    """I_j of turns about the grasp with an even load: friction is constant and the grasp point does not accelerate."""
    windows = observed(obj, trajectories)
    zero = np.zeros(len(windows))
    found = pivot_inertias(windows, zero, zero, relative_error)
    assert found is not None
    return found


@pytest.mark.parametrize("name", ["I1", "I2", "L1", "L2", "F1", "F2"])
def test_the_slope_is_the_moment_of_inertia(name):
    obj = load_object(name)
    found = slopes(obj, accelerated(obj))
    assert len(found.pivot) == len(obj.shape.grasps)
    # the turn is steady to rounding; acceleration itself is a slope of samples
    assert_allclose(found.inertia, [about(obj, p) for p in found.pivot], rtol=1e-5)


def test_turns_of_both_directions_about_one_point_are_one_pivot():
    obj = load_object("L2")
    there = Accelerate(1)
    back = Accelerate(1, tuple(-a for a in there.accelerations), start_speed=-there.start_speed)
    found = slopes(obj, [analytic_trial(obj, there), analytic_trial(obj, back)])
    assert_allclose(found.pivot, [obj.shape.grasps[1].position], atol=1e-9)
    assert_allclose(found.inertia, about(obj, found.pivot[0]), rtol=1e-5)


def test_a_constant_torque_of_its_own_in_every_trial_changes_nothing():
    obj = load_object("F2")
    clean = [analytic_trial(obj, Accelerate(0)), analytic_trial(obj, Accelerate(0)), analytic_trial(obj, Accelerate(2))]
    offset = [
        replace(t, wrench_on_object_world=t.wrench_on_object_world + np.array([0, 0, 0, 0, 0, shift]))
        for t, shift in zip(clean, (0.3, -0.2, 0.1), strict=True)
    ]
    assert_allclose(slopes(obj, offset).inertia, slopes(obj, clean).inertia, rtol=1e-9)


def test_known_torques_are_taken_away():
    obj = load_object("F2")
    windows = observed(obj, accelerated(obj))
    rng = np.random.default_rng(0)
    friction, inertial = rng.normal(size=(2, len(windows)))
    torque = windows.wrench.clone()
    torque[:, 2] += windows.wrench.new_tensor(friction + inertial)
    zero = np.zeros(len(windows))
    plain = pivot_inertias(windows, zero, zero, 0.0)
    corrected = pivot_inertias(replace(windows, wrench=torque), friction, inertial, 0.0)
    assert plain is not None
    assert corrected is not None
    assert_allclose(corrected.inertia, plain.inertia, rtol=1e-9)


def test_the_variance_is_the_scatter_of_the_slopes():
    obj = load_object("L2")
    runs = [slopes(obj, [analytic_trial(obj, Accelerate(0), noise=0.2, seed=s)]) for s in range(150)]
    scatter = np.std([run.inertia[0] for run in runs])
    claimed = np.sqrt(np.mean([run.variance[0] for run in runs]))
    assert claimed == pytest.approx(scatter, rel=0.3)
    bound = slopes(obj, [analytic_trial(obj, Accelerate(0))], relative_error=0.01)
    assert np.sqrt(bound.variance[0]) >= 0.01 * bound.inertia[0]


def test_no_accelerated_turn_gives_no_pivot():
    obj = load_object("L2")
    windows = observed(obj, accelerated(obj))
    empty = windows.where(~windows.accelerated)
    assert pivot_inertias(empty, np.zeros(0), np.zeros(0), 0.0) is None
    assert np.isnan(com_and_inertia(None, 1.0).inertia_cm)


@pytest.mark.parametrize("seed", range(4))
def test_centre_and_inertia_come_back_from_pivots_off_one_row(seed):
    obj = drawn_object(seed)
    found = com_and_inertia(exact_pivots(obj, OFF_ROW), obj.total_mass)
    assert_allclose(found.center_of_mass, obj.center_of_mass, atol=1e-10)
    assert found.inertia_cm == pytest.approx(obj.inertia_cm, rel=1e-9)
    assert found.unobserved == ""


def test_the_answer_obeys_the_parallel_axis_theorem_and_moves_with_the_frame():
    obj = drawn_object(1)
    pivots = exact_pivots(obj, OFF_ROW)
    found = com_and_inertia(pivots, obj.total_mass)
    squares = np.sum((OFF_ROW - found.center_of_mass) ** 2, axis=1)
    assert_allclose(found.inertia_cm + obj.total_mass * squares, pivots.inertia)
    turn, shift = np.array([[0.6, -0.8], [0.8, 0.6]]), np.array([0.3, -0.2])
    moved = com_and_inertia(replace(pivots, pivot=OFF_ROW @ turn.T + shift), obj.total_mass)
    assert_allclose(moved.center_of_mass, turn @ found.center_of_mass + shift, atol=1e-10)
    assert moved.inertia_cm == pytest.approx(found.inertia_cm)


def test_a_pivot_known_badly_hardly_counts():
    obj = drawn_object(1)
    pivots = exact_pivots(obj, OFF_ROW)
    wrong = replace(pivots, inertia=pivots.inertia * [1, 1, 1, 2], variance=np.array([1e-12, 1e-12, 1e-12, 1.0]))
    assert_allclose(com_and_inertia(wrong, obj.total_mass).center_of_mass, obj.center_of_mass, atol=1e-7)


def test_a_straight_row_gives_no_number_across_itself():
    obj = drawn_object(1)
    found = com_and_inertia(exact_pivots(obj, ROW), obj.total_mass)
    assert found.center_of_mass[0] == pytest.approx(obj.center_of_mass[0], abs=1e-10)
    assert np.isnan(found.center_of_mass[1])
    assert np.isnan(found.inertia_cm)
    bound = obj.inertia_cm + obj.total_mass * (obj.center_of_mass[1] - 0.02) ** 2
    assert "straight row along" in found.unobserved
    assert "confounded with I_cm" in found.unobserved
    assert f"= {bound:.6f} kg m^2" in found.unobserved


def test_a_slanted_row_gives_neither_component():
    obj = drawn_object(1)
    found = com_and_inertia(exact_pivots(obj, np.array([[0.0, 0.0], [0.03, 0.03], [0.1, 0.1]])), obj.total_mass)
    assert np.isnan(found.center_of_mass).all()
    assert np.isnan(found.inertia_cm)
    assert "straight row" in found.unobserved


def test_two_pivots_are_a_row_and_one_is_too_few():
    obj = drawn_object(1)
    assert "straight row" in com_and_inertia(exact_pivots(obj, OFF_ROW[:2]), obj.total_mass).unobserved
    alone = com_and_inertia(exact_pivots(obj, OFF_ROW[:1]), obj.total_mass)
    assert np.isnan(alone.center_of_mass).all()
    assert "fewer than two pivots" in alone.unobserved
