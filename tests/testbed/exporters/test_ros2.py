"""Trials written as ROS 2 messages: each number in the file, and again after `heft import`."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose

from estimators.testing.recorded import load_block
from testbed import InvalidValueError, Lift, Push, Rotate, SetupErrors, Trajectory, draw_sensing, preset
from testbed.exporters.ros2 import JOINTS, mapping_text, write_mcap
from testbed.frames import rotation_matrix
from testbed.importers.messages import open_messages
from testbed.sensing.link_windows import link_windows
from testbed.sensing.push_windows import push_windows
from tests.fakes.lab_bench import through_mcap
from tests.helpers.simulated import clean

pytest.importorskip("rosbags", reason="needs the extra robot")
from mcap.reader import make_reader

BLOCK = load_block("L2-own_weight")
EPOCH = 1_767_225_600
FIELDS = {
    "/wrench": ("sensor_wrench", [f"wrench.{p}.{a}" for p in ("force", "torque") for a in "xyz"]),
    "/wrench_on_object": ("wrench_on_object_world", [f"wrench.{p}.{a}" for p in ("force", "torque") for a in "xyz"]),
    "/tcp/velocity": ("tcp_velocity", [f"twist.{p}.{a}" for p in ("linear", "angular") for a in "xyz"]),
    "/joint_states": ("joint_position", [f"position.{name}" for name in JOINTS]),
}


def measured(index: int) -> Trajectory:
    """A turn under an FT-300S, as a robot's program might keep it: with joints, a date and the errors of its setup."""
    whole = draw_sensing(BLOCK.clean[index], preset("ft300s"), 0)
    joints = np.random.default_rng(0).normal(0, 0.01, (len(whole.time_s), 7)).cumsum(axis=0)
    recorded = {"runner": "robot", "recorded": "2026-01-01T00:00:00.250+00:00"}
    return replace(whole, joint_position=joints, setup=SetupErrors(gain=0.01, tcp_offset=0.001), provenance=recorded)


@pytest.mark.parametrize("index", [pytest.param(0, marks=pytest.mark.slow), -1], ids=["accelerate", "rotate"])
def test_what_is_imported_is_what_was_measured(tmp_path: Path, index: int):
    given = measured(index)
    back = through_mcap(given, "L2", tmp_path)
    for name in ("time_s", "phase", "segment", "sensor_wrench", "tcp_position", "tcp_velocity", "joint_position"):
        assert np.array_equal(getattr(back, name), getattr(given, name)), name
    # quaternions are made units, and the rest follows from what is above
    turned = [rotation_matrix(t.sensor_orientation) for t in (back, given)]
    assert_allclose(turned[0], turned[1], atol=1e-15)
    assert_allclose(back.wrench_on_object_world, given.wrench_on_object_world, atol=1e-12)
    for name, rounded in (("object_pose", 2e-6), ("object_velocity", 2e-5)):  # as the block's record is
        assert_allclose(getattr(back, name), getattr(given, name), atol=rounded, err_msg=name)
    assert (back.action, back.setup) == (given.action, given.setup)
    assert_allclose(back.sensor_drift_std, given.sensor_drift_std, rtol=0)
    assert back.provenance["recorded"] == "2026-01-01T00:00:00.000+00:00"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["push", "links"])
def test_what_a_camera_saw_comes_back(tmp_path: Path, kind: str):
    """Frames at their own times, but for what was not seen: the windows are the same."""
    folded = Path("scenarios/library/objects/elbow.toml").resolve()
    name = "L2" if kind == "push" else str(folded)
    action = Push((-0.05, 0.01), 0.0, speed=0.05, length=0.06) if kind == "push" else Rotate(0, duration=2.5)
    given = draw_sensing(clean(name, action), preset("ft300s"), 1)
    back = through_mcap(given, name, tmp_path)
    assert back.action == given.action
    read = push_windows if kind == "push" else link_windows
    assert len(read(back)) == len(read(given))
    for one, other in zip(read(back), read(given), strict=True):
        assert_allclose(one.wrench, other.wrench, atol=1e-6)
        assert_allclose(one.twist, other.twist, atol=1e-7)
        assert_allclose(one.turned[..., 1:], other.turned[..., 1:], atol=1e-7)


@pytest.mark.slow
def test_the_file_holds_every_number_of_samples_at_any_time(tmp_path: Path):
    turn = measured(0)
    time = np.cumsum(np.random.default_rng(0).uniform(0.005, 0.015, len(turn.time_s)))
    given = replace(turn, time_s=time - time[0])
    write_mcap(given, path := tmp_path / "turn.mcap")
    log = open_messages(path)
    for topic, (series, names) in FIELDS.items():
        assert np.array_equal(log.values("", names, topic, log.messages(topic)), getattr(given, series)), topic
    stamps = np.array([m.log_time for m in log.messages("/wrench")]) - EPOCH * 10**9
    assert np.abs(stamps - given.time_s * 1e9).max() <= 0.5 + 1e-4  # [ns], and float64's own of a minute
    pose, tree = log.messages("/tcp/pose")[7].content["pose"], log.messages("/tf")[7].content["transforms"]
    assert [pose["orientation"][axis] for axis in "wxyz"] == given.sensor_orientation[7].tolist()
    assert [edge["child_frame_id"] for edge in tree] == ["tcp", "tcp_level", "object"]
    place, turn = (tree[2]["transform"][name] for name in ("translation", "rotation"))
    yaw = 2 * np.arctan2(turn["z"], turn["w"])
    assert_allclose([place["x"], place["y"], yaw], given.object_pose[7], atol=1e-12)
    (static,) = log.messages("/tf_static")
    assert [edge["child_frame_id"] for edge in static.content["transforms"]] == ["sensor"]
    with path.open("rb") as file:
        (kept,) = make_reader(file).iter_metadata()
    assert {"status": "ok", "recorded": given.provenance["recorded"]}.items() <= kept.metadata.items()


def test_what_is_no_motion_over_the_table_is_refused(tmp_path: Path):
    shape, turn = BLOCK.model.shape, measured(0)
    scale = Trajectory.of_scale(np.ones(3), np.arange(3.0), {})
    for trajectory, field in ((scale, "action"), (replace(turn, status="slipped"), "status")):
        with pytest.raises(InvalidValueError, match=f"trajectory.{field}"):
            mapping_text(trajectory, shape, "L2", "turn.mcap")
    with pytest.raises(InvalidValueError, match="allowed: rotate, accelerate, slide or push"):
        mapping_text(replace(turn, action=Lift(0)), shape, "L2", "turn.mcap")
    with pytest.raises(InvalidValueError, match="a trial of an arm"):
        write_mcap(scale, tmp_path / "scale.mcap")
