"""Sensing: the tool and a constant bias vanish, the drawn errors have the statistics that were asked for."""

import dataclasses

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.frames import cross_2d, perpendicular
from testbed.objects.model import GRAVITY
from testbed.sensing.compensation import compensate
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import PRESETS, Sensing, preset
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory
from tests.helpers.records import DOWN, NOISY, RATE, TOOL, moving_hand, record

BIAS = np.array([3.0, -2.0, 5.0, 0.3, -0.2, 0.1])
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
@pytest.mark.parametrize("axis", [(0, 0, 1), (1, -2, 0.5)])
def test_a_tool_alone_does_nothing_to_the_object_however_it_is_moved(start: Rotation, axis: tuple[float, float, float]):
    assert_allclose(compensate(moving_hand(start, axis)).wrench_on_object_world, 0, atol=1e-9)


@pytest.mark.parametrize("start", ORIENTATIONS)
def test_the_wrench_on_the_object_comes_back_at_the_tcp_in_world_axes(start: Rotation):
    wrench = np.array([1.0, -2.0, 0.5, 0.1, 0.2, -0.3])
    held = compensate(moving_hand(start, (1, 1, 3), wrench)).wrench_on_object_world
    assert_allclose(held[AFTER], np.tile(wrench, (100, 1)), atol=1e-9)


@pytest.mark.parametrize("start", ORIENTATIONS)
def test_the_tare_removes_any_constant_bias(start: Rotation):
    hand = moving_hand(start, (1, 1, 3), np.arange(6.0))
    biased = dataclasses.replace(hand, sensor_wrench=hand.sensor_wrench + BIAS)
    assert_allclose(compensate(biased).wrench_on_object_world, compensate(hand).wrench_on_object_world, atol=1e-9)


def test_the_weight_of_a_held_object_has_the_agreed_sign():
    weight = np.where(np.arange(400)[:, None] < 100, 0.0, [0, 0, -2.0 * GRAVITY, 0, 0, 0])  # sensor z is down
    lever = np.cross(TOOL.tcp, weight[:, :3])
    loaded = record(sensor_wrench=np.hstack([weight[:, :3], lever]))
    assert_allclose(compensate(loaded).wrench_on_object_world[AFTER][0], [0, 0, 19.62, 0, 0, 0], atol=1e-12)


@pytest.mark.parametrize(("lacks", "said"), [({"tare": 0}, "no samples in phase TARE"), ({"tool": None}, "no tool")])
def test_compensation_needs_a_tare_and_a_tool(lacks, said: str):
    with pytest.raises(InvalidValueError, match=said):
        compensate(record(**lacks))


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


def test_a_draw_says_that_it_was_drawn_and_not_which():
    told = {"runner": "simulation", "support": "rigid", "mujoco": "3"}
    drawn = draw_sensing(record(provenance=told), preset("ft300s"), seed=3)
    assert drawn.provenance == {"runner": "simulation", "sensing": "drawn"}
    assert drawn.simulated and not drawn.is_clean
    assert drawn.sensor_bias_std.tolist() == [0.05] * 3 + [0.003] * 3


def test_a_sensor_may_be_worse_than_its_data_sheet_states():
    quiet = {"force_noise": (0.0, 0.0, 0.0), "torque_noise": (0.0, 0.0, 0.0)}
    stated, worse = preset("ft300s"), preset("ft300s:bias=2:drift=0.5")
    one, other = (draw_sensing(record(), dataclasses.replace(sensor, **quiet), 1) for sensor in (stated, worse))
    assert_allclose(other.sensor_wrench[:100], 0.5 * one.sensor_wrench[:100])  # the walk alone, before the bias
    step = 99, 100
    biases = [np.diff(drawn.sensor_wrench[step, :], axis=0) for drawn in (one, other)]
    assert_allclose(biases[1], 2 * biases[0], atol=6 * np.abs(stated.drift_std).max() / np.sqrt(RATE))
    for name in ("sensor_bias_std", "sensor_drift_std"):
        assert np.array_equal(getattr(one, name), getattr(other, name))
    assert worse.stated == stated != worse
    for wrong in ("ft300s:bias=", "ft300s:bias=1.2.3", "ft300s:noise=2", ":bias=2"):
        with pytest.raises(InvalidValueError, match="sensing"):
            preset(wrong)


def test_an_unknown_preset_lists_the_presets():
    with pytest.raises(InvalidValueError, match="sensing: got 'perfect'; allowed: one of ideal, ft300s, low"):
        preset("perfect")


def test_noise_has_the_spread_and_colour_asked_for(long_record: Trajectory):
    noise = draw_sensing(long_record, NOISY, seed=1).sensor_wrench
    assert_allclose(noise.std(axis=0), [*NOISY.force_noise, *NOISY.torque_noise], rtol=0.04)
    assert_allclose(lag1(noise), NOISY.lag1, atol=0.03)
    assert_allclose(np.corrcoef(noise, rowvar=False), np.eye(6), atol=0.04)


def test_noise_starts_at_its_full_spread():
    short = record(12, tare=6)
    first = np.array([draw_sensing(short, NOISY, seed).sensor_wrench[0] for seed in range(400)])
    assert_allclose(first.std(axis=0), [*NOISY.force_noise, *NOISY.torque_noise], rtol=0.15)


BIASED = Sensing("biased", force_bias=1.0, torque_bias=0.1)
SHAKY = Sensing("shaky", linear_acceleration_noise=0.05, angular_acceleration_noise=0.5)


def test_a_bias_comes_only_after_the_tare_and_reaches_the_object():
    drawn = draw_sensing(record(), BIASED, seed=1)
    assert np.array_equal(drawn.sensor_wrench[:100], np.zeros((100, 6)))
    assert np.array_equal(drawn.sensor_wrench[AFTER], np.tile(drawn.sensor_wrench[-1], (300, 1)))
    force = DOWN.as_matrix() @ drawn.sensor_wrench[-1, :3]
    assert_allclose(drawn.wrench_on_object_world[AFTER, :3], np.tile(force, (300, 1)), atol=1e-12)


def test_a_bias_has_the_spread_asked_for():
    short = record(12, tare=6)
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
    count = 300
    clean = record(
        count, object_pose=np.tile([*origin, 0.7], (count, 1)), tcp_position=np.tile([*hand, 0.02], (count, 1))
    )
    drawn = draw_sensing(clean, SHAKY, seed=1)
    rate = drawn.tcp_velocity[:, 5]
    apart = drawn.object_velocity[:, :2] - drawn.tcp_velocity[:, :2]
    assert rate.std() > 1e-4
    assert_allclose(drawn.object_velocity[:, 2], rate, atol=1e-15)
    assert_allclose(apart, rate[:, None] * perpendicular(origin - hand), atol=1e-15)
    assert_allclose(apart @ (origin - hand), 0, atol=1e-15)
    assert_allclose(cross_2d(origin - hand, apart), rate * np.sum((origin - hand) ** 2), atol=1e-15)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *(("lag1", bad) for bad in (1.0, -0.1, np.nan)),
        *(("force_noise", bad) for bad in ((0.1, 0.1, -0.1), (0.1, 0.1))),
        *(("torque_noise", bad) for bad in (0.1, (0.1, 0.1, np.nan))),
        ("force_bias", -1.0),
        ("torque_bias", np.inf),
        ("force_drift", np.nan),
        ("torque_drift", "0.1"),
        ("linear_acceleration_noise", -0.1),
        ("angular_acceleration_noise", None),
        ("scale", -0.001),
    ],
)
def test_errors_of_a_sensor_out_of_range_are_refused(name: str, value):
    with pytest.raises(InvalidValueError) as refused:
        Sensing("odd", **{name: value})
    assert refused.value.field == f"Sensing.{name}"


@pytest.mark.parametrize("count", [1, 5])
def test_a_scale_errs_by_its_own_spread(count: int):
    reading = np.tile([0, 0, 1.8 * GRAVITY, 0, 0, 0], (count, 1))
    clean = record(count, tare=0, action=Weigh(), tool=None, wrench_on_object_world=reading)
    sensing = Sensing("scale", scale=0.002)
    read = [weight_of(draw_sensing(clean, sensing, seed)) for seed in range(400)]
    assert weight_of(draw_sensing(clean, preset("ideal"), 0)) == pytest.approx(1.8, abs=1e-12)
    assert np.mean(read) == pytest.approx(1.8, abs=4 * 0.002 / np.sqrt(400))
    assert np.std(read) == pytest.approx(0.002, rel=0.15)
