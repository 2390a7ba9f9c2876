"""Tests of the camera: its draws, the motion between its frames, and its stream in a trajectory file."""

import re
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.testing.analytic_world import analytic_trial, record
from testbed import Rotate, Slide, draw_sensing, load_object, load_trajectory, preset, save_trajectory
from testbed.sensing.camera import CAMERAS, Camera, PoseStream, draw_camera
from testbed.sensing.camera_poses import frame_mismatch
from testbed.sensing.series import interpolated

TIME = np.arange(600) / 100


def moved(time: np.ndarray) -> np.ndarray:
    """Pose, twist and acceleration of a known motion, as a push has it, (N, 3, 3)."""
    a, w = np.array([0.05, 0.03, 0.6]), np.array([0.7, 0.5, 0.6])
    phase = w * time[:, None]
    return np.stack([a * np.sin(phase), a * w * np.cos(phase), -a * w**2 * np.sin(phase)], axis=1)


def seen(camera: Camera, seed: int, parts: int = 1) -> PoseStream:
    """Frames of the known motion, each part's further along."""
    true = np.stack([moved(TIME)[:, 0] + part for part in range(parts)], axis=1)
    return draw_camera(PoseStream(TIME, true), camera, seed)


def test_motion_of_an_exact_stream_is_the_motion():
    at = np.array([0.0, 0.013, 2.5, 5.99])
    stream = seen(CAMERAS["exact"], 0, parts=2)
    true = moved(at)
    for part in (0, 1):
        motion = stream.motion(at, part)
        assert np.allclose(motion.pose, true[:, 0] + part, atol=1e-8)
        assert np.allclose(motion.twist[1:3], true[1:3, 1], atol=1e-6)
        assert not motion.covariance.any()
    assert np.isnan(stream.motion(np.array([-1.0, 7.0])).twist).all()
    late = seen(replace(CAMERAS["exact"], delay=(0.03, 0.03)), 3)  # by a known time
    assert late.motion(at[2:3]).twist == pytest.approx(true[2:3, 1], abs=1e-4)
    assert late.delay_std == 0


def test_errors_of_the_motion_have_the_stated_covariance():
    at, camera = np.array([0.1, 3.0, 5.0]), replace(CAMERAS["30hz"], dropout=0.2)
    true = moved(at).reshape(3, 9)
    scores = []
    for seed in range(150):
        motion = seen(camera, seed).motion(at)
        error = np.hstack([motion.pose, motion.twist, motion.acceleration]) - true
        scores.append([e @ np.linalg.solve(c, e) for e, c in zip(error, motion.covariance, strict=True)])
        assert np.isfinite(motion.covariance).all()
    # chi-square of 9: the polynomial's own bias adds a little, and a delay is not drawn from a normal distribution
    assert np.allclose(np.mean(scores, axis=0), 9, rtol=0.2)


@pytest.mark.parametrize(("lost", "seen_within"), [(0.3, True), (0.6, False)])
def test_no_motion_is_seen_where_frames_were_lost(lost, seen_within):
    stream = seen(CAMERAS["30hz"], 1)
    kept = np.abs(stream.time_s - 3.0) > lost / 2
    cut = replace(stream, time_s=stream.time_s[kept], poses=stream.poses[kept])
    found = np.isfinite(cut.motion(np.array([2.0, 3.0, 4.0])).twist).all(axis=1)
    assert found.tolist() == [True, seen_within, True]
    sparse = PoseStream(TIME[::50], moved(TIME)[::50, :1])  # an even stream of 2 Hz lost nothing
    assert np.isfinite(sparse.motion(np.array([3.2])).twist).all()


@pytest.mark.parametrize(("scale", "said"), [(1.0, "^$"), (1.1, r"^its distances are \+1\d % off")])
def test_a_turn_shows_another_scale_of_the_camera(scale, said):
    shape, errors = load_object("L2").shape, np.array([1e-3, 1e-3, 0.009])
    trial = analytic_trial(load_object("L2"), Rotate(0, duration=6.0, back=True))
    noise = errors * np.random.default_rng(0).standard_normal(trial.object_pose.shape)
    first = trial.object_pose[0]
    poses = first + (trial.object_pose - first) * [scale, scale, 1.0] + noise
    camera = PoseStream(trial.time_s, poses[:, None], errors[0], errors[2])
    assert re.search(said, frame_mismatch(replace(trial, camera=camera), shape))


@pytest.mark.parametrize(("noise", "said"), [(1.0, ""), (5.0, "its frames scatter by")])
@pytest.mark.parametrize("steps", [[0.022, 0.045], [0.033, 0.033, 0.1]], ids=["uneven", "lost"])
def test_uneven_and_lost_frames_are_no_scatter(steps, noise, said):
    shape, std = load_object("L2").shape, np.array([5e-4, 5e-4, 2e-3])
    trial = analytic_trial(load_object("L2"), Slide(0, speed=0.15, duration=2.5))
    at = trial.time_s[0] + np.cumsum(np.resize(steps, 400))
    at = at[at < trial.time_s[-1]]
    poses = interpolated(at, trial.time_s, trial.object_pose)
    poses += noise * std * np.random.default_rng(0).standard_normal(poses.shape)
    camera = PoseStream(at, poses[:, None], std[0], std[2], 0.0115)
    message = frame_mismatch(replace(trial, camera=camera), shape)
    assert message.startswith(said) and bool(message) == bool(said)


def test_a_record_without_motion_or_frames_is_no_mismatch():
    shape, none = load_object("L2").shape, PoseStream(np.zeros(0), np.zeros((0, 1, 3)))
    for camera in (PoseStream(TIME, moved(TIME)[:, :1]), none):
        assert not frame_mismatch(record(400, tare=400, camera=camera, action=Rotate(0)), shape)
    drawn = draw_camera(none, CAMERAS["30hz"], 0)
    assert drawn.poses.shape == (0, 1, 3) and drawn.position_std == CAMERAS["30hz"].position


def test_draws_lose_frames_and_differ_by_seed():
    one, again, other = (seen(CAMERAS["30hz"], seed) for seed in (1, 1, 2))
    assert np.array_equal(one.poses, again.poses, equal_nan=True) and not np.array_equal(one.time_s, other.time_s)
    lost = np.mean([np.isnan(seen(CAMERAS["30hz"], seed).poses).mean() for seed in range(50)])
    assert lost == pytest.approx(CAMERAS["30hz"].dropout, abs=0.01)


def test_a_trajectory_keeps_its_stream(tmp_path):
    clean = replace(record(600, provenance={"runner": "simulation"}), camera=PoseStream(TIME, moved(TIME)[:, :1]))
    drawn = draw_sensing(clean, preset("ft300s"), 4)
    assert drawn.camera is not None and drawn.camera.position_std == CAMERAS["30hz"].position
    none = PoseStream(np.zeros(0), np.zeros((0, 2, 3)))
    for whole in (clean, drawn, replace(clean, camera=none), replace(clean, camera=None)):
        save_trajectory(whole, tmp_path / "trajectory.parquet")
        back = load_trajectory(tmp_path / "trajectory.parquet").camera
        assert (back is None) == (whole.camera is None)
        if back is not None and whole.camera is not None:
            assert np.array_equal(back.poses, whole.camera.poses, equal_nan=True) and back.parts == whole.camera.parts
            assert (back.time_s == whole.camera.time_s).all() and back.delay_std == whole.camera.delay_std
    kept = draw_sensing(clean, preset("ft300s:camera=exact"), 4)
    assert kept.camera is clean.camera and (kept.sensor_wrench == drawn.sensor_wrench).all()
    assert preset("ft300s:bias=2:camera=exact").stated.name == "ft300s:camera=exact"


def test_parts_that_are_seen_in_turn_are_drawn_each_by_its_own_frames():
    time = np.arange(10) / 10
    poses = np.tile(time[:, None, None], (1, 2, 3))
    poses[::2, 0] = poses[1::2, 1] = np.nan
    found = PoseStream(time, poses).at(np.array([0.25, 0.7]))
    assert np.allclose(found, np.array([0.25, 0.7])[:, None, None])


def test_joint_angles_of_parts_with_stamps_of_their_own_are_those_of_common_ones():
    poses = np.full((600, 2, 3), np.nan)
    for part in (0, 1):
        poses[part::2, part] = np.column_stack([0 * TIME, 0 * TIME, (part + 1) * 0.3 * TIME])[part::2]
    poses[200:230, 1] = np.nan
    found = PoseStream(TIME, poses).joint_angles[:, 0]
    measured = ~np.isnan(found)
    assert not measured[205:225].any() and measured.sum() > 560
    assert_allclose(found[measured], 0.3 * TIME[measured], atol=1e-9)
    poses[:, 1] = np.where(np.arange(600)[:, None] == 301, poses[:, 1], np.nan)
    assert (~np.isnan(PoseStream(TIME, poses).joint_angles)).sum() == 1


@pytest.mark.parametrize("start", [-7.0, 3.1, 20.0])
def test_whole_turns_of_a_yaw_change_nothing(start):
    yaw = start + 0.7 * TIME
    poses = np.zeros((600, 2, 3))
    poses[:, 0, 2], poses[:, 1, 2] = yaw, np.remainder(yaw + 0.2, 2 * np.pi)
    poses[100:103, 1] = np.nan
    found = PoseStream(TIME, poses)
    assert_allclose(found.motion(TIME[50:250], 1).twist[:, 2], 0.7, atol=1e-6)
    measured = ~np.isnan(found.joint_angles[:, 0])
    assert measured.sum() == 597
    assert_allclose(found.joint_angles[measured, 0], 0.2, atol=1e-9)
