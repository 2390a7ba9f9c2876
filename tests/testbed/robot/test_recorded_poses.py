"""Static poses from a recording: rests and slow motion are found, and a calibration of them has honest errors."""

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from scenarios.cli.main import main
from testbed.importers.logs import LogError
from testbed.objects.model import GRAVITY
from testbed.robot.calibration.file import load_calibration
from testbed.robot.calibration.recorded_poses import recorded_poses
from testbed.robot.calibration.static_poses import StaticPose, calibrate
from tests.fakes.lab_bench import write_toml
from tests.fakes.static_hand import DOWN, ERROR, MOUNT, POSES, off, readings, recorded


@pytest.mark.parametrize("sign", [1, -1])
def test_every_rest_is_a_pose_and_all_comes_back(tmp_path, sign):
    poses, _ = recorded_poses(*recorded(tmp_path, sign=sign))
    found = calibrate(poses)
    assert len(poses) == len(POSES) and found.sign == sign
    assert np.abs(off(found)).max() < 4
    assert found.mass_std < 0.002 and np.degrees(found.sensor_in_hand_std.max()) < 0.2


@pytest.mark.slow
def test_slow_motion_will_do(tmp_path):
    poses, _ = recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=20.0))
    found = calibrate(poses)
    assert len(poses) > 100
    assert np.abs(off(found)).max() < 4


def test_fast_motion_will_not(tmp_path):
    with pytest.raises(LogError, match="0 rests of 1 s"):
        recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=0.8))


@pytest.mark.slow
def test_gains_are_found_as_far_as_the_poses_tell_them(tmp_path):
    gain = np.array([1.03, 0.98, 1.01, 1.02, 0.97, 1.0])
    poses, _ = recorded_poses(*recorded(tmp_path, gain=gain))
    exact, found = calibrate(poses), calibrate(poses, gain_error=0.03)
    assert exact.misfit > 4 > found.misfit
    assert_allclose(found.gain[:3] / found.gain[0], gain[:3] / gain[0], atol=4e-3)
    assert (np.abs(found.gain - gain) < 3 * found.gain_std).all()
    assert 0.01 < found.gain_std[0] < 0.03, "one scale of all is the mass's too: only the statement limits it"


@pytest.mark.slow
def test_a_row_may_be_a_pose(tmp_path):
    """A table without times; matrices in place of quaternions; the scatter of a fit is the error of a reading."""
    every = readings(MOUNT, noise=1.0, seed=2, hands=[*POSES, *(hand * DOWN for hand in POSES)])
    hands = Rotation.from_quat([pose.hand for pose in every], scalar_first=True).as_matrix().reshape(-1, 9)
    cells = [f"r{i}{j}" for i in "123" for j in "123"]
    wrench = [kind + axis for kind in "ft" for axis in "xyz"]
    rows = np.column_stack([hands, [pose.wrench for pose in every], np.zeros((len(every), 3))])
    pd.DataFrame(rows, columns=[*cells, *wrench, "x", "y", "z"]).to_csv(tmp_path / "rows.csv")
    columns = {"position": ["x", "y", "z"], "orientation": cells, "orientation_as": "matrix"}
    sensor = {"force": wrench[:3], "torque": wrench[3:]}
    mapping = write_toml(tmp_path / "map.toml", {"rows": "poses", "gravity": 9.79, "sensor": sensor, "hand": columns})
    poses, _ = recorded_poses(tmp_path / "rows.csv", mapping)
    found = calibrate(poses)
    assert len(poses) == len(every) and found.misfit == pytest.approx(1, abs=0.05)
    assert np.abs(off(found)).max() < 4
    out = tmp_path / "calibration.toml"
    main(["calibrate", str(mapping), str(tmp_path / "rows.csv"), "--out", str(out)])
    there = load_calibration(out)
    assert there.gravity == 9.79 and there.mass == pytest.approx(found.mass * GRAVITY / 9.79, rel=1e-6)
    rows[3, 0] += 0.2
    pd.DataFrame(rows, columns=[*cells, *wrench, "x", "y", "z"]).to_csv(tmp_path / "rows.csv")
    with pytest.raises(LogError, match=r"hand.orientation: no rotation at sample 3"):
        recorded_poses(tmp_path / "rows.csv", mapping)


@pytest.mark.slow
def test_each_axis_scatters_in_its_own_way():
    """Readings of a sensor whose axes are off each by its own size: errors are those of repeated calibrations."""
    rng, scores = np.random.default_rng(4), []
    hands = [*POSES, *(hand * DOWN for hand in POSES), *(hand * MOUNT for hand in POSES)]
    for _ in range(40):
        exact = readings(MOUNT, hands=hands)
        size = 50 * ERROR * [1, 0.2, 0.5, 0.3, 1, 0.1]
        shaky = [StaticPose(p.hand, p.wrench + size * rng.standard_normal(6), p.standard_error) for p in exact]
        scores.append(off(calibrate(shaky)))
    assert 0.85 < np.mean(np.abs(scores) < 1.645) < 0.95


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
