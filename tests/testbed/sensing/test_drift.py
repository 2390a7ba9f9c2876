"""Drift of the sensor's zero: drawn, stated, found in two tares, and limited on a bench."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed import InvalidValueError, Trial, draw_sensing, steady_windows
from testbed.sensing.compensation import compensate, tare_biases
from testbed.sensing.drift import Drift, DriftLimit, drift_of, judge_drift
from testbed.sensing.presets import PRESETS, Sensing, preset
from testbed.trajectory import Phase, Trajectory, load_trajectory, save_trajectory
from tests.fakes.robot import ACTION, FakeRobot, run_trial, small_object
from tests.helpers.records import DOWN, coloured_noise, moving_hand, record

BEFORE = np.array([3.0, -2.0, 5.0, 0.3, -0.2, 0.1])
AFTER = BEFORE + np.array([0.3, 0.0, 0.4, 0.0, -0.03, 0.04])
ASSUMED = preset("ft300s").drift_std


def closed(hand: Trajectory, before: np.ndarray = BEFORE, after: np.ndarray = AFTER) -> Trajectory:
    """The record with another tare at its end, its zero wandering evenly from one to the other."""
    count = len(hand.time_s)
    phase, segment = hand.phase.copy(), hand.segment.copy()
    phase[-90:], segment[-90:] = Phase.TARE, -1
    at = np.clip((np.arange(count) - 100) / (count - 190), 0, 1)[:, None]
    return replace(
        hand, phase=phase, segment=segment, sensor_wrench=hand.sensor_wrench + before + at * (after - before)
    )


@pytest.mark.parametrize("hand", [record(), moving_hand(count=400)], ids=["at rest", "moving"])
def test_both_biases_are_found_whatever_the_hand_does(hand: Trajectory):
    base = tare_biases(closed(hand, np.zeros(6), np.zeros(6)))
    first, last = tare_biases(closed(hand))
    assert_allclose(first - base[0], BEFORE, atol=1e-12)
    assert_allclose(last - base[1], AFTER, atol=1e-12)


def test_the_first_tare_alone_is_the_zero():
    hand = moving_hand(wrench_world=np.arange(6.0), count=400)
    whole = compensate(closed(hand, BEFORE, BEFORE))
    assert_allclose(whole.wrench_on_object_world[100:-90], compensate(hand).wrench_on_object_world[100:-90], atol=1e-9)
    drifted = compensate(closed(hand, BEFORE, AFTER))
    assert_allclose(drifted.wrench_on_object_world[:101], whole.wrench_on_object_world[:101], atol=1e-9)


def test_a_bias_is_drawn_after_the_tare_stays_to_the_end_and_reaches_the_object():
    clean = closed(record(), np.zeros(6), np.zeros(6))
    drawn = draw_sensing(clean, Sensing("biased", force_bias=1.0, torque_bias=0.1), seed=1)
    bias = drawn.sensor_wrench[-1]
    assert (bias != 0).all()
    assert np.array_equal(drawn.sensor_wrench, np.repeat([np.zeros(6), bias], [100, 300], axis=0))
    force = np.tile(DOWN.as_matrix() @ bias[:3], (300, 1))
    assert_allclose(drawn.wrench_on_object_world[100:, :3], force, atol=1e-12)


def test_drift_is_logged_and_too_much_is_no_data():
    drift = drift_of(closed(moving_hand(count=400)))
    assert drift is not None
    judged = judge_drift(closed(record(tare=100)), DriftLimit())
    assert judged.status == "fault"
    assert "zero moved by 0.50 N and 0.0500 N m; allowed: 0.2 N and 0.01 N m" in judged.reason
    assert judged.figures["drift_N"] == pytest.approx(0.5)
    assert judged.figures["drift_Nm"] == pytest.approx(0.05)
    change = [judged.figures[f"bias_after_{a}"] - judged.figures[f"bias_before_{a}"] for a in ("fx_N", "fz_N", "tz_Nm")]
    assert_allclose(change, (AFTER - BEFORE)[[0, 2, 5]], atol=1e-9)
    with pytest.raises(InvalidValueError, match="drift: the sensor's zero moved"):
        steady_windows(judged)


@pytest.mark.parametrize(("axis", "allowed", "beyond"), [(1, 0.199, 0.201), (4, 0.0099, 0.0101)])
def test_the_limit_is_where_it_says(axis: int, allowed: float, beyond: float):
    for change, status in ((allowed, "ok"), (-allowed, "ok"), (beyond, "fault"), (-beyond, "fault")):
        after = BEFORE + change * np.eye(6)[axis]
        assert judge_drift(closed(record(), BEFORE, after), DriftLimit()).status == status


def test_the_noise_of_the_sensor_is_no_drift():
    rng = np.random.default_rng(0)
    preset = PRESETS["ft300s"]
    noise = np.array([*preset.force_noise, *preset.torque_noise])
    for _ in range(50):
        still = closed(record(sensor_wrench=noise * coloured_noise(400, 6, preset.lag1, rng)), BEFORE, BEFORE)
        assert judge_drift(still, DriftLimit()).ok


def test_a_record_with_one_tare_says_its_bias_and_what_is_assumed():
    judged = judge_drift(record(sensor_drift_std=ASSUMED), DriftLimit())
    assert judged.ok
    assert_allclose(judged.sensor_drift_std, ASSUMED)
    assert judged.provenance["drift"].startswith("assumed, for want of a second tare: 0.005 N and 0.0003 N m")
    assert "bias_before_fx_N" in judged.figures
    assert not {"bias_after_fx_N", "drift_N"} & set(judged.figures)
    assert drift_of(record(tare=0)) is drift_of(record(tool=None)) is None


def test_a_trial_that_failed_otherwise_keeps_its_reason():
    slipped = closed(record(status="slipped", reason="it slipped"))
    judged = judge_drift(slipped, DriftLimit())
    assert (judged.status, judged.reason) == ("slipped", "it slipped")
    assert judged.figures["drift_N"] > 0.2


def test_estimators_weigh_a_record_by_what_its_tares_show_and_no_less_than_was_assumed():
    """A steady drift of the whole change is within the walk it is taken for at every moment of the trial."""
    judged = judge_drift(closed(record(sensor_drift_std=ASSUMED)), DriftLimit(1.0, 1.0))
    seconds = 3.0  # from the end of one tare to the end of the other
    assert_allclose(judged.sensor_drift_std[:3], 0.5 / np.sqrt(3 * seconds))
    assert_allclose(judged.sensor_drift_std[3:], 0.05 / np.sqrt(3 * seconds))
    assert "tares 3 s apart show 0.17 N and 0.017 N m per root second" in judged.provenance["drift"]
    (window,) = steady_windows(judged)
    change, passed = np.linalg.norm(AFTER[:3] - BEFORE[:3]), window.since_tare.mean()
    covered = np.sqrt(passed * np.trace(window.drift_covariance[:3, :3]))
    assert change * passed / seconds < covered <= change
    quiet = judge_drift(closed(record(sensor_drift_std=ASSUMED), BEFORE, BEFORE), DriftLimit())
    assert_allclose(quiet.sensor_drift_std, ASSUMED)


def ran(creep: float, **changes) -> Trajectory:
    """A trial whose zero creeps along y, N/s."""

    def watch(bench: FakeRobot) -> None:
        bench.troubles.drift = creep * np.eye(6)[1]

    return run_trial(Trial(small_object(), ACTION), watch, **changes)[0]


@pytest.mark.slow
def test_a_real_trial_says_how_its_zero_may_have_walked(tmp_path):
    """Never nothing: what is assumed of the sensor, or what the two tares show."""
    quiet, creeping = ran(0.0, change=lambda settings: replace(settings, drift_std=(0.05, 0.003))), ran(0.012)
    for trajectory in (quiet, creeping):
        assert trajectory.ok, trajectory.reason
        assert (trajectory.sensor_drift_std >= ASSUMED - 1e-12).all()
        save_trajectory(trajectory, tmp_path / "t.parquet")
        again = load_trajectory(tmp_path / "t.parquet")
        assert_allclose(again.sensor_drift_std, trajectory.sensor_drift_std)
        assert "N m per root second" in again.provenance["drift"]
    assert_allclose(quiet.sensor_drift_std, np.repeat([0.05, 0.003], 3))
    seconds = creeping.time_s[-1] - 1.0  # between the ends of the two tares
    assert creeping.sensor_drift_std[1] == pytest.approx(0.012 * seconds / np.sqrt(3 * seconds), rel=0.2)
    assert creeping.sensor_drift_std[1] > 1.5 * ASSUMED[1]
    (window,) = steady_windows(creeping)
    assert np.sqrt(window.since_tare.mean() * window.drift_covariance[1, 1]) > 0.012 * window.since_tare.mean() / 2


@pytest.mark.parametrize(("force", "torque", "doubted"), [(0.03, 0.7, True), (0.03, 0.2, False), (0.5, 0.7, False)])
def test_a_torque_that_drifts_alone_has_its_unit_doubted(force, torque, doubted):
    said = Drift(np.zeros(6), np.array([force, 0, 0, 0, torque, 0]), 20.0).exceeds(DriftLimit())
    assert ("is that in N m? Otherwise let" in said) == doubted and "let the sensor warm up" in said
