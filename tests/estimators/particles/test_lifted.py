"""Masses from lifts, against a world of Newton's law alone."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from estimators.identifiability.predicted import predicted_lift
from estimators.particles.lifts import LiftErrors, lifts_among
from estimators.support_models.estimator import SupportAware
from estimators.testing.analytic_world import TOOL, drawn_object
from testbed.actions.lift import Lift
from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY
from testbed.sensing.compensation import tare_samples, tool_wrench
from testbed.sensing.lift_windows import lift_windows
from testbed.sensing.presets import preset
from testbed.sensing.series import interpolated
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors
from tests.fakes.lifted_world import lifted
from tests.helpers.answers import ask, claimed, holds, nad, shown_in_the_air, trials_of

SHORT = Lift(0, hold=1.4)


def quadratics(shape) -> np.ndarray:
    """1, x, y, x^2, y^2 and x y of every particle, summed over its group, (6, n_m)."""
    x, y = shape.particles.T
    return np.array([np.bincount(shape.mass_group, v, shape.n_m) for v in (x * 0 + 1, x, y, x * x, y * y, x * y)])


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_lifts_show_six_numbers_and_all_six_are_right(seed):
    obj = drawn_object(seed)
    rows, values = shown_in_the_air(obj.shape, obj.total_mass, [lifted(obj, SHORT)])
    numbers = quadratics(obj.shape)
    assert len(rows) == np.linalg.matrix_rank(numbers, tol=1e-9)
    shown = np.linalg.lstsq(numbers.T, rows.T, rcond=None)[0].T @ numbers
    assert_allclose(shown, rows, atol=1e-4 * np.abs(rows).max())
    assert_allclose(rows @ obj.truth.mass, values, atol=0.05)


@pytest.mark.parametrize(
    ("action", "rank"),
    [(Lift(0, tilt=0.0), 3), (Lift(0, swings=0), 3), pytest.param(Lift(0), 5, marks=pytest.mark.slow)],
)
def test_held_still_it_shows_m_and_c_alone(action, rank):
    obj = load_object("L2")
    rows, _ = shown_in_the_air(obj.shape, obj.total_mass, [lifted(obj, action, errors=1.0)])
    strength = np.linalg.norm(rows / obj.shape.particles_per_group, axis=1) * obj.total_mass
    assert (strength > 5).sum() == rank


def test_what_is_planned_is_what_is_recorded():
    planned = predicted_lift(SHORT, preset("ft300s"))
    found = lift_windows(lifted(load_object("L2"), SHORT))
    assert len(planned) == len(found)
    for a, b in zip(planned, found, strict=True):  # a window may begin a sample earlier or later
        assert_allclose(a.pull, b.pull, atol=5e-3)
        assert_allclose(a.pull_tilt.T @ a.pull_tilt, b.pull_tilt.T @ b.pull_tilt, atol=0.2)  # whichever way it lies
        assert_allclose(a.angular_acceleration, b.angular_acceleration, atol=1e-3)
        assert_allclose(a.spin_products, b.spin_products, atol=0.015)
        assert_allclose(np.diff(a.since_tare), np.diff(b.since_tare), atol=0.015)


@pytest.mark.slow
def test_its_errors_are_as_large_as_they_are_said_to_be():
    """Bias, noise, and an offset in the grip, drawn as told: squared misses of the truth follow chi squared."""
    obj, rng, misses = drawn_object(1), np.random.default_rng(0), []
    said = LiftErrors()
    for seed in range(24):
        x, y, z = rng.standard_normal(3) * [said.grip, said.grip, said.height * obj.shape.height]
        felt = lifted(obj, SHORT, offset=(x, y, z), errors=1.0, seed=seed)
        rows, values = shown_in_the_air(obj.shape, obj.total_mass, [felt])
        misses.append(np.sum((values - rows @ obj.truth.mass) ** 2))
    count = len(misses) * 6
    assert chi2.cdf(np.sum(misses), count) < 0.995
    assert np.sum(misses) > 0.3 * count


@pytest.mark.parametrize(
    ("setup", "worth"),
    [
        (SetupErrors(gain=0.02), 1.02),
        *(
            pytest.param(setup, 1.0, marks=pytest.mark.slow)
            for setup in (
                SetupErrors(mounting_angle=0.02),
                SetupErrors(grasp_offset=2e-3),
                SetupErrors(tool_mass=0.03),
                SetupErrors(tool_com=5e-3),
                SetupErrors(delay=0.05),
                SetupErrors(table_tilt=0.02),
                SetupErrors(particle_offset=4e-3),
            )
        ),
    ],
)
def test_errors_of_the_setup_count_as_stated(setup, worth):
    obj = drawn_object(1)
    offset = (setup.grasp_offset, -setup.grasp_offset, 0.0)
    away = setup.particle_offset * np.random.default_rng(0).standard_normal((obj.shape.n_m, 2))
    shape = replace(obj.shape, particles=obj.shape.particles + away[obj.shape.mass_group])
    true = replace(obj, shape=shape)
    felt = lifted(true, SHORT, offset=offset, tilt=setup.table_tilt, errors=1.0, seed=2)
    axes = rotation_matrix(felt.sensor_orientation)
    sensed = move_wrench(rotate_wrench(axes.transpose(0, 2, 1), felt.wrench_on_object_world), -TOOL.tcp)
    sensed = worth * rotate_wrench(Rotation.from_rotvec([setup.mounting_angle, 0, 0]).as_matrix(), sensed)
    wrong = replace(TOOL, mass=TOOL.mass + setup.tool_mass, com=TOOL.com + np.array([setup.tool_com, 0, 0]))
    on_tool = tool_wrench(wrong, felt, axes) - tool_wrench(TOOL, felt, axes)
    up = Rotation.from_rotvec([setup.table_tilt, 0, 0]).apply([0, 0, GRAVITY]) - [0, 0, GRAVITY]
    aside = TOOL.mass * np.einsum("nji,j->ni", axes, up)
    on_tool += np.hstack([aside, np.cross(TOOL.com, aside)])
    if setup.delay:  # the sensor is ahead of the poses
        ahead = felt.time_s + setup.delay
        both = sensed + tool_wrench(TOOL, felt, axes)
        on_tool += interpolated(ahead, felt.time_s, both) - both
    sensed += on_tool - on_tool[tare_samples(felt)].mean(axis=0)
    felt = replace(felt, wrench_on_object_world=rotate_wrench(axes, move_wrench(sensed, TOOL.tcp)))
    misses = [
        np.mean((values - rows @ obj.truth.mass) ** 2)
        for rows, values in (
            shown_in_the_air(obj.shape, obj.total_mass, [replace(felt, setup=each)]) for each in (setup, EXACT_SETUP)
        )
    ]
    assert misses[0] < 2.5 and misses[1] > 2 * misses[0]


@pytest.mark.slow
def test_what_is_no_lift_says_nothing_and_a_lift_is_nothing_to_others():
    obj = load_object("L2")
    table = trials_of(obj, rigid=True)
    assert not lifts_among(obj.shape, table)
    with_lift = [lifted(obj, SHORT), *table]
    assert nad(obj, ask(obj, with_lift)) == pytest.approx(nad(obj, ask(obj, table)))
    with pytest.raises(InvalidValueError, match="grasp"):
        lifts_among(obj.shape, [lifted(load_object("I2"), Lift(5))])


@pytest.mark.slow
def test_a_lift_narrows_what_one_rigid_body_leaves_open():
    obj = load_object("F2")
    table = trials_of(obj, rigid=True, noise=0.05)
    lift = lifted(obj, SHORT, errors=1.0, seed=3)
    error = []
    for trials in (table, [*table, lift]):
        answer = ask(obj, trials, SupportAware())
        assert answer.status == "assumption_violated" and holds(answer, obj.group_mass)
        error.append(claimed(answer).mean())
    assert error[1] < 0.75 * error[0]
