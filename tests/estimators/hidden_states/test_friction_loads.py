"""Friction loads: the linear system, its rank, and the two ways to its minimum."""

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose

from estimators.descent import OPTIMIZERS
from estimators.hidden_states.friction import closed_form, closed_form_covariance, descend_loads
from estimators.hidden_states.masses import friction_loads
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.friction_system import LinearSystem, LoadGroups, rank_of
from estimators.testing.analytic_world import analytic_trial, drawn_object, turns
from estimators.wrench.model import ModelErrors, ParticleModel
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.trajectory import Trajectory

NAMES = ("I2", "L2", "F2")
ERRORS = ModelErrors(pivot_error=0.0, force_error=0.002, torque_error=0.001)


def system_of(obj: ObjectModel, trajectories: list[Trajectory]) -> LinearSystem:
    """Q s = b with the gripper's load worked out from the truth."""
    trials = TrialWindows.of(obj.shape, obj.total_mass, trajectories, ERRORS)
    assert trials is not None
    return trials.friction_system(obj.truth)


def true_loads(obj: ObjectModel) -> np.ndarray:
    return friction_loads(obj.shape, LoadGroups.of(ParticleModel.of(obj.shape)).pairs, obj.truth)


def directions(obj: ObjectModel, action: Rotate | Slide) -> np.ndarray:
    """Three rows of Q from geometry alone, by numpy: one column a mass group."""
    x, y = (obj.shape.particles - obj.shape.grasps[action.grasp].position).T
    if isinstance(action, Slide):
        unit = np.tile([np.cos(action.direction), np.sin(action.direction)], (len(x), 1))
    else:
        unit = np.column_stack([-y, x]) / np.maximum(np.hypot(x, y), 1e-9)[:, None]
    rows = (unit[:, 0], unit[:, 1], x * unit[:, 1] - y * unit[:, 0])
    return np.array([np.bincount(obj.shape.mass_group, row, obj.shape.n_m) for row in rows])


@pytest.mark.parametrize("groups", [1, 2, 3])
def test_gather_and_spread_are_the_groups_matrix(groups):
    model = ParticleModel.of(drawn_object(1, friction_groups=groups).shape)
    found = LoadGroups.of(model)
    both = list(zip(model.mass_group.tolist(), model.friction_group.tolist(), strict=True))
    matrix = np.array([[pair == column for column in found.pairs] for pair in both], dtype=float)
    rng = np.random.default_rng(0)
    values, s = torch.tensor(rng.normal(size=(2, 3, len(both)))), rng.normal(size=len(found.pairs))
    assert_allclose(found.gather(values), values.numpy() @ matrix, atol=1e-13)
    assert_allclose(found.spread(s), matrix @ s)


@pytest.mark.parametrize("carried", [{}, {"lift": 0.5, "moment": (0.004, -0.003)}], ids=["free", "carried"])
@pytest.mark.parametrize("name", NAMES)
def test_the_truth_solves_the_system(name, carried):
    obj = load_object(name)
    slide = analytic_trial(obj, Slide(1, direction=0.7), **carried)
    system = system_of(obj, [*turns(obj, **carried), slide])
    assert_allclose(system.q.numpy() @ true_loads(obj), system.b, atol=1e-6 * float(system.b.abs().max()))
    assert_allclose(closed_form(system), true_loads(obj), rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_closed_form_is_least_squares_and_descent_arrives_there(name):
    system = system_of(load_object(name), turns(load_object(name), noise=0.05))
    exact = closed_form(system)
    free, *_ = np.linalg.lstsq(system.q.numpy(), system.b.numpy(), rcond=None)
    assert (free > 0).all()
    assert_allclose(exact, free, rtol=1e-9)
    found, traces = descend_loads(system, OPTIMIZERS, 500, 0.0)
    # 500 steps: the slowest of the three is within two parts in ten thousand of the largest load
    assert_allclose(found, exact, atol=2e-4 * exact.max())
    assert {trace.method for trace in traces} == set(OPTIMIZERS)
    for trace in traces:
        assert len(trace.loss) == 500
        assert trace.loss[-1] == pytest.approx(system.loss(exact), rel=1e-3, abs=1e-6)


def test_the_closed_form_keeps_to_the_bound_at_its_true_minimum():
    rng = np.random.default_rng(0)
    q, s = rng.normal(size=(30, 5)), np.array([1.0, -0.5, 0.3, -0.2, 0.8])
    found = closed_form(LinearSystem(torch.tensor(q), torch.tensor(q @ s), torch.eye(len(q))))
    slope = q.T @ (q @ found - q @ s)
    assert (found == 0).any()
    assert_allclose(slope[found > 0], 0, atol=1e-9)
    assert (slope[found == 0] > 0).all()


def test_the_covariance_is_the_scatter_of_the_answers():
    obj = load_object("L2")
    system = system_of(obj, turns(obj, noise=0.05))
    rng = np.random.default_rng(0)
    q, mean = system.q.numpy(), system.q.numpy() @ true_loads(obj)
    draws = [np.linalg.lstsq(q, mean + rng.normal(size=len(mean)), rcond=None)[0] for _ in range(1500)]
    claimed = closed_form_covariance(system)
    scale = np.sqrt(np.diag(claimed))
    assert_allclose(np.cov(np.array(draws).T) / np.outer(scale, scale), claimed / np.outer(scale, scale), atol=0.12)


def test_the_rank_counts_directions_whatever_the_units_of_a_column():
    q = np.random.default_rng(0).normal(size=(12, 4))
    assert rank_of(q) == rank_of(q * [1e-6, 1, 1e6, 1]) == rank_of(np.column_stack([q, q[:, 0] + q[:, 1]])) == 4
    assert rank_of(np.zeros((6, 3))) == 0


@pytest.mark.parametrize(("name", "most"), [("I1", 2), ("L1", 3), ("F1", 3)])
def test_slides_alone_never_fill_the_rank(name, most):
    obj = load_object(name)
    slides = [Slide(i % len(obj.shape.grasps), direction=0.3 + i, duration=2.5) for i in range(6)]
    for count in range(1, len(slides) + 1):
        rank = system_of(obj, [analytic_trial(obj, slide) for slide in slides[:count]]).rank
        assert rank <= min(count + 1, most)
        assert rank == rank_of(np.vstack([directions(obj, slide) for slide in slides[:count]]))
