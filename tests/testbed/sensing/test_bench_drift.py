"""Drift of the sensor in trials of the real robot and in imported logs, and what estimators make of it."""

from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from testbed.robot.config import RobotSettings
from testbed.sensing.presets import preset
from testbed.sensing.windows import steady_windows
from testbed.trajectory import Trajectory, load_trajectory, save_trajectory
from testbed.trial import Trial
from tests.fakes.robot import ACTION, FakeRobot, robot_for, small_object

ASSUMED = preset("ft300s").drift_std


def ran(creep: float, **changes) -> Trajectory:
    """A trial whose zero creeps along y, N/s."""

    def watch(bench: FakeRobot) -> None:
        bench.troubles.drift = creep * np.eye(6)[1]

    _, runner = robot_for(Trial(small_object(), ACTION), watch, **changes)
    with runner:
        return runner.run(Trial(small_object(), ACTION))


def more(settings: RobotSettings) -> RobotSettings:
    """Settings that assume a faster walk."""
    return replace(settings, drift_std=(0.05, 0.003))


@pytest.mark.slow
def test_a_real_trial_says_how_its_zero_may_have_walked(tmp_path):
    """Never nothing: what is assumed of the sensor, or what the two tares show."""
    quiet, creeping = ran(0.0, change=more), ran(0.012)
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
