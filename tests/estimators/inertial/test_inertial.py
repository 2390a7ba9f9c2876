"""Inertial parameters of a held body: the wrench of point masses, recoveries, and intervals that hold."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.inertial import (
    Ellipsoid,
    HeldMotion,
    InertialParameters,
    consistent_inertia,
    homogeneous_parts,
    inertial_equations,
    joined,
    least_squares_inertia,
    pseudo_inertia,
)
from estimators.inertial.body import shift_map
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY
from testbed.sensing.presets import preset

FT300S, IDEAL = preset("ft300s"), preset("ideal")
DT = 0.01


def body(seed: int = 0, count: int = 3) -> tuple[list[InertialParameters], np.ndarray, InertialParameters]:
    """Parts of a few point masses each, the mass of every part, and the whole."""
    rng = np.random.default_rng(seed)
    parts = []
    for k in range(count):
        places = 0.02 * rng.standard_normal((20, 3)) + np.array([0.05 * k, 0.01 * k**2, 0.1])
        parts.append(InertialParameters.of_points(places, np.full(20, 1 / 20)))
    masses = rng.uniform(0.1, 0.5, count)
    return parts, masses, InertialParameters.of_vector(np.column_stack([p.vector for p in parts]) @ masses)


def motion(whole: InertialParameters, *, still: bool = False, seconds: float = 12.0) -> HeldMotion:
    """Stop and go: tilts about several axes, each held still for a while; differentiated without error."""
    time = np.arange(0.0, seconds, DT)
    go = np.sin(np.pi * np.clip(time % 3.0, 0.0, 1.5) / 1.5) ** 2 * (not still)
    held = np.floor(time / 3.0)
    axes = np.random.default_rng(1).standard_normal((int(held.max()) + 1, 3))
    tilt = Rotation.from_rotvec(0.5 * axes[held.astype(int)])
    rate = 2.0 * go[:, None] * axes[held.astype(int)]
    alpha = np.gradient(rate, DT, axis=0)
    linear = 1.5 * go[:, None] * np.roll(axes[held.astype(int)], 1, axis=1)
    pull = linear + tilt.inv().apply([0.0, 0.0, GRAVITY])
    exact = HeldMotion(time, pull, rate, alpha, np.zeros((len(time), 6)))
    return replace(exact, wrench=exact.regressor @ whole.vector)


def noisy(exact: HeldMotion, seed: int) -> HeldMotion:
    """What an FT-300S measures of a motion."""
    rng, count = np.random.default_rng(seed), len(exact.time_s)
    white = rng.standard_normal((count, 6)) * [*FT300S.force_noise, *FT300S.torque_noise]
    for t in range(1, count):
        white[t] = FT300S.lag1 * white[t - 1] + np.sqrt(1 - FT300S.lag1**2) * white[t]
    walk = np.cumsum(np.sqrt(DT) * rng.standard_normal((count, 6)), axis=0) * FT300S.drift_std
    return replace(exact, wrench=exact.wrench + white + walk + FT300S.bias_std * rng.standard_normal(6))


def test_the_wrench_is_that_of_point_masses():
    rng = np.random.default_rng(3)
    places, masses = rng.standard_normal((7, 3)), rng.uniform(0.1, 1, 7)
    pull, rate, alpha = rng.standard_normal((3, 2, 3))
    held = HeldMotion(np.arange(2.0), pull, rate, alpha, np.zeros((2, 6)))
    for t in range(2):
        forces = masses[:, None] * (pull[t] + np.cross(alpha[t], places) + np.cross(rate[t], np.cross(rate[t], places)))
        wrench = np.concatenate([forces.sum(axis=0), np.cross(places, forces).sum(axis=0)])
        whole = InertialParameters.of_points(places, masses)
        assert_allclose(held.regressor[t] @ whole.vector, wrench, atol=1e-12)


def test_parameters_go_to_other_axes_as_their_points_do():
    rng = np.random.default_rng(4)
    places, masses = rng.standard_normal((7, 3)), rng.uniform(0.1, 1, 7)
    rotation, origin = Rotation.from_rotvec([0.3, -1.0, 0.5]).as_matrix(), np.array([0.2, 0.1, -0.4])
    whole = InertialParameters.of_points(places, masses)
    moved = InertialParameters.of_points((places - origin) @ rotation, masses)
    assert_allclose(whole.moved(rotation, origin).vector, moved.vector, atol=1e-12)
    assert_allclose(shift_map(origin) @ whole.vector, whole.moved(np.eye(3), origin).vector, atol=1e-12)
    squares = np.einsum("p,pi,pj->ij", masses, np.c_[places, np.ones(7)], np.c_[places, np.ones(7)])
    assert_allclose(pseudo_inertia(whole.vector), squares, atol=1e-12)


def test_without_noise_every_method_finds_the_truth():
    parts, masses, whole = body()
    equations = inertial_equations(motion(whole), IDEAL)
    assert equations.rank == 10 and equations.misfit < 1e-6
    found = least_squares_inertia(equations)
    assert_allclose(found.parameters.vector, whole.vector, atol=1e-9)
    assert found.parameters.consistent and not found.message
    assert_allclose(consistent_inertia(equations).parameters.vector, whole.vector, atol=1e-8)
    still = inertial_equations(motion(whole, still=True), IDEAL, still_only=True)
    by_parts = homogeneous_parts(still, parts)
    assert by_parts.part_mass is not None
    assert_allclose(by_parts.part_mass, masses, atol=1e-9)
    assert_allclose(by_parts.parameters.vector, whole.vector, atol=1e-9)


def test_still_poses_show_mass_and_center_alone_and_it_says_so():
    _, _, whole = body()
    found = least_squares_inertia(inertial_equations(motion(whole, still=True), FT300S))
    assert_allclose(found.parameters.mass, whole.mass, atol=0.02)
    assert_allclose(found.parameters.center_of_mass, whole.center_of_mass, atol=0.005)
    assert np.isnan(found.parameters.inertia).any() and "accelerate" in found.message


def test_motions_of_one_body_add_up():
    _, _, whole = body()
    one, other = motion(whole), motion(whole, still=True)
    both = joined([inertial_equations(each, FT300S) for each in (one, other)])
    alone = [e.rows.T @ e.rows for e in (inertial_equations(one, FT300S), inertial_equations(other, FT300S))]
    assert_allclose(both.rows.T @ both.rows, sum(alone), rtol=1e-8, atol=1e-6)
    assert_allclose(least_squares_inertia(both).parameters.vector, whole.vector, atol=1e-8)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ordinary", "semidefinite", "parts"])
def test_nine_in_ten_intervals_hold(method):
    parts, _, whole = body()
    exact, hold = motion(whole), []
    for seed in range(12 if method == "semidefinite" else 40):
        equations = inertial_equations(noisy(exact, seed), FT300S, still_only=method == "parts")
        if method == "ordinary":
            found = least_squares_inertia(equations)
        elif method == "semidefinite":
            found = consistent_inertia(equations)
        else:
            found = homogeneous_parts(equations, parts)
        truth = np.concatenate([[whole.mass], whole.center_of_mass, np.diag(whole.inertia)])
        low, high = found.interval(lambda p: np.concatenate([[p.mass], p.center_of_mass, np.diag(p.inertia)]))
        hold.append((low <= truth) & (truth <= high))
        assert found.misfit < (12 if method == "parts" else 1.5)  # that of the parts has one degree of freedom
    assert 0.82 < np.mean(hold) < 0.98


@pytest.mark.slow
def test_a_thin_body_in_noise_stays_physical():
    places = np.column_stack([np.linspace(0.0, 0.3, 30), np.zeros(30), np.zeros(30)])
    rod = InertialParameters.of_points(places, np.full(30, 0.01))
    within = Ellipsoid.around(np.array([0.0, -0.005, -0.005]), np.array([0.3, 0.005, 0.005]))
    off = {"least_squares": [], "consistent": []}
    for seed in range(3):
        equations = inertial_equations(noisy(motion(rod), seed), FT300S)
        plain, physical = least_squares_inertia(equations), consistent_inertia(equations, within)
        assert np.linalg.eigvalsh(pseudo_inertia(physical.parameters.vector))[0] > -1e-9
        off["least_squares"].append(np.abs(plain.parameters.vector - rod.vector)[4:].max())
        off["consistent"].append(np.abs(physical.parameters.vector - rod.vector)[4:].max())
        assert plain.parameters.consistent or "positive density" in plain.message
    assert np.mean(off["consistent"]) < np.mean(off["least_squares"])


def test_parts_that_still_poses_cannot_tell_apart_are_refused():
    parts, _, whole = body(count=3)
    still = inertial_equations(motion(whole, still=True), IDEAL)
    with pytest.raises(InvalidValueError, match="at most 4"):
        homogeneous_parts(still, [*parts, *body(seed=5)[0]])
    with pytest.raises(InvalidValueError, match="parts"):
        homogeneous_parts(still, [])
