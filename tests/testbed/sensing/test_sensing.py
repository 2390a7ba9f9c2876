"""Sensor errors, compensation of the tool, windows of a record, and values that sensing refuses."""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import record as world_record
from testbed import GRAVITY, Accelerate, InvalidValueError, Lift, Slide, Trajectory, Weigh, draw_sensing
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.sensing.camera import Camera, PoseStream
from testbed.sensing.compensation import compensate, twist_rates
from testbed.sensing.drift import DriftLimit
from testbed.sensing.link_windows import link_windows
from testbed.sensing.presets import PRESETS, Sensing, preset
from testbed.sensing.series import interpolated
from testbed.sensing.windows import (
    PARTS,
    effective_samples,
    mean_covariance,
    noise_of_mean,
    part_means,
    sensor_map,
    steady_samples,
    steady_windows,
    weight_of,
)
from testbed.trajectory import SERIES, Phase
from tests.helpers.records import DOWN, NOISY, RATE, TOOL, coloured_noise, moving_hand, record, turn_record

BIAS = np.array([3.0, -2.0, 5.0, 0.3, -0.2, 0.1])
WRENCH = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
ORIENTATIONS = [DOWN, *Rotation.from_quat(np.random.default_rng(5).normal(size=(3, 4)))]
AFTER = slice(100, None)
"""Samples after the tare."""


@pytest.fixture(scope="module")
def long_record() -> Trajectory:
    return record(20000, tare=5000)


def lag1(samples: np.ndarray) -> np.ndarray:
    centered = samples - samples.mean(axis=0)
    return (centered[1:] * centered[:-1]).sum(axis=0) / (centered**2).sum(axis=0)


@pytest.mark.parametrize("start", ORIENTATIONS)
def test_compensation_leaves_the_wrench_on_the_object_about_the_tcp_in_world_axes(start: Rotation):
    for axis in ((0, 0, 1), (1, -2, 0.5)):
        assert_allclose(compensate(moving_hand(start, axis)).wrench_on_object_world, 0, atol=1e-9)
    held = compensate(moving_hand(start, (1, 1, 3), WRENCH))
    assert_allclose(held.wrench_on_object_world[AFTER], np.tile(WRENCH, (100, 1)), atol=1e-9)
    hand = moving_hand(start, (1, 1, 3), np.arange(6.0))
    biased = replace(hand, sensor_wrench=hand.sensor_wrench + BIAS)
    assert_allclose(compensate(biased).wrench_on_object_world, compensate(hand).wrench_on_object_world, atol=1e-9)


def test_the_weight_of_a_held_object_has_the_agreed_sign():
    weight = np.where(np.arange(400)[:, None] < 100, 0.0, [0, 0, -2.0 * GRAVITY, 0, 0, 0])  # sensor z is down
    lever = np.cross(TOOL.tcp, weight[:, :3])
    loaded = record(sensor_wrench=np.hstack([weight[:, :3], lever]))
    assert_allclose(compensate(loaded).wrench_on_object_world[-1], [0, 0, 19.62, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize("name", PRESETS)
def test_a_draw_is_its_seeds_and_an_ideal_one_changes_nothing(name: str):
    clean = moving_hand(wrench_world=np.arange(6.0))
    first, again, other = (draw_sensing(clean, preset(name), seed) for seed in (3, 3, 4))
    assert np.array_equal(first.wrench_on_object_world, again.wrench_on_object_world)
    if name == "ideal":
        assert np.array_equal(first.sensor_wrench, clean.sensor_wrench)
        assert np.array_equal(first.tcp_velocity, clean.tcp_velocity)
        assert np.array_equal(first.wrench_on_object_world, compensate(clean).wrench_on_object_world)
    else:
        assert not np.isclose(first.wrench_on_object_world, other.wrench_on_object_world).any(axis=1).all()


@pytest.mark.parametrize("count", [1, 400])
def test_a_draw_states_that_it_was_drawn_and_not_which(count: int):
    clean = record(count, tare=min(count, 100), provenance={"runner": "simulation", "support": "rigid", "mujoco": "3"})
    drawn = draw_sensing(clean, preset("ft300s"), seed=3)
    assert len(drawn.time_s) == count and np.isfinite(drawn.sensor_wrench).all()
    assert drawn.provenance == {"runner": "simulation", "sensing": "drawn"}
    assert drawn.simulated and not drawn.is_clean
    assert drawn.sensor_bias_std.tolist() == [0.05] * 3 + [0.003] * 3


def test_a_sensor_may_be_worse_than_its_data_sheet_states():
    quiet = {"force_noise": (0.0, 0.0, 0.0), "torque_noise": (0.0, 0.0, 0.0)}
    stated, worse = preset("ft300s"), preset("ft300s:bias=2:drift=0.5")
    one, other = (draw_sensing(record(), replace(sensor, **quiet), 1) for sensor in (stated, worse))
    assert_allclose(other.sensor_wrench[:100], 0.5 * one.sensor_wrench[:100])  # the walk alone, before the bias
    step = 99, 100
    biases = [np.diff(drawn.sensor_wrench[step, :], axis=0) for drawn in (one, other)]
    assert_allclose(biases[1], 2 * biases[0], atol=6 * np.abs(stated.drift_std).max() / np.sqrt(RATE))
    for name in ("sensor_bias_std", "sensor_drift_std"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert worse.stated == stated != worse


def test_noise_has_the_spread_and_colour_asked_for(long_record: Trajectory):
    noise = draw_sensing(long_record, NOISY, seed=1).sensor_wrench
    assert_allclose(noise.std(axis=0), [*NOISY.force_noise, *NOISY.torque_noise], rtol=0.04)
    assert_allclose(lag1(noise), NOISY.lag1, atol=0.03)
    assert_allclose(np.corrcoef(noise, rowvar=False), np.eye(6), atol=0.04)


BIASED = Sensing("biased", force_bias=1.0, torque_bias=0.1)
SHAKY = Sensing("shaky", linear_acceleration_noise=0.05, angular_acceleration_noise=0.5)


@pytest.mark.slow
def test_a_bias_and_the_first_noise_have_the_spread_asked_for():
    short = record(12, tare=6)
    first = np.array([draw_sensing(short, NOISY, seed).sensor_wrench[0] for seed in range(400)])
    assert_allclose(first.std(axis=0), [*NOISY.force_noise, *NOISY.torque_noise], rtol=0.15)
    bias = np.array([draw_sensing(short, BIASED, seed).sensor_wrench[-1] for seed in range(400)])
    assert_allclose(bias.std(axis=0), BIASED.bias_std, rtol=0.15)
    assert (np.abs(bias.mean(axis=0)) < 4 * BIASED.bias_std / np.sqrt(400)).all()


def test_a_drift_is_a_random_walk(long_record: Trajectory):
    sensing = Sensing("drifting", force_drift=0.5, torque_drift=0.02)
    steps = np.diff(draw_sensing(long_record, sensing, seed=1).sensor_wrench, axis=0)
    assert_allclose(steps.std(axis=0), np.repeat([0.5, 0.02], 3) / np.sqrt(RATE), rtol=0.04)
    assert_allclose(lag1(steps), 0, atol=0.04)


def test_motion_noise_is_that_of_the_acceleration_between_samples(long_record: Trajectory):
    acceleration = np.diff(draw_sensing(long_record, SHAKY, seed=1).tcp_velocity, axis=0) * RATE
    assert_allclose(acceleration.std(axis=0), [0.05] * 3 + [0.5] * 3, rtol=0.04)


def test_motion_noise_is_one_rigid_motion():
    origin, hand = np.array([0.4, 0.1]), np.array([0.52, 0.03])
    pose, tcp = np.tile([*origin, 0.7], (300, 1)), np.tile([*hand, 0.02], (300, 1))
    drawn = draw_sensing(record(300, object_pose=pose, tcp_position=tcp), SHAKY, seed=1)
    rate = drawn.tcp_velocity[:, 5]
    apart = drawn.object_velocity[:, :2] - drawn.tcp_velocity[:, :2]
    assert rate.std() > 1e-4
    assert_allclose(drawn.object_velocity[:, 2], rate, atol=1e-15)
    assert_allclose(apart, rate[:, None] * perpendicular(origin - hand), atol=1e-15)
    assert_allclose(apart @ (origin - hand), 0, atol=1e-15)
    assert_allclose(cross_2d(origin - hand, apart), rate * np.sum((origin - hand) ** 2), atol=1e-15)


def weighing(count: int = 5, **changes: Any) -> Trajectory:
    """Readings of a scale with 1.8 kg on it."""
    reading = np.tile([0, 0, 1.8 * GRAVITY, 0, 0, 0], (count, 1))
    return record(count, tare=0, action=Weigh(), tool=None, wrench_on_object_world=reading, **changes)


@pytest.mark.parametrize("count", [1, 5])
def test_a_scale_errs_by_its_own_spread(count: int):
    clean, sensing = weighing(count), Sensing("scale", scale=0.002)
    read = [weight_of(draw_sensing(clean, sensing, seed)) for seed in range(400)]
    assert weight_of(draw_sensing(clean, preset("ideal"), 0)) == pytest.approx(1.8, abs=1e-12)
    assert np.mean(read) == pytest.approx(1.8, abs=4 * 0.002 / np.sqrt(400))
    assert np.std(read) == pytest.approx(0.002, rel=0.15)


GRASP, PIVOT = np.array([0.05, -0.02]), np.array([-0.03, 0.08])


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(6)


@pytest.mark.parametrize("speed", [0.5, -0.5])
@pytest.mark.parametrize("pivot", [PIVOT, GRASP])
def test_a_turn_gives_its_constant_wrench_and_its_motion_across_and_inwards(speed: float, pivot: np.ndarray):
    x, y = GRASP - pivot
    (window,) = steady_windows(turn_record(WRENCH, grasp=GRASP, pivot=pivot, speed=speed))
    assert_allclose(window.wrench, WRENCH, atol=1e-12)
    assert_allclose(window.covariance, 0, atol=1e-20)
    assert_allclose(window.twist, [-speed * y, speed * x, speed], atol=1e-12)
    assert_allclose(window.acceleration, [-(speed**2) * x, -(speed**2) * y, 0], atol=1e-12)
    assert window.tcp_height == pytest.approx(0.015)


def test_each_stretch_of_constant_acceleration_is_its_own_window():
    segment = np.repeat([0, -1, 1, -1], 100)
    turn = turn_record(WRENCH, grasp=GRASP, pivot=GRASP, acceleration=0.7, segment=segment, action=Accelerate(3))
    windows = steady_windows(turn)
    assert [window.grasp for window in windows] == [3, 3]
    assert_allclose([window.acceleration for window in windows], np.tile([0, 0, 0.7], (2, 1)), atol=1e-10)
    assert windows[1].twist[2] - windows[0].twist[2] == pytest.approx(0.7 * 2.0)


BIAS_STD = np.array([0.1, 0.2, 0.3, 0.01, 0.02, 0.03])


def hovering(yaw: float, *, tilt: float = 0.0) -> Trajectory:
    """A hand at rest, its sensor down and turned with an object at another yaw."""
    turned = Rotation.from_euler("zx", [yaw + 0.4, tilt]) * DOWN
    return record(orientation=turned, object_pose=np.tile([0.3, 0.2, yaw], (400, 1)), sensor_bias_std=BIAS_STD)


@pytest.mark.parametrize("yaw", [0.0, 0.9, -2.3])
@pytest.mark.parametrize("tilt", [0.0, 0.2])
def test_the_bias_covariance_is_made_of_the_responses_to_unit_biases(yaw: float, tilt: float):
    hand = hovering(yaw, tilt=tilt)
    resting = compensate(hand).wrench_on_object_world[-1]
    after = np.arange(400)[:, None] >= 100
    expected = np.zeros((6, 6))
    for unit, std in zip(np.eye(6), hand.sensor_bias_std, strict=True):
        biased = replace(hand, sensor_wrench=hand.sensor_wrench + after * unit)
        response = compensate(biased).wrench_on_object_world[-1] - resting
        for part in (slice(0, 2), slice(3, 5)):
            response[part] = rotation_2d(-yaw) @ response[part]
        expected += std**2 * np.outer(response, response)
    move = sensor_map(hand)
    assert_allclose(move @ np.diag(hand.sensor_bias_std**2) @ move.T, expected, atol=1e-12)
    (window,) = steady_windows(hand)
    assert_allclose(window.bias_covariance, expected, atol=1e-12)
    assert hand.tool is not None
    at_sensor = replace(hand.tool, tcp=np.zeros(3))
    assert_allclose(sensor_map(replace(hand, tool=None)), sensor_map(replace(hand, tool=at_sensor)), atol=1e-15)


def test_a_slide_has_the_twist_of_its_direction_in_the_object():
    heading, yaw = 0.4, 1.1
    velocity = np.array([np.cos(heading + yaw), np.sin(heading + yaw)]) * 0.05
    pose, twist = np.tile([0, 0, yaw], (400, 1)), np.tile([*velocity, 0, 0, 0, 0], (400, 1))
    (window,) = steady_windows(record(action=Slide(0, direction=heading), object_pose=pose, tcp_velocity=twist))
    assert_allclose(window.twist, [0.05 * np.cos(heading), 0.05 * np.sin(heading), 0], atol=1e-12)
    assert_allclose(window.acceleration, 0, atol=1e-12)


def test_start_and_end_of_a_stretch_are_left_out():
    wrench = np.tile(WRENCH, (400, 1))
    wrench[:99] += 100.0
    wrench[-5:] -= 100.0
    (window,) = steady_windows(turn_record(wrench, grasp=GRASP, pivot=PIVOT))
    assert_allclose(window.wrench, WRENCH, atol=1e-12)


def test_effective_samples_of_autoregressive_noise(rng: np.random.Generator):
    for lag1 in (0.0, 0.3, 0.8):
        size = effective_samples(coloured_noise(4000, 100, lag1, rng))
        assert size.mean() == pytest.approx(4000 * (1 - lag1) / (1 + lag1), rel=0.1), lag1


def test_effective_samples_stay_between_one_and_all(rng: np.random.Generator):
    index = np.arange(200)
    columns = [np.full(200, 0.25), index, np.where(index % 2, 1.0, -1.0), rng.normal(size=200)]
    size = effective_samples(np.column_stack(columns))
    assert size[0] == size[2] == 200  # a constant has no scatter to share out
    assert size[1] < 5
    assert (size >= 1).all() and (size <= 200).all()


@pytest.mark.parametrize("lag1", [0.0, 0.5])
def test_the_covariance_of_a_mean_is_what_repetition_shows(lag1: float, rng: np.random.Generator):
    repeats, count = 400, 800
    mixing = np.array([[1.0, 0.0], [0.6, 0.8]])
    noise = coloured_noise(count, 2 * repeats, lag1, rng).reshape(count, repeats, 2) @ mixing.T
    claimed = np.mean([mean_covariance(noise[:, i]) for i in range(repeats)], axis=0)
    seen = np.cov(noise.mean(axis=0), rowvar=False)
    assert_allclose(claimed, seen, rtol=0.2)


@pytest.mark.parametrize("seconds", [1.6, 2.4, 3.0, 5.0, 8.0, 20.0])
def test_the_inverse_covariance_of_the_mean_of_noise_is_unbiased(seconds: float, rng: np.random.Generator):
    count, repeats = round(seconds * RATE), 300
    noise = rng.normal(size=(repeats, count, 6))
    slow = 40.0 * np.linspace(-1, 1, count)[:, None] ** np.arange(1, 3).repeat(3)
    squares = [
        mean @ np.linalg.solve(noise_of_mean(each + slow, round(0.2 * RATE)), mean)
        for each, mean in zip(noise, noise.mean(axis=1), strict=True)
    ]
    assert np.mean(squares) / 6 == pytest.approx(1.0, abs=0.15)


def test_standardised_window_means_have_unit_spread(rng: np.random.Generator):
    scores = []
    for _ in range(60):
        noisy = WRENCH + coloured_noise(1900, 6, 0.5, rng)
        (window,) = steady_windows(turn_record(noisy, grasp=GRASP, pivot=PIVOT, count=1900))
        scores.append((window.wrench - WRENCH) / np.sqrt(np.diag(window.covariance)))
    assert np.std(scores) == pytest.approx(1.0, rel=0.15)


FAILED: list[dict[str, Any]] = [{"status": status, "reason": "because"} for status in ("slipped", "limit", "fault")]
GAP = turn_record(WRENCH, grasp=GRASP, pivot=PIVOT, segment=np.repeat([0, 2], 200))
SHORT = turn_record(WRENCH, grasp=GRASP, pivot=PIVOT, count=110)
OUT_OF_RANGE = {
    "lag1": [1.0, -0.1, np.nan],
    "force_noise": [(0.1, 0.1, -0.1), (0.1, 0.1)],
    "torque_noise": [0.1, (0.1, 0.1, np.nan)],
    "force_bias": [-1.0],
    "torque_bias": [np.inf],
    "force_drift": [np.nan],
    "torque_drift": ["0.1"],
    "linear_acceleration_noise": [-0.1],
    "angular_acceleration_noise": [None],
    "scale": [-0.001],
}
WRONG_NAMES = ("ft300s:bias=", "ft300s:bias=1.2.3", "ft300s:noise=2", ":bias=2")
FRAMES, THREE = np.zeros((3, 1, 3)), np.arange(3.0)
HALF_FRAME = np.where(np.arange(9).reshape(3, 1, 3) == 3, np.nan, 0.0)
REFUSED = [
    *((partial(Sensing, "odd", **{n: v}), f"Sensing.{n}", "got") for n, values in OUT_OF_RANGE.items() for v in values),
    *((partial(preset, name, field="guess.sensing"), "guess.sensing", f"got '{name}'") for name in WRONG_NAMES),
    (partial(preset, "perfect"), "sensing", "got 'perfect'; allowed: one of ideal, ft300s, low"),
    (partial(preset, "ft300s:camera=eye"), "sensing", "a camera of exact, 30hz"),
    (partial(Camera, "blind", dropout=1.0), "Camera.dropout", "a share below 1"),
    (partial(Camera, "early", delay=(0.05, 0.01)), "Camera.delay", "the least first"),
    (partial(PoseStream, np.array([0.0, 0.0, 1.0]), FRAMES), "PoseStream.time_s", "strictly increasing"),
    (partial(PoseStream, THREE, HALF_FRAME), "PoseStream.poses", "whole poses"),
    (partial(PoseStream, THREE, FRAMES, position_std=-1), "PoseStream.position_std", ">= 0"),
    (partial(PoseStream(THREE, FRAMES).motion, np.zeros(1), part=1), "part", "<= 0"),
    *((partial(DriftLimit, **{name: 0.0}), f"DriftLimit.{name}", "> 0") for name in ("force", "torque")),
    (partial(compensate, record(tare=0)), "Trajectory", "no samples in phase TARE"),
    (partial(compensate, record(tool=None)), "Trajectory", "no tool"),
    (partial(steady_windows, GAP), "Trajectory.segment", "'no sample of stretch 1'; allowed: .*numbered from 0"),
    (partial(steady_windows, SHORT), "trajectory", "at least 10 after"),
    (partial(steady_windows, record(tare=400)), "trajectory", "STEADY"),
    (partial(steady_windows, weighing()), "trajectory.action", "weight_of"),
    *((partial(steady_windows, record(**failed)), "trajectory.status", "because") for failed in FAILED),
    (partial(weight_of, record()), "trajectory", "Weigh"),
    *((partial(weight_of, weighing(**failed)), "trajectory", "Weigh with status ok") for failed in FAILED),
]


@pytest.mark.parametrize(("call", "field", "message"), REFUSED)
def test_a_value_or_record_out_of_range_is_refused(call, field: str, message: str):
    with pytest.raises(InvalidValueError, match=message) as refused:
        call()
    assert refused.value.field == field


def test_a_load_that_wanders_is_no_noise(rng: np.random.Generator):
    wander = np.outer(np.sin(np.linspace(0, 2, 1900)), np.ones(6))
    noise = 0.1 * coloured_noise(1900, 6, 0.3, rng)
    (still,) = steady_windows(turn_record(WRENCH + noise, grasp=GRASP, pivot=PIVOT, count=1900))
    (moved,) = steady_windows(turn_record(WRENCH + noise + wander, grasp=GRASP, pivot=PIVOT, count=1900))
    assert_allclose(moved.covariance, still.covariance, rtol=0.05, atol=0.05 * still.covariance[0, 0])


def test_the_tare_adds_its_own_error_and_the_walk_counts_from_it():
    noisy = np.zeros((400, 6))
    noisy[:100, 0] = np.tile([0.1, -0.1], 50)
    steps = np.array([0.2, 0, 0, 0, 0, 0])
    held = {"sensor_wrench": noisy, "sensor_bias_std": np.zeros(6), "sensor_drift_std": steps}
    (window,) = steady_windows(record(**held))
    kept = np.flatnonzero(np.arange(400) >= 200)[:-5]
    tared = np.arange(33, 100).mean() / RATE
    assert_allclose(window.since_tare, kept[[0, -1]] / RATE - tared)
    assert window.bias_covariance[0, 0] == pytest.approx(0.01 / 67, rel=0.1)
    assert_allclose(np.trace(window.drift_covariance[:3, :3]), 0.04)


@pytest.mark.parametrize("count", [10, 34, 35, 47, 495])
def test_parts_of_a_window_are_as_long_as_each_other(count):
    ramp = np.column_stack([np.arange(count) + 0.5, np.ones(count)])
    parts = part_means(ramp)
    assert_allclose(parts.mean(axis=0), ramp.mean(axis=0))
    assert_allclose(parts[:, 1], 1.0)
    # a sample on a border is in the middle of its own step, whichever part has how much of it
    assert_allclose(np.diff(parts[:, 0]), count / PARTS, atol=0.5 * PARTS / count)


@pytest.mark.parametrize("steps", [[1, 1, 1, 2], [0.5, 1.5], [0.4, 0.4, 2.2]], ids=str)
def test_uneven_samples_leave_nothing_of_the_tools_inertia(steps):
    """Lost frames, or frames that come in bursts."""
    even = moving_hand()
    kept = np.cumsum(np.resize(steps, len(even.time_s))) / RATE
    kept = kept[kept < even.time_s[-1]]
    time = np.concatenate([[0.0], kept])
    series = {name: interpolated(time, even.time_s, getattr(even, name)) for name in SERIES}
    near = np.abs(time[:, None] - even.time_s).argmin(axis=1)
    uneven = replace(even, time_s=time, phase=even.phase[near], segment=even.segment[near], **series)
    left = [compensate(each).wrench_on_object_world[:, :3] for each in (even, uneven)]
    assert_allclose(left[1][10:-10], interpolated(time, even.time_s, left[0])[10:-10], atol=0.05)


@pytest.mark.parametrize(("rate", "acceleration"), [(100, 1.0), (20, 1.0), (10, 0.25)])
def test_accelerations_are_right_at_any_rate(rate, acceleration):
    lift = Lift(0, acceleration=acceleration, swings=6, hold=2.5)
    profile = lift.sampled(1 / rate)
    velocity = np.zeros((len(profile.height), 6))
    velocity[:, 3:] = profile.rate
    phase = np.where(profile.segment >= 0, Phase.STEADY, Phase.RAMP)
    series = {"time_s": np.arange(len(velocity)) / rate, "phase": phase, "segment": profile.segment}
    trial = world_record(len(velocity), tare=0, action=lift, tcp_velocity=velocity, **series)
    rates = twist_rates(trial)[:, 3:]
    for kept in steady_samples(trial):
        assert_allclose(rates[kept].mean(axis=0), profile.acceleration[kept].mean(axis=0), atol=0.01)


@pytest.mark.parametrize("steps", [[1.0], [0.4, 0.4, 2.2], [0.3, 0.3, 0.3, 3.1]], ids=str)
def test_an_acceleration_that_changes_is_followed_at_uneven_samples(steps):
    time = np.cumsum(np.resize(steps, 400)) / RATE
    velocity = np.column_stack([np.sin(2 * np.pi * time), np.zeros((400, 5))])
    found = twist_rates(world_record(400, time_s=time, tcp_velocity=velocity))[20:-20, 0]
    assert_allclose(found, 2 * np.pi * np.cos(2 * np.pi * time)[20:-20], atol=0.03 * 2 * np.pi)


@pytest.mark.parametrize("step", [0.01, 0.03, 0.05, 0.1])
def test_links_are_reduced_at_any_rate(step):
    count = round(12 / step)
    trial = world_record(count, tare=round(1 / step))
    time = step * np.arange(count)
    windows = link_windows(replace(trial, time_s=time, camera=PoseStream(time, np.zeros((count, 2, 3)))))
    assert len(windows) >= 20
    assert all(window.turned.shape == (PARTS, 2, 3) for window in windows)
