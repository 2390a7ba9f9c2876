"""Static poses from a recording: rests and slow motion are found, and a calibration of them has honest errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from scenarios.cli.main import main
from testbed.importers.logs import LogError
from testbed.importers.still import recorded_poses
from testbed.objects.model import GRAVITY
from testbed.robot.calibration.file import load_calibration
from testbed.robot.calibration.static_poses import calibrate
from tests.fakes.static_hand import BIAS, COM, MASS, POSES

RATE = 100.0
NOISE = np.array([0.1, 0.1, 0.1, 0.005, 0.005, 0.005])
MAPPING = """
[time]
column = "t"
[sensor]
force = ["fx", "fy", "fz"]
torque = ["tx", "ty", "tz"]
[hand]
position = ["x", "y", "z"]
orientation = ["qw", "qx", "qy", "qz"]
"""
MOUNT = Rotation.from_euler("xyz", (10, -20, 130), degrees=True)


def recorded(folder: Path, *, rest_s=2.0, way_s=2.0, sign=1, noise=1.0, gain=None, seed=0) -> tuple[Path, Path]:
    """A recording of a hand that goes from pose to pose and rests in each, and its mapping."""
    rng, times = np.random.default_rng(seed), [0.0]
    hands = [hand for hand in POSES for _ in range(2)]
    for k in range(1, len(hands)):
        times.append(times[-1] + max(rest_s if k % 2 else way_s, 1e-6))
    time = np.arange(round(times[-1] * RATE)) / RATE
    hand = Slerp(times, Rotation.concatenate(hands))(time)
    up = (hand * MOUNT).inv().apply([0.0, 0.0, 1.0])
    force = MASS * GRAVITY * up
    load = np.hstack([force, np.cross(MOUNT.inv().apply(COM), force)])
    wrench = sign * load * (1 if gain is None else gain) + BIAS + noise * NOISE * rng.standard_normal((len(time), 6))
    columns = np.column_stack([time, wrench, np.zeros((len(time), 3)), hand.as_quat(scalar_first=True)])
    names = ["t", "fx", "fy", "fz", "tx", "ty", "tz", "x", "y", "z", "qw", "qx", "qy", "qz"]
    pd.DataFrame(columns, columns=names).to_csv(folder / "log.csv", index=False)
    (folder / "map.toml").write_text(MAPPING, encoding="utf-8")
    return folder / "log.csv", folder / "map.toml"


def off(found) -> np.ndarray:
    """Errors over those that it claims: mount, mass, center and bias."""
    turn = (MOUNT.inv() * Rotation.from_quat(found.sensor_in_hand, scalar_first=True)).as_rotvec()
    com = MOUNT.inv().apply(COM)
    return np.concatenate([
        turn / found.sensor_in_hand_std,
        [(found.mass - MASS) / found.mass_std],
        (found.com - com) / found.com_std,
        (found.bias - BIAS) / found.bias_std,
    ])  # fmt: skip


@pytest.mark.parametrize("sign", [1, -1])
def test_every_rest_is_a_pose_and_all_comes_back(tmp_path, sign):
    poses = recorded_poses(*recorded(tmp_path, sign=sign))
    found = calibrate(poses)
    assert len(poses) == len(POSES) and found.sign == sign
    assert np.abs(off(found)).max() < 4
    assert found.mass_std < 0.002 and np.degrees(found.sensor_in_hand_std.max()) < 0.2


def test_slow_motion_will_do(tmp_path):
    poses = recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=20.0))
    found = calibrate(poses)
    assert len(poses) > 100
    assert np.abs(off(found)).max() < 4


def test_fast_motion_will_not(tmp_path):
    with pytest.raises(LogError, match="0 rests of 1 s"):
        recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=0.8))


def test_gains_are_found_as_far_as_the_poses_tell_them(tmp_path):
    gain = np.array([1.03, 0.98, 1.01, 1.02, 0.97, 1.0])
    poses = recorded_poses(*recorded(tmp_path, gain=gain))
    exact, found = calibrate(poses), calibrate(poses, gain_error=0.03)
    assert exact.misfit > 4 > found.misfit
    assert_allclose(found.gain[:3] / found.gain[0], gain[:3] / gain[0], atol=4e-3)
    assert (np.abs(found.gain - gain) < 3 * found.gain_std).all()
    assert 0.01 < found.gain_std[0] < 0.03, "one scale of all is the mass's too: only the statement limits it"


@pytest.mark.slow
def test_nine_in_ten_intervals_hold(tmp_path):
    scores = np.array([off(calibrate(recorded_poses(*recorded(tmp_path, seed=seed)))) for seed in range(60)])
    assert 0.85 < np.mean(np.abs(scores) < 1.645) < 0.96


def test_the_command_writes_a_file_and_a_figure(tmp_path, capsys):
    log, mapping = recorded(tmp_path)
    out = tmp_path / "calibration.toml"
    main(["calibrate", str(mapping), str(log), "--out", str(out), "--figure", str(tmp_path / "residuals")])
    said = capsys.readouterr().out
    assert "8 poses, misfit" in said and "the tool weighs 0.9" in said
    assert load_calibration(out).poses == 8 and (tmp_path / "residuals.pdf").is_file()
