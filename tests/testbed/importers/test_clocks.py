"""Clocks and units of logs: shifts between streams, rates, gaps, and SI values."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.testing.recorded import load_block
from testbed import HeftError, InvalidValueError, Phase, Trajectory, draw_sensing, preset
from testbed.importers.clocks import LONGEST_DELAY, MODEL_ERROR, Delay, pooled_delay, wrench_delay
from testbed.importers.importer import delay_of, import_trajectory
from testbed.importers.logs import FACTORS, LogError, Series, factor
from testbed.importers.phases import common_base, resampled, resampled_rotation
from testbed.sensing.series import interpolated
from tests.fakes.lab_bench import at_other_rates, mapping_of, phases_of, write_toml


@pytest.fixture(scope="module")
def turns() -> list[Trajectory]:
    """Accelerated turns about two grasps."""
    clean = load_block("L2-own_weight").clean
    return [draw_sensing(clean[i], preset("ft300s"), seed) for i, seed in ((0, 1), (2, 3))]


def written(folder: Path, turns: list[Trajectory], late: float, **sensor: Any) -> Path:
    """Pose and wrench of every turn as two files, the wrench's stamps late and in us; and their mapping."""
    logs = []
    for i, turn in enumerate(turns):
        force, hand = at_other_rates(turn, 125.0, 100.0, seed=i)
        hand.to_csv(folder / f"pose_{i}.csv", index=False)
        force.assign(stamp=1e6 * (force["stamp"] + late)).rename(columns={"stamp": "us"}).to_csv(
            folder / f"ft_{i}.csv", index=False
        )
        logs.append({"file": f"pose_{i}.csv", "sensor_file": f"ft_{i}.csv", "action": turn.action.to_dict()})
        logs[-1]["phases"] = phases_of(turn)
    mapping = mapping_of(turns[0], action=None, time={"column": "stamp"}, logs=logs)
    mapping["sensor"] |= {"time": {"column": "us", "unit": "us"}} | sensor
    return write_toml(folder / "map.toml", mapping)


@pytest.mark.parametrize("late", [0.0, 0.05])
def test_a_delay_is_found_and_taken_off(turns: list[Trajectory], tmp_path: Path, late: float):
    mapping = written(tmp_path, turns, late)
    found = [delay_of(tmp_path / f"pose_{i}.csv", mapping) for i in range(2)]
    for delay in found:
        assert delay is not None
        assert abs(delay.seconds - late) < 3 * delay.std
        assert delay.std < 0.004
    mean = pooled_delay([delay for delay in found if delay])
    assert mean is not None
    assert abs(mean.seconds - late) < 0.002
    again = import_trajectory(tmp_path / "pose_0.csv", mapping, delay=mean)
    assert again.figures["wrench_delay_s"] == mean.seconds
    assert again.provenance["delay"].endswith("ms late, by accelerated turns; " + "not " * (late == 0) + "taken off")
    turned = again.phase == Phase.STEADY
    there = interpolated(again.time_s, turns[0].time_s, turns[0].sensor_wrench)
    off = np.sqrt(np.mean((again.sensor_wrench - there)[turned][:, 5] ** 2))
    assert off < 0.2 * np.std(there[turned][:, 5])


@pytest.mark.parametrize("axis", [[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.6, 0.0, 0.8]])
def test_a_delay_is_the_same_in_any_frame_of_the_hand(turns: list[Trajectory], axis: list[float]):
    turn = turns[0]
    hand = Rotation.from_quat(turn.sensor_orientation, scalar_first=True)
    torque = np.sum(turn.sensor_wrench[:, 3:] * hand.inv().apply([0.0, 0.0, 1.0]), axis=1)
    late = np.interp(turn.time_s - 0.05, turn.time_s, torque)
    other = hand * Rotation.from_rotvec(np.pi / 2 * np.array(axis))
    usual, found = (wrench_delay(late, turn.tcp_position, one, turn.time_s) for one in (hand, other))
    assert found.seconds == pytest.approx(usual.seconds, abs=1e-4) == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize("count", [1, 4, 16])
def test_the_error_of_the_model_is_common_to_all_turns(count):
    own = 0.003
    found = pooled_delay([Delay(0.02, float(np.hypot(own, MODEL_ERROR)))] * count)
    assert found is not None
    assert found.std == pytest.approx(np.hypot(own / np.sqrt(count), MODEL_ERROR))


def test_a_hand_that_never_turns_shows_no_delay():
    with pytest.raises(LogError, match=r"the turn accelerates for 0\.0 s; allowed: 1 s or more"):
        wrench_delay(np.zeros(500), np.zeros((500, 3)), Rotation.identity(500), np.arange(500) / 100)


def test_a_delay_can_be_given(turns: list[Trajectory], tmp_path: Path):
    mapping = written(tmp_path, turns[:1], 0.03, delay_s=0.03)
    assert delay_of(tmp_path / "pose_0.csv", mapping) is None
    given = import_trajectory(tmp_path / "pose_0.csv", mapping)
    assert given.provenance["delay"] == "30.0 ms late, as given; taken off"
    none = import_trajectory(tmp_path / "pose_0.csv", written(tmp_path, turns[:1], 0.0, delay_s=0.0))
    assert_allclose(given.sensor_wrench, none.sensor_wrench, atol=1e-9)


def test_other_clocks_are_refused(turns: list[Trajectory], tmp_path: Path):
    far = written(tmp_path, turns[:1], 2 * LONGEST_DELAY)
    with pytest.raises(HeftError, match=r"delay: the wrench is late or early by more than 0.2 s"):
        import_trajectory(tmp_path / "pose_0.csv", far)
    with pytest.raises(HeftError, match=r"40.0 ms in one turn and .* allowed: the same clocks"):
        pooled_delay([Delay(0.04, 0.002), Delay(0.0, 0.002), Delay(0.001, 0.002)])
    assert pooled_delay([]) is None


def jittered(rate: float, seconds: float, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return 5.0 + np.cumsum(rng.uniform(0.5, 1.5, int(seconds * rate)) / rate)


@given(st.sampled_from([20.0, 90.0, 100.0, 180.0, 1000.0]), st.integers(0, 99), st.floats(-5, 5), st.floats(-50, 50))
def test_a_line_stays_a_line(rate: float, seed: int, slope: float, level: float):
    time = jittered(rate, 3.0, seed)
    series = Series(time, (level + slope * time)[:, None])
    base = common_base([series], 0.2)
    assert_allclose(np.diff(base), 0.01, atol=1e-9)
    inner = slice(1, -1)  # at an end, half a sample's average is not centered
    assert_allclose(resampled(series, base)[inner, 0], (level + slope * base)[inner], atol=1e-8)


def test_white_noise_is_averaged():
    time = np.arange(100_000) / 1000
    series = Series(time, np.random.default_rng(0).standard_normal((100_000, 1)))
    assert resampled(series, common_base([series], 0.1)).std() == pytest.approx(1 / np.sqrt(10), rel=0.05)


@given(st.integers(0, 99), st.floats(-3, 3))
def test_a_steady_turn_stays_one(seed: int, rate: float):
    time = jittered(70.0, 3.0, seed)
    axis = np.array([0.36, 0.48, 0.8])
    turning = Rotation.from_rotvec(rate * time[:, None] * axis)
    base = np.arange(time[0], time[-1], 0.01)
    expected = Rotation.from_rotvec(rate * base[:, None] * axis)
    assert (resampled_rotation(time, turning, base) * expected.inv()).magnitude().max() < 1e-9


def test_the_base_is_what_all_have_in_common():
    a, b = (Series(np.arange(begin, end, 0.01), np.zeros((300, 1))) for begin, end in ((0.0, 3.0), (1.0, 4.0)))
    base = common_base([a, b], 0.1)
    assert_allclose(base[[0, -1]], [1.0, 2.99], atol=1e-9)
    with pytest.raises(LogError, match=r"have 0\.00 s in common"):
        common_base([a, Series(a.time_s + 10, a.values)], 0.1)


@pytest.mark.parametrize(
    ("quantity", "unit", "one"),
    [
        ("force", "kgf", 9.80665),
        ("force", "lbf", 4.4482216),
        ("force", "mN", 1e-3),
        ("torque", "N mm", 1e-3),
        ("torque", "kgf cm", 0.0980665),
        ("torque", "lbf in", 0.11298483),
        ("angle", "deg", np.pi / 180),
        ("turn rate", "deg/s", np.pi / 180),
        ("length", "mm", 1e-3),
        ("time", "ns", 1e-9),
        ("speed", "cm/s", 1e-2),
    ],
)
def test_units_have_their_si_values(quantity: str, unit: str, one: float):
    assert factor(quantity, unit) == pytest.approx(one, rel=1e-7)
    with pytest.raises(InvalidValueError, match=f"a unit of {quantity}: {next(iter(FACTORS[quantity]))}"):
        factor(quantity, "furlong")
