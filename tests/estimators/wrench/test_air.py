"""An object in the air: forward model against Newton's law and true errors of a setup, and masses from lifts."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from estimators.identifiability.predicted import predicted_lift
from estimators.inertial.parts import column_parts
from estimators.particles.lifts import LiftErrors, lifts_among
from estimators.support_models.estimator import SupportAware
from estimators.testing.analytic_world import RATE, TOOL, drawn_object
from estimators.wrench.air import Air, Matter, columns, nominal
from estimators.wrench.setup import stated_sizes
from testbed import GRAVITY, InvalidValueError, Lift, Phase, Trajectory, load_object, preset
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix, rotation_z
from testbed.sensing.compensation import SIDEWAYS, compensate, tare_samples, tool_pulls, tool_wrench
from testbed.sensing.lift_windows import LiftWindow, lift_windows
from testbed.sensing.series import interpolated
from testbed.worlds.setup_errors import EXACT_SETUP, PARAMETERS, SetupErrors
from tests.fakes.lifted_world import lifted
from tests.helpers.answers import ask, claimed, holds, nad, shown_in_the_air, trials_of

OBJECT, ACTION = drawn_object(1), Lift(0, hold=1.4)
MASS = torch.tensor(OBJECT.truth.mass)


def raw(record: Trajectory) -> np.ndarray:
    """Wrench that a perfect sensor reads: of the tool, and after the tare of the object too."""
    axes = rotation_matrix(record.sensor_orientation)
    own = rotate_wrench(axes.transpose(0, 2, 1), record.wrench_on_object_world)
    assert record.tool is not None
    held = ~record.mask(Phase.TARE)[:, None]
    return held * move_wrench(own, -record.tool.tcp) + tool_wrench(record.tool, record, axes)


PLAIN = lifted(OBJECT, ACTION)
PLAIN = replace(PLAIN, sensor_wrench=raw(PLAIN))
WINDOWS = lift_windows(compensate(PLAIN))


def wrenches(windows: list[LiftWindow]) -> np.ndarray:
    return np.array([window.wrench for window in windows])


def missing(record: Trajectory) -> np.ndarray:
    """Measured wrenches less those that the masses take by the measured motion."""
    windows = lift_windows(record)
    return wrenches(windows) - Air.of_masses(OBJECT.shape, windows).wrenches({"mass": MASS}).numpy()


def changed(record: Trajectory, **changes: object) -> np.ndarray:
    """`missing` of a record with other values of some fields."""
    return missing(compensate(replace(record, **changes)))  # pyright: ignore[reportArgumentType]


def test_the_wrench_of_given_masses_obeys_newton_and_is_linear_in_them():
    air = Air.of_masses(OBJECT.shape, WINDOWS)
    rows = air.linearized({"mass": MASS})[1]["mass"].numpy()
    for found in (air.wrenches({"mass": MASS}), rows @ OBJECT.truth.mass):
        assert_allclose(found, wrenches(WINDOWS), rtol=0, atol=1e-8 * np.abs(wrenches(WINDOWS)).max())


def test_a_body_is_its_groups_together():
    vectors = [part.vector * size for part, size in zip(column_parts(OBJECT.shape), OBJECT.group_mass, strict=True)]
    body = Matter.of_vector(torch.tensor(np.sum(vectors, axis=0)))
    groups = Matter.of_groups(OBJECT.shape).times(MASS).combined()
    for name in ("mass", "first", "second"):
        assert_allclose(getattr(body, name), getattr(groups, name), atol=1e-12)


GAIN = np.array([0.01, -0.006, 0.004, 0.008, -0.01, 0.005])
CROSS = 1e-3 * np.random.default_rng(3).standard_normal((6, 6)) * (1 - np.eye(6))
ANGLE, COM, DELAY, HEAVIER = np.array([0.004, -0.003, 0.005]), np.array([1e-3, -5e-4, 8e-4]), 2 / RATE, 0.02
TURNED = Rotation.from_rotvec(ANGLE).as_matrix()[None]
LATE = np.maximum(np.arange(len(PLAIN.time_s)) - 2, 0)
POSES = "tcp_position", "tcp_velocity", "sensor_orientation", "object_pose", "object_velocity"
TILT, TILTED = 0.004, lifted(OBJECT, ACTION, tilt=0.004)
ON_TOOL = tool_pulls(TOOL, rotation_matrix(PLAIN.sensor_orientation), SIDEWAYS)[:, 0]
OF_TCP = np.array([4e-4, -3e-4])  # along the axes of the hand, whose z is down
IN_OBJECT_AXES = (*(rotation_z(0.7)[:2, :2] @ [OF_TCP[0], -OF_TCP[1]]).tolist(), 0.0)
FLAWS = {
    "gain": (GAIN, lambda: changed(PLAIN, sensor_wrench=PLAIN.sensor_wrench * (1 + GAIN))),
    "crosstalk": (CROSS.ravel(), lambda: changed(PLAIN, sensor_wrench=PLAIN.sensor_wrench @ (np.eye(6) + CROSS).T)),
    "mounting_angle": (ANGLE, lambda: changed(PLAIN, sensor_wrench=rotate_wrench(TURNED, PLAIN.sensor_wrench))),
    "tool_mass": ([HEAVIER], lambda: changed(PLAIN, tool=replace(TOOL, mass=TOOL.mass - HEAVIER))),
    "tool_com": (COM, lambda: changed(PLAIN, tool=replace(TOOL, com=TOOL.com - COM))),
    "delay": ([DELAY], lambda: changed(PLAIN, **{name: getattr(PLAIN, name)[LATE] for name in POSES})),
    "grasp_offset": ([4e-4, -3e-4], lambda: missing(lifted(OBJECT, ACTION, offset=(4e-4, -3e-4, 0.0)))),
    "tcp_offset": ([*OF_TCP, 0.0], lambda: missing(lifted(OBJECT, ACTION, offset=IN_OBJECT_AXES))),
    "table_tilt": ([TILT, 0.0], lambda: changed(TILTED, sensor_wrench=raw(TILTED) + TILT * ON_TOOL)),
}


@pytest.mark.parametrize("kind", FLAWS)
def test_derivatives_are_those_of_the_true_flaw(kind):
    size, flawed = FLAWS[kind]
    at = nominal({"mass": MASS}, {kind: torch.zeros(PARAMETERS[kind].sized(OBJECT.shape.n_m))})
    slopes = Air.of_masses(OBJECT.shape, WINDOWS).linearized(at)[1][kind].numpy()
    change, predicted = flawed(), slopes @ np.array(size)
    if kind == "tool_com":  # where the tool turns faster, its own inertia is 2 mN of it
        still = [not window.angular_acceleration.any() for window in WINDOWS]
        change, predicted = change[still], predicted[still]
    part = 0.15 if kind == "delay" else 0.03  # at the ends of a swing acceleration and spin come late too
    assert_allclose(predicted, change, atol=part * np.abs(change).max())


def test_errors_that_lifts_share_count_in_each_by_the_root_of_their_number():
    setup = SetupErrors(gain=0.01, grasp_offset=0.001, crosstalk=0.01)
    one, four = stated_sizes(setup, ("air", "reading"), trials=1), stated_sizes(setup, ("air", "reading"), trials=4)
    assert set(one) == {"gain", "grasp_offset", "crosstalk"}
    assert_allclose(four["gain"], 2 * one["gain"])
    assert_allclose(four["grasp_offset"], one["grasp_offset"])
    assert one["crosstalk"][0, 3] == pytest.approx(0.1) and one["crosstalk"][2, 2] == 0
    slopes = Air.of_masses(OBJECT.shape, WINDOWS).linearized(nominal({"mass": MASS}, one))[1]
    assert columns(slopes, one).shape == (6 * len(WINDOWS), 6 + 2 + 36)


def quadratics(shape) -> np.ndarray:
    """1, x, y, x^2, y^2 and x y of every particle, summed over its group, (6, n_m)."""
    x, y = shape.particles.T
    return np.array([np.bincount(shape.mass_group, v, shape.n_m) for v in (x * 0 + 1, x, y, x * x, y * y, x * y)])


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (2, 3))])
def test_lifts_show_six_numbers_and_all_six_are_right(seed):
    obj = drawn_object(seed)
    rows, values = shown_in_the_air(obj.shape, obj.total_mass, [lifted(obj, ACTION)])
    numbers = quadratics(obj.shape)
    assert len(rows) == np.linalg.matrix_rank(numbers, tol=1e-9)
    shown = np.linalg.lstsq(numbers.T, rows.T, rcond=None)[0].T @ numbers
    assert_allclose(shown, rows, atol=1e-4 * np.abs(rows).max())
    assert_allclose(rows @ obj.truth.mass, values, atol=0.05)


@pytest.mark.parametrize(
    ("action", "rank"),
    [(Lift(0, tilt=0.0), 3), (Lift(0, swings=0), 3), pytest.param(Lift(0), 5, marks=pytest.mark.slow)],
)
def test_an_object_held_still_shows_m_and_c_alone(action, rank):
    obj = load_object("L2")
    rows, _ = shown_in_the_air(obj.shape, obj.total_mass, [lifted(obj, action, errors=1.0)])
    strength = np.linalg.norm(rows / obj.shape.particles_per_group, axis=1) * obj.total_mass
    assert (strength > 5).sum() == rank


def test_predicted_windows_are_those_recorded():
    planned = predicted_lift(ACTION, preset("ft300s"))
    found = lift_windows(lifted(load_object("L2"), ACTION))
    assert len(planned) == len(found)
    for a, b in zip(planned, found, strict=True):  # a window may begin a sample earlier or later
        assert_allclose(a.pull, b.pull, atol=5e-3)
        assert_allclose(a.pull_tilt.T @ a.pull_tilt, b.pull_tilt.T @ b.pull_tilt, atol=0.2)  # whichever way it lies
        assert_allclose(a.angular_acceleration, b.angular_acceleration, atol=1e-3)
        assert_allclose(a.spin_products, b.spin_products, atol=0.015)
        assert_allclose(np.diff(a.since_tare), np.diff(b.since_tare), atol=0.015)


@pytest.mark.slow
def test_errors_of_lifts_are_as_large_as_stated():
    """Bias, noise, and offset in the grip by the stated errors: squared residuals of the truth follow chi-squared."""
    obj, rng, misses, stated = OBJECT, np.random.default_rng(0), [], LiftErrors()
    for seed in range(24):
        x, y, z = rng.standard_normal(3) * [stated.grip, stated.grip, stated.height * obj.shape.height]
        lift = lifted(obj, ACTION, offset=(x, y, z), errors=1.0, seed=seed)
        rows, values = shown_in_the_air(obj.shape, obj.total_mass, [lift])
        misses.append(np.sum((values - rows @ obj.truth.mass) ** 2))
    count = len(misses) * 6
    assert chi2.cdf(np.sum(misses), count) < 0.995
    assert np.sum(misses) > 0.3 * count


SIZES = {"gain": 0.02, "mounting_angle": 0.02, "grasp_offset": 2e-3, "tool_mass": 0.03, "tool_com": 5e-3, "delay": 0.05,
         "table_tilt": 0.02, "particle_offset": 4e-3}  # fmt: skip


@pytest.mark.parametrize("kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind != "gain")) for kind in SIZES])
def test_errors_of_the_setup_count_as_stated(kind):
    setup = SetupErrors(**{kind: SIZES[kind]})
    away = setup.particle_offset * np.random.default_rng(0).standard_normal((OBJECT.shape.n_m, 2))
    places = OBJECT.shape.particles + away[OBJECT.shape.mass_group]
    true, offset = replace(OBJECT, shape=replace(OBJECT.shape, particles=places)), setup.grasp_offset
    lift = lifted(true, ACTION, offset=(offset, -offset, 0.0), tilt=setup.table_tilt, errors=1.0, seed=2)
    axes = rotation_matrix(lift.sensor_orientation)
    sensed = move_wrench(rotate_wrench(axes.transpose(0, 2, 1), lift.wrench_on_object_world), -TOOL.tcp)
    turned = Rotation.from_rotvec([setup.mounting_angle, 0, 0]).as_matrix()
    sensed = (1 + setup.gain) * rotate_wrench(turned, sensed)
    wrong = replace(TOOL, mass=TOOL.mass + setup.tool_mass, com=TOOL.com + np.array([setup.tool_com, 0, 0]))
    on_tool = tool_wrench(wrong, lift, axes) - tool_wrench(TOOL, lift, axes)
    up = Rotation.from_rotvec([setup.table_tilt, 0, 0]).apply([0, 0, GRAVITY]) - [0, 0, GRAVITY]
    tool_pull = TOOL.mass * np.einsum("nji,j->ni", axes, up)
    on_tool += np.hstack([tool_pull, np.cross(TOOL.com, tool_pull)])
    if setup.delay:  # the sensor is ahead of the poses
        both = sensed + tool_wrench(TOOL, lift, axes)
        on_tool += interpolated(lift.time_s + setup.delay, lift.time_s, both) - both
    sensed += on_tool - on_tool[tare_samples(lift)].mean(axis=0)
    lift = replace(lift, wrench_on_object_world=rotate_wrench(axes, move_wrench(sensed, TOOL.tcp)))
    stated, left_out = (
        shown_in_the_air(OBJECT.shape, OBJECT.total_mass, [replace(lift, setup=each)]) for each in (setup, EXACT_SETUP)
    )
    misses = [np.mean((values - rows @ OBJECT.truth.mass) ** 2) for rows, values in (stated, left_out)]
    assert misses[0] < 2.5 and misses[1] > 2 * misses[0]


@pytest.mark.slow
def test_only_lifts_are_read_as_lifts_and_algorithm_1_ignores_them():
    obj = load_object("L2")
    table = trials_of(obj, rigid=True)
    assert not lifts_among(obj.shape, table)
    with_lift = [lifted(obj, ACTION), *table]
    assert nad(obj, ask(obj, with_lift)) == pytest.approx(nad(obj, ask(obj, table)))
    with pytest.raises(InvalidValueError, match="grasp"):
        lifts_among(obj.shape, [lifted(load_object("I2"), Lift(5))])


@pytest.mark.slow
def test_a_lift_narrows_what_one_rigid_body_leaves_open():
    obj = load_object("F2")
    table = trials_of(obj, rigid=True, noise=0.05)
    lift = lifted(obj, ACTION, errors=1.0, seed=3)
    error = []
    for trials in (table, [*table, lift]):
        answer = ask(obj, trials, SupportAware())
        assert answer.status == "assumption_violated" and holds(answer, obj.group_mass)
        error.append(claimed(answer).mean())
    assert error[1] < 0.75 * error[0]
