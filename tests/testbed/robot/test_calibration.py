"""Calibration by static poses, also of recordings, and of a tracker: errors are honest, and too little is refused."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from scenarios.cli.main import main
from testbed import GRAVITY, InvalidValueError
from testbed.importers.logs import LogError
from testbed.robot.calibration.file import (
    CalibrationFile,
    load_calibration,
    load_hand_eye,
    save_calibration,
    save_hand_eye,
)
from testbed.robot.calibration.hand_eye import HandEye, align
from testbed.robot.calibration.recorded_poses import recorded_poses
from testbed.robot.calibration.static_poses import (
    Calibration,
    CalibrationError,
    StaticPose,
    calibrate,
    sentences,
    static_pose,
)
from testbed.robot.interfaces import Pose
from testbed.robot.kinova.gripper import data_sheet
from testbed.simulation.motion import arm_model, gripper_tool
from testbed.toml import InvalidFileError
from tests.fakes.lab_bench import write_toml
from tests.fakes.static_hand import BIAS, COM, DOWN, ERROR, MASS, MOUNT, POSES, off, readings, recorded
from tests.helpers.records import coloured_noise

ANGLES = ((0, 0, 0), (0, 0, 90), (0, 0, -90), (0, 0, 180), (180, 0, 0), (0, 0, 37), (10, -20, 130))
MOUNTS = [Rotation.from_euler("xyz", angles, degrees=True) for angles in ANGLES]


def turned(calibration: Calibration, mount: Rotation) -> float:
    """Angle between the found and the true mount [rad]."""
    found = Rotation.from_quat(calibration.sensor_in_hand, scalar_first=True)
    return float((mount.inv() * found).magnitude())


@pytest.mark.parametrize("mount", MOUNTS, ids=map(str, ANGLES))
@pytest.mark.parametrize("sign", [1, -1])
def test_without_noise_all_comes_back(mount: Rotation, sign: int):
    found = calibrate(readings(mount, sign))
    assert found.sign == sign
    assert turned(found, mount) < 1e-7
    assert found.mass == pytest.approx(MASS, rel=1e-8)
    assert_allclose(found.com, mount.inv().apply(COM), atol=1e-8)
    assert_allclose(found.bias, BIAS, atol=1e-7)
    assert found.misfit < 1e-9


@pytest.mark.slow
def test_with_noise_errors_are_as_large_as_it_says():
    """Two mounts and signs in turn: errors are in the sensor's axes, which the mount only turns."""
    draws, scores = 60, []
    for seed in range(draws):
        mount, sign = ((MOUNTS[1], 1), (MOUNTS[6], -1))[seed % 2]
        found = calibrate(readings(mount, sign, noise=1.0, seed=seed))
        assert found.sign == sign
        scores.append(off(found, mount))
    z = np.array(scores)
    assert_allclose(np.mean(z**2, axis=0), 1.0, atol=0.75)  # 4 standard errors of a variance of 60
    assert np.mean(np.abs(z) < 2) > 0.9
    assert (np.abs(z.mean(axis=0)) < 4 / np.sqrt(draws)).all()


def walking(seed: int, step: float) -> list[StaticPose]:
    """60 poses of a sensor whose bias walks by `step` from one to the next, N and a hundredth of it in N m."""
    rng = np.random.default_rng(seed)
    hands = [DOWN * Rotation.from_rotvec(rng.uniform(-1.2, 1.2, 3)) for _ in range(60)]
    drift = np.cumsum(rng.standard_normal((60, 6)), axis=0) * step * np.repeat([1.0, 0.01], 3)
    still = readings(MOUNTS[6], noise=1.0, seed=seed, hands=hands)
    return [replace(pose, wrench=pose.wrench + walked) for pose, walked in zip(still, drift, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("step", [0.0, 0.1])
def test_a_bias_that_walks_is_found_and_counted(step: float):
    found = [calibrate(walking(seed, step)) for seed in range(8)]
    z = np.array([(each.mass - MASS) / each.mass_std for each in found])
    assert np.sqrt(np.mean(z**2)) < 2.0
    if step:
        walks = np.array([each.bias_walk for each in found])
        assert_allclose(np.median(walks, axis=0), step * np.repeat([1.0, 0.01], 3), rtol=0.4)
        assert max(abs(each.mass - MASS) for each in found) < 0.012
        assert any("the bias walks by up to" in line for line in sentences(found[0]))
    else:
        assert not any(each.bias_walk.any() for each in found)


def test_scatter_beyond_the_stated_noise_increases_all_errors_but_the_stated_one_of_the_gains():
    honest, shaky = (calibrate(readings(MOUNTS[0], noise=n, seed=3)) for n in (1.0, 10.0))
    assert honest.misfit < 3 < shaky.misfit
    assert shaky.mass_std / honest.mass_std == pytest.approx(np.sqrt(shaky.misfit / max(honest.misfit, 1)), rel=0.1)
    assert any("times as much as their noise" in line for line in sentences(shaky))
    assert not any("times as much" in line for line in sentences(honest))
    found = calibrate(readings(MOUNTS[0], noise=10.0, seed=3), gain_error=0.02)
    assert found.misfit > 3
    assert (found.gain_std < 0.02).all()


def test_it_finds_the_simulated_gripper_at_rest():
    model = arm_model()
    data = mujoco.MjData(model)
    rng = np.random.default_rng(0)
    poses = []
    hand = DOWN
    for _ in range(8):
        data.qpos[:7] = rng.uniform(-1.5, 1.5, 7)
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_fwdVelocity(model, data)
        data.qacc[:] = 0.0
        mujoco.mj_rnePostConstraint(model, data)
        mujoco.mj_sensorAcc(model, data)
        wrench = np.concatenate([data.sensor("ft/force").data, data.sensor("ft/torque").data])
        hand = Rotation.from_matrix(data.site("gripper/tcp").xmat.reshape(3, 3))
        poses.append(StaticPose(hand.as_quat(scalar_first=True), wrench + BIAS, ERROR))
    found, tool = calibrate(poses), gripper_tool(0.085)
    sensor = Rotation.from_matrix(data.site("ft/wrench").xmat.reshape(3, 3))
    assert found.sign == 1
    assert turned(found, hand.inv() * sensor) < 1e-6
    assert found.mass == pytest.approx(tool.mass, rel=1e-6)
    assert_allclose(found.com, tool.com, atol=1e-7)
    assert_allclose(found.bias, BIAS, atol=1e-5)


@pytest.mark.parametrize("width", [0.0, 0.03, 0.085])
def test_the_grippers_data_sheet_is_the_simulated_gripper(width: float):
    sheet, simulated = data_sheet(width), gripper_tool(width)
    for name, value in vars(simulated).items():
        assert_allclose(getattr(sheet, name), value, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("turn", "sign", "said"),
    [
        ((0, 0, 0), 1, ["not turned"]),
        ((0, 0, 90), 1, ["turned by 90.0 deg about z"]),
        ((0, 0, -90), 1, ["turned by -90.0 deg about z"]),
        ((0, 0, 45), -1, ["what the tool does to the arm: set sign = -1", "turned by 45.0 deg about z"]),
        ((0, 0, 180), -1, ["set sign = -1 (the same thing: its z axis is mirrored)", "turned by 180 deg about z"]),
        ((180, 0, 0), 1, ["turned by 180 deg about x"]),
        ((18.0, 24.0, 40.0), 1, ["turned by 50.0 deg about (0.36, 0.48, 0.80)"]),
    ],
)
def test_it_says_in_words_how_the_sensor_sits(turn: tuple[float, ...], sign: int, said: list[str]):
    words = "; ".join(sentences(calibrate(readings(Rotation.from_rotvec(turn, degrees=True), sign))))
    for sentence in said:
        assert sentence in words
    assert ("sign = -1" in words) == (sign < 0)


def test_a_mirrored_axis_is_recognised():
    """A driver that flips z of force and torque makes a left-handed frame."""
    flip = np.array([1, 1, -1, 1, 1, -1])
    mirrored = [StaticPose(p.hand, flip * p.wrench, p.standard_error) for p in readings(MOUNTS[0])]
    found = calibrate(mirrored)
    words = "; ".join(sentences(found))
    assert "its z axis is mirrored" in words
    # and what it says to do works: readings become what the arm does to the tool
    mount = Rotation.from_quat(found.sensor_in_hand, scalar_first=True)
    for pose, given in zip(mirrored, readings(MOUNTS[0]), strict=True):
        measured = found.sign * (pose.wrench - found.bias)
        truth = given.wrench - BIAS
        assert_allclose(mount.apply(measured.reshape(2, 3)), truth.reshape(2, 3), atol=1e-6)


@pytest.mark.parametrize(
    ("hands", "why"),
    [
        (POSES[:3], "got 3 poses; allowed: 4 or more"),
        ([DOWN] * 6, "too alike"),
        ([DOWN * Rotation.from_euler("z", 30.0 * i, degrees=True) for i in range(6)], "too alike"),
        (
            [DOWN * Rotation.from_euler("x", 20.0 * i, degrees=True) for i in range(6)],
            "do not determine the sensor's sign",
        ),
        (POSES, "61 mm behind the sensor; the signs of its force and its torque"),
    ],
    ids=["few", "one", "about the vertical", "about one axis", "torque of the other sign"],
)
def test_poses_that_do_not_settle_it_are_refused(hands: list[Rotation], why: str):
    torque = -1 if "torque" in why else 1
    for seed in range(2):
        with pytest.raises(CalibrationError, match=why):
            calibrate(readings(MOUNTS[5], noise=1.0, seed=seed, hands=hands, torque_sign=torque))


def test_small_tilts_are_enough_and_cost_certainty():
    small = [DOWN * Rotation.from_euler("xy", a, degrees=True) for a in ((0, 0), (25, 0), (-25, 0), (0, 25), (0, -25))]
    found, wide = (calibrate(readings(MOUNTS[1], noise=1.0, hands=hands)) for hands in (small, POSES))
    assert turned(found, MOUNTS[1]) < 4 * np.linalg.norm(found.sensor_in_hand_std)
    assert found.mass_std > wide.mass_std


def test_a_pose_is_the_mean_of_its_samples_with_its_error():
    rng = np.random.default_rng(0)
    spread = np.array([0.067, 0.083, 0.065, 0.0034, 0.0030, 0.0010])
    hand = DOWN.as_quat(scalar_first=True)
    means, errors = [], []
    for _ in range(200):
        pose = static_pose(hand, BIAS + spread * coloured_noise(300, 6, 0.3, rng))
        means.append(pose.wrench)
        errors.append(pose.standard_error)
    assert_allclose(np.std(means, axis=0), np.mean(errors, axis=0), rtol=0.2)
    assert_allclose(np.mean(means, axis=0), BIAS, atol=0.003)
    assert_allclose(StaticPose(hand, BIAS, ERROR).up, DOWN.inv().apply([0, 0, 1]))


@pytest.fixture(scope="module")
def mounted() -> Calibration:
    return calibrate(readings(MOUNTS[6], -1, noise=1.0))


def test_a_file_restores_the_calibration(tmp_path: Path, mounted: Calibration):
    # a gain that a lab has written by hand may have no error
    scaled = replace(mounted, gain=np.array([1.02, 1, 1, 1, 1, 1]))
    walked = calibrate(walking(1, 0.1))
    assert walked.bias_walk.all() and abs(walked.mass - MASS) < 0.012
    assert any("the bias walks by up to" in line for line in sentences(walked))
    path = tmp_path / "new" / "mount.toml"
    for found in (scaled, walked):
        save_calibration(path, found, "FSC-1234", "2026-01-31")
        for serial in (None, "unknown", "FSC-1234"):
            back = load_calibration(path, serial)
            for name, value in vars(found).items():
                assert np.array_equal(getattr(back, name), value), name
    other = r"mount\.toml: sensor: got 'FSC-1234'; allowed: FSC-9, which is plugged"
    with pytest.raises(InvalidValueError, match=other):
        load_calibration(path, "FSC-9")


MEASURED = [n for n in CalibrationFile.model_fields if n.startswith(("bias", "tool")) and "std" not in n]
"""Numbers of a calibration, each of which has bounds."""


@pytest.mark.parametrize(
    ("line", "new", "field"),
    [
        ("sign = .*", "sign = 2", r"sign: got 2"),
        ("sign = .*", "sigm = -1", r"sigm: no such field.*nearest: sign"),
        ("tool_mass_kg = .*", "tool_mass_kg = -0.9", r"tool_mass_kg: got -0\.\d+"),
        ("sensor_in_hand_wxyz = .*", "sensor_in_hand_wxyz = [3.0, 1, 0, 0, 0]", r"sensor_in_hand_wxyz"),
        ("sensor_in_hand_wxyz = .*", "sensor_in_hand_wxyz = [1, 1, 0, 0]", "sensor_in_hand_wxyz: .*a unit quaternion"),
        ("poses = 8", "", r"poses: missing"),
        *((rf"({name} = .*?)[-+.\de]+(\]?)", r"\g<1>1e6\2", name) for name in MEASURED),
    ],
)
def test_a_damaged_file_is_refused(tmp_path: Path, mounted: Calibration, line: str, new: str, field: str):
    path = tmp_path / "mount.toml"
    save_calibration(path, replace(mounted, bias_walk=np.full(6, 0.1)), "FSC-1234", "2026-01-31")
    load_calibration(path)
    text, count = re.subn(rf"(?m)^{line}$", new, path.read_text("utf-8"))
    assert count == 1
    path.write_text(text, encoding="utf-8")
    with pytest.raises(InvalidFileError, match=field):
        load_calibration(path)


def test_a_trackers_file_names_its_error(tmp_path: Path):
    path = tmp_path / "hand_eye.toml"
    save_hand_eye(path, HandEye(Pose(np.zeros(3), np.array([1.0, 0, 0, 0])), 0.0, 0.0), "2026-01-31")
    path.write_text(path.read_text("utf-8").replace("[1.0, ", "[2.0, "), encoding="utf-8")
    with pytest.raises(InvalidFileError, match=r"hand_eye\.toml: tracker_in_base_wxyz: .*a unit quaternion"):
        load_hand_eye(path)


@pytest.mark.parametrize(("change", "field"), [({"mass": 12.0}, "tool_mass_kg"), ({"gain": np.full(6, 3.0)}, "gain")])
def test_a_calibration_that_no_file_restores_is_not_written(tmp_path, mounted, change: dict[str, Any], field: str):
    path = tmp_path / "mount.toml"
    with pytest.raises(InvalidFileError, match=rf"mount\.toml: {field}"):
        save_calibration(path, replace(mounted, **change), "1", "today")
    assert not path.exists()


TURN, PLACE = Rotation.from_euler("xyz", [170, 5, 40], degrees=True), np.array([0.5, -0.2, 1.1])
CORNERS = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.15, 0.15) for z in (0.9, 1.0)])
"""Points in a tracker's frame [m]."""
LINE = np.linspace(0, 1, 6)[:, None] * np.array([1.0, 2.0, 0.5])


def touched(points: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    return TURN.apply(points) + PLACE + noise * np.random.default_rng(seed).standard_normal(points.shape)


@pytest.mark.parametrize("points", [CORNERS, CORNERS[::2]], ids=["in space", "in a plane"])
def test_without_noise_a_trackers_frame_comes_back(points: np.ndarray):
    found = align(points, touched(points))
    assert_allclose(found.tracker_in_base.position, PLACE, atol=1e-9)
    assert (Rotation.from_quat(found.tracker_in_base.orientation, scalar_first=True) * TURN.inv()).magnitude() < 1e-9
    assert found.residual < 1e-12
    assert_allclose(found.to_base(points), touched(points), atol=1e-12)


def test_a_trackers_standard_error_near_the_points_is_honest():
    draws = [align(CORNERS, touched(CORNERS, 0.001, seed)) for seed in range(300)]
    errors = [np.linalg.norm(d.to_base(CORNERS) - touched(CORNERS), axis=1) for d in draws]
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean([d.standard_error for d in draws]), rel=0.15)


@pytest.mark.parametrize(("points", "why"), [(LINE, "within 0 mm of one line"), (CORNERS[:3], "got 3 points")])
def test_too_few_or_collinear_points_are_refused(points, why):
    with pytest.raises(CalibrationError, match=why):
        align(points, touched(points))


@pytest.mark.parametrize("sign", [1, -1])
def test_every_rest_is_a_pose_and_all_comes_back(tmp_path, sign):
    poses, _ = recorded_poses(*recorded(tmp_path, sign=sign))
    found = calibrate(poses)
    assert len(poses) == len(POSES) and found.sign == sign
    assert np.abs(off(found)).max() < 4
    assert found.mass_std < 0.002 and np.degrees(found.sensor_in_hand_std.max()) < 0.2


def test_a_stated_delay_of_the_wrench_is_taken_off(tmp_path):
    log, mapping = recorded(tmp_path)
    table, late = pd.read_csv(log), 150
    wrench = [kind + axis for kind in "ft" for axis in "xyz"]
    table[wrench] = table[wrench].shift(late).bfill()
    table.to_csv(log, index=False)
    delay = late * (table["t"][1] - table["t"][0])
    mapping.write_text(mapping.read_text("utf-8").replace("[sensor]", f"[sensor]\ndelay_s = {delay}"), encoding="utf-8")
    found = calibrate(recorded_poses(log, mapping)[0])
    assert found.misfit < 3 and np.abs(off(found)).max() < 4


@pytest.mark.slow
def test_slow_motion_without_rests_is_calibrated(tmp_path):
    poses, _ = recorded_poses(*recorded(tmp_path, rest_s=0.0, way_s=20.0))
    assert len(poses) > 100
    assert np.abs(off(calibrate(poses))).max() < 4


def test_fast_motion_without_rests_is_refused(tmp_path):
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


def table_of(folder: Path, poses: list[StaticPose], hands: pd.DataFrame, **mapping: Any) -> tuple[Path, Path]:
    """Table whose rows are poses, with these columns for the hand's orientation, and its mapping."""
    wrench, place = [kind + axis for kind in "ft" for axis in "xyz"], list("xyz")
    rows = pd.DataFrame([[*pose.wrench, 0.0, 0.0, 0.0] for pose in poses], columns=[*wrench, *place])
    rows.loc[hands.isna().any(axis=1), place] = np.nan
    rows.join(hands).to_csv(folder / "rows.csv")
    hand = {"position": place, "orientation": list(hands), "orientation_as": "wxyz"}
    fields = {"rows": "poses", "sensor": {"force": wrench[:3], "torque": wrench[3:]}, "hand": hand | mapping}
    return folder / "rows.csv", write_toml(folder / "map.toml", fields | {"gravity": 9.79})


@pytest.mark.slow
def test_a_row_is_a_pose(tmp_path):
    """A table without times; matrices in place of quaternions; the scatter of a fit is the error of a reading."""
    every = readings(MOUNT, noise=1.0, seed=2, hands=[*POSES, *(hand * DOWN for hand in POSES)])
    cells = Rotation.from_quat([pose.hand for pose in every], scalar_first=True).as_matrix().reshape(-1, 9)
    hands = pd.DataFrame(cells, columns=[f"r{i}{j}" for i in "123" for j in "123"])
    table, mapping = table_of(tmp_path, every, hands, orientation_as="matrix")
    poses, _ = recorded_poses(table, mapping)
    found = calibrate(poses)
    assert len(poses) == len(every) and found.misfit == pytest.approx(1, abs=0.05)
    assert np.abs(off(found)).max() < 4
    out = tmp_path / "calibration.toml"
    main(["calibrate", str(mapping), str(table), "--out", str(out)])
    there = load_calibration(out)
    assert there.gravity == 9.79 and there.mass == pytest.approx(found.mass * GRAVITY / 9.79, rel=1e-6)
    hands.loc[3, "r11"] += 0.2
    with pytest.raises(LogError, match=r"hand.orientation: no rotation at sample 3"):
        recorded_poses(*table_of(tmp_path, every, hands, orientation_as="matrix"))


@pytest.mark.parametrize("seed", range(3))
def test_rows_of_small_tilts_are_calibrated(tmp_path, seed):
    """Readings of 0.05 N and 3 mN m, tilts of 30 deg."""
    axes = np.radians(30) * np.array([[np.cos(a), np.sin(a), 0] for a in np.arange(7) * np.pi / 3.5])
    hands = [DOWN, *(DOWN * Rotation.from_rotvec(axis) for axis in axes)]
    every = readings(MOUNT, noise=4.0, seed=seed, hands=hands)
    columns = pd.DataFrame([pose.hand for pose in every], columns=["qw", "qx", "qy", "qz"])
    found = calibrate(recorded_poses(*table_of(tmp_path, every, columns))[0])
    assert found.sign == 1 and found.mass == pytest.approx(MASS * GRAVITY / 9.79, abs=0.02)


def test_rows_of_one_pose_are_all_kept(tmp_path):
    """Equal rows are no frozen source; those without a hand are left out."""
    every = readings(MOUNT, noise=1.0, hands=[hand for hand in POSES for _ in range(2)])
    hands = pd.DataFrame([pose.hand for pose in every], columns=["qw", "qx", "qy", "qz"])
    hands.loc[4] = np.nan
    poses, _ = recorded_poses(*table_of(tmp_path, every, hands))
    assert len(poses) == len(every) - 1
    assert np.abs(off(calibrate(poses))).max() < 4


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
