"""Static poses from a recording: rests and slow motion are found, and a calibration of them has honest errors."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose

from scenarios.cli.main import main
from testbed.importers.logs import LogError
from testbed.robot.calibration.file import load_calibration
from testbed.robot.calibration.recorded_poses import recorded_poses
from testbed.robot.calibration.static_poses import calibrate
from tests.fakes.static_hand import POSES, off, recorded


@pytest.mark.parametrize("sign", [1, -1])
def test_every_rest_is_a_pose_and_all_comes_back(tmp_path, sign):
    poses, _ = recorded_poses(*recorded(tmp_path, sign=sign))
    found = calibrate(poses)
    assert len(poses) == len(POSES) and found.sign == sign
    assert np.abs(off(found)).max() < 4
    assert found.mass_std < 0.002 and np.degrees(found.sensor_in_hand_std.max()) < 0.2


def test_slow_motion_will_do(tmp_path):
    poses, _ = recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=20.0))
    found = calibrate(poses)
    assert len(poses) > 100
    assert np.abs(off(found)).max() < 4


def test_fast_motion_will_not(tmp_path):
    with pytest.raises(LogError, match="0 rests of 1 s"):
        recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=0.8))


def test_gains_are_found_as_far_as_the_poses_tell_them(tmp_path):
    gain = np.array([1.03, 0.98, 1.01, 1.02, 0.97, 1.0])
    poses, _ = recorded_poses(*recorded(tmp_path, gain=gain))
    exact, found = calibrate(poses), calibrate(poses, gain_error=0.03)
    assert exact.misfit > 4 > found.misfit
    assert_allclose(found.gain[:3] / found.gain[0], gain[:3] / gain[0], atol=4e-3)
    assert (np.abs(found.gain - gain) < 3 * found.gain_std).all()
    assert 0.01 < found.gain_std[0] < 0.03, "one scale of all is the mass's too: only the statement limits it"


@pytest.mark.slow
def test_nine_in_ten_intervals_hold(tmp_path):
    scores = np.array([off(calibrate(recorded_poses(*recorded(tmp_path, seed=seed))[0])) for seed in range(60)])
    assert 0.85 < np.mean(np.abs(scores) < 1.645) < 0.96


@pytest.mark.slow
def test_the_command_writes_a_file_and_a_figure(tmp_path, capsys):
    log, mapping = recorded(tmp_path)
    out = tmp_path / "calibration.toml"
    main(["calibrate", str(mapping), str(log), "--out", str(out), "--figure", str(tmp_path / "residuals")])
    said = capsys.readouterr().out
    assert "8 poses, misfit" in said and "the tool weighs 0.9" in said
    assert load_calibration(out).poses == 8 and (tmp_path / "residuals.pdf").is_file()
