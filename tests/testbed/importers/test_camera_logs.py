"""Poses of a camera in another bench's logs: pushes and objects in links come back, by columns and messages."""

import json
import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.testing.recorded import load_block
from scenarios.cli.main import main
from testbed import Phase, Push, Rotate, Trajectory, draw_sensing, load_object, preset
from testbed.importers.importer import import_trajectory
from testbed.importers.logs import Series
from testbed.importers.poses import without_frozen, without_held
from testbed.importers.segments import find_segments
from testbed.sensing.camera import PoseStream
from testbed.sensing.compensation import tare_samples
from testbed.sensing.link_windows import link_windows
from testbed.sensing.push_windows import push_windows
from testbed.sensing.windows import SteadyWindow
from tests.fakes.lab_bench import (
    EPOCH,
    import_csv,
    mapping_of,
    phases_of,
    refused,
    write_csv,
    write_messages,
    write_toml,
)
from tests.helpers.records import series_of
from tests.helpers.simulated import clean

CAMERA = Rotation.from_euler("xyz", [170, 12, 40], degrees=True)
"""Camera over the table, that looks down on it."""
LINKS = "upper", "lower"
EYE = np.array([0.3, -0.2, 0.9])
LABEL = Rotation.from_euler("xyz", [180, 0, 25], degrees=True)
"""Label on the object, its z axis into it."""
BESIDE = np.array([0.02, -0.01, 0.03])
"""Object frame in the label's."""
LATE = 0.03
"""Mean delay of the frames [s]."""
CAMERA_TABLE = {
    "in_base_m": EYE.tolist(),
    "in_base_wxyz": CAMERA.as_quat(scalar_first=True).tolist(),
    "delay_s": LATE,
    "position_std_m": 0.001,
    "angle_std_deg": 0.5,
    "delay_std_s": 0.04 / math.sqrt(12),
}
FOLD = Path("scenarios/library/objects/elbow.toml").resolve()
LABELED = {"object_m": BESIDE.tolist(), "object_wxyz": LABEL.as_quat(scalar_first=True).tolist()}


@pytest.fixture(scope="module")
def push() -> Trajectory:
    return draw_sensing(clean("L2", Push((-0.05, 0.01), 0.0, speed=0.05, length=0.06)), preset("ft300s"), 3)


@pytest.fixture(scope="module")
def fold() -> Trajectory:
    return draw_sensing(clean(str(FOLD), Rotate(0, duration=3.0)), preset("ft300s"), 3)


def labels(t: Trajectory, part: int) -> tuple[np.ndarray, np.ndarray, Rotation]:
    """Stamps, places and turns of a label as the camera tells them, in its own frame."""
    assert t.camera is not None
    seen = ~np.isnan(t.camera.poses[:, part, 0])
    x, y, yaw = t.camera.poses[seen, part].T
    turned = Rotation.from_euler("z", yaw[:, None]) * LABEL.inv()
    place = np.column_stack([x, y, np.zeros(len(x))]) - turned.apply(BESIDE)
    return t.camera.time_s[seen] + LATE, CAMERA.inv().apply(place - EYE), CAMERA.inv() * turned


def write_frames(path: Path, t: Trajectory, part: int = 0) -> Path:
    """Table of a label, mm and degrees about x, then y, then z."""
    time, place, turned = labels(t, part)
    angles = turned.as_euler("xyz", degrees=True)
    stamp = 1e3 * (EPOCH + time)
    names = ["x", "y", "z", "roll", "pitch", "yaw"]
    pd.DataFrame({"stamp": stamp, **dict(zip(names, [*(1e3 * place.T), *angles.T], strict=True))}).to_csv(path)
    return path


def part_of(file: Path, **changes: Any) -> dict[str, Any]:
    columns = {"position": ["x", "y", "z"], "orientation": ["roll", "pitch", "yaw"]}
    units = {"position_unit": "mm", "orientation_as": "roll_pitch_yaw", "angle_unit": "deg"}
    return {"file": file.name, **columns, **units, **LABELED, **changes}


def mapping_with(t: Trajectory, name: str, parts: list[dict[str, Any]], **changes: Any) -> dict[str, Any]:
    return mapping_of(t, object=name, camera={**CAMERA_TABLE, "parts": parts} | changes)


def same_frames(found: PoseStream | None, true: PoseStream | None) -> None:
    """Frames but for the stamps' rounding, and those that saw nothing."""
    assert found is not None
    assert true is not None
    seen = ~np.isnan(true.poses[..., 0]).all(axis=1)
    assert_allclose(found.time_s, true.time_s[seen], atol=1e-6, rtol=0)
    off = found.poses - true.poses[seen]
    off[..., 2] = np.angle(np.exp(1j * off[..., 2]))
    assert_allclose(off, 0.0, atol=1e-9, rtol=0)
    for name in ("position_std", "angle_std", "delay_std"):
        assert getattr(found, name) == pytest.approx(getattr(true, name), rel=0.01)


def same_windows(found: list[SteadyWindow], true: list[SteadyWindow]) -> None:
    assert len(found) == len(true)
    for one, other in zip(found, true, strict=True):
        assert_allclose(one.wrench, other.wrench, atol=5e-3, rtol=0)
        assert_allclose(one.twist, other.twist, atol=5e-4, rtol=0)


def test_a_push_comes_back_with_the_object_where_the_camera_saw_it(push: Trajectory, tmp_path: Path):
    frames = write_frames(tmp_path / "frames.csv", push)
    mapping = mapping_with(push, "L2", [part_of(frames)])
    found = import_csv(tmp_path, push, mapping)
    assert found.action == push.action
    same_frames(found.camera, push.camera)
    assert_allclose(found.object_pose, push.object_pose, atol=1e-6, rtol=0)
    assert len(push_windows(found)) == len(push_windows(push))  # by phases from the motion
    found = import_csv(tmp_path, push, mapping | {"phases": phases_of(push)})
    same_windows(push_windows(found), push_windows(push))


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 1e-4])
def test_a_push_is_found(push: Trajectory, tmp_path: Path, noise: float):
    """Point, direction and radius by the camera's poses; the log alone gives speed and way."""
    assert isinstance(push.action, Push)
    frames = write_frames(tmp_path / "frames.csv", push)
    place = push.tcp_position + noise * np.random.default_rng(0).standard_normal(push.tcp_position.shape)
    log = write_csv(tmp_path / "log.csv", replace(push, tcp_position=place))
    table = mapping_with(push, "L2", [part_of(frames)])
    mapping = write_toml(tmp_path / "map.toml", table | {"action": None, "joints": None})
    (found,) = [segment for segment in find_segments(log, mapping) if segment.action]
    assert isinstance(found.action, Push) and found.kind == "push" and found.tare is not None
    assert_allclose(found.action.point, push.action.point, atol=2e-3, rtol=0)
    for name, tolerance in (("direction", 0.02), ("speed", 2e-3), ("radius", 1e-3), ("length", 5e-3), ("curvature", 0)):
        assert getattr(found.action, name) == pytest.approx(getattr(push.action, name), abs=tolerance)
    main(["import", str(mapping), str(log), "--find"])
    again = import_trajectory(log, tmp_path / "map.found.toml")
    assert again.ok and push_windows(again)


def test_the_camera_names_the_grasp_of_a_turn(tmp_path: Path):
    """Several grasps fit the hand's path of one turn; one fits the object's pose."""
    turn = next(t for t in load_block("L2-own_weight").trials("ft300s") if isinstance(t.action, Rotate))
    watched = replace(turn, camera=PoseStream(turn.time_s, turn.object_pose[:, None], 0.001, 0.01, 0.01))
    log, frames = write_csv(tmp_path / "log.csv", watched), write_frames(tmp_path / "frames.csv", watched)
    table = mapping_with(watched, "L2", [part_of(frames)]) | {"action": None, "joints": None}
    blind = write_toml(tmp_path / "blind.toml", {name: value for name, value in table.items() if name != "camera"})
    grasp = load_object("L2").shape.grasps[turn.action.grasp or 0].name
    for mapping, one in ((blind, False), (write_toml(tmp_path / "map.toml", table), True)):
        (found,) = [segment for segment in find_segments(log, mapping) if segment.action]
        assert grasp in found.grasps and (len(found.grasps) == 1) == one
    assert isinstance(found.action, Rotate) and found.action.grasp == turn.action.grasp


def test_frames_that_a_faster_table_holds_count_once_and_a_rest_is_kept():
    time, at = np.arange(400) / 100, np.floor(np.arange(400) * 0.3) / 30
    place = np.column_stack([np.clip(at - 1.0, 0.0, 2.0), np.zeros((400, 2))])
    series, turned = without_held((Series(time, place), Rotation.identity(400)))
    moves = (series.time_s > 1.1) & (series.time_s < 3.0)
    assert np.median(np.diff(series.time_s[moves])) == pytest.approx(1 / 30, abs=0.004)
    assert (series.time_s < 1.0).sum() == 100 and len(turned) == len(series.time_s)
    lost = np.where((time > 2.0) & (time < 2.4), 2.0, at)  # the last frame before is held for 0.4 s
    moving = np.column_stack([0.1 * lost, np.zeros((400, 2))])
    left = without_frozen(without_held((Series(time, moving), Rotation.identity(400))))[0].time_s
    assert np.diff(left).max() > 0.35


def test_a_rest_of_rounded_poses_is_no_lost_source():
    """One count of 1 um before a rest, and one after it."""
    place = 1e-6 * np.concatenate([np.arange(6), np.full(100, 6), np.arange(7, 20)])[:, None] * np.ones(3)
    pose = Series(np.arange(len(place)) / 100, place), Rotation.identity(len(place))
    assert without_frozen(pose) is pose


def test_a_zeroed_sensor_needs_no_tare(push: Trajectory, tmp_path: Path):
    """The log begins after the tare, whose mean is already subtracted."""
    assert push.camera is not None and push.tool is not None
    begin = int(np.flatnonzero(push.segment >= 0)[0]) - 30
    start = float(push.time_s[begin])
    kept = series_of(push, slice(begin, None))
    kept["time_s"] -= start
    kept["sensor_wrench"] -= push.sensor_wrench[tare_samples(push)].mean(axis=0)
    cut = replace(push, camera=replace(push.camera, time_s=push.camera.time_s - start), **kept)
    mapping = mapping_with(cut, "L2", [part_of(write_frames(tmp_path / "frames.csv", cut))])
    assert "no tare" in refused(write_csv(tmp_path / "log.csv", cut), mapping)
    mapping["sensor"]["zeroed"] = True
    assert len(push_windows(import_csv(tmp_path, cut, mapping))) == len(push_windows(push))
    steady = [
        {"phase": "steady", "from_s": phase["from_s"] - start, "to_s": phase["to_s"] - start}
        for phase in phases_of(push)
        if phase["phase"] == "steady"
    ]
    found = import_csv(tmp_path, cut, mapping | {"phases": steady})
    assert not found.mask(Phase.TARE).any()
    same_windows(push_windows(found), push_windows(push))


def test_each_log_may_name_its_frames(push: Trajectory, tmp_path: Path):
    mapping = mapping_with(push, "L2", [part_of(write_frames(tmp_path / "frames.csv", push)) | {"file": "none.csv"}])
    named = mapping | {"logs": [{"file": "log.csv", "camera_files": ["frames.csv"]}]}
    same_frames(import_csv(tmp_path, push, named).camera, push.camera)
    several = mapping | {"logs": [{"file": "log.csv", "camera_files": ["frames.csv", "frames.csv"]}]}
    assert "a file for each of 1 parts" in refused(tmp_path / "log.csv", several)


@pytest.mark.slow
def test_links_come_back_each_by_its_own_label(fold: Trajectory, tmp_path: Path):
    parts = [part_of(write_frames(tmp_path / f"link_{i}.csv", fold, i)) for i in range(2)]
    mapping = mapping_with(fold, str(FOLD), parts) | {"phases": phases_of(fold)}
    found = import_csv(tmp_path, fold, mapping)
    same_frames(found.camera, fold.camera)
    same_windows(link_windows(found), link_windows(fold))
    for one, other in zip(link_windows(found), link_windows(fold), strict=True):
        assert_allclose(one.turned[:, :, 1:], other.turned[:, :, 1:], atol=1e-4, rtol=0)


def test_a_planar_pose_needs_three_columns(push: Trajectory, tmp_path: Path):
    assert push.camera is not None
    seen = ~np.isnan(push.camera.poses[:, 0, 0])
    x, y, yaw = push.camera.poses[seen, 0].T
    stamp = 1e3 * (EPOCH + push.camera.time_s[seen] + LATE)
    pd.DataFrame({"stamp": stamp, "x": x, "y": y, "turn": yaw}).to_csv(tmp_path / "frames.csv")
    part = {"file": "frames.csv", "position": ["x", "y"], "orientation": ["turn"], "orientation_as": "yaw"}
    mapping = mapping_of(push, object="L2", camera={"parts": [part]})
    same_frames(import_csv(tmp_path, push, mapping).camera, push.camera)


@pytest.mark.slow
def test_labels_come_as_messages_and_as_a_tree(fold: Trajectory, tmp_path: Path):
    """An .mcap beside the table of the arm: a tree that knows where the camera is, and poses in the camera's frame."""
    eye = {"header": {"frame_id": "base"}, "child_frame_id": "camera", "transform": transform(EYE, CAMERA)}
    tree, messages = "tf2_msgs/TFMessage", [message("/tf_static", "tf2_msgs/TFMessage", 0.0, {"transforms": [eye]})]
    for part, name in enumerate(LINKS):
        for time, place, turned in zip(*labels(fold, part), strict=True):
            header, at = {"stamp": stamp_of(time), "frame_id": "camera"}, transform(place, turned)
            moved = {"header": header, "child_frame_id": name, "transform": at}
            messages.append(message("/tf", tree, time, {"transforms": [moved]}))
            if name == "lower":
                at = {"position": at["translation"], "orientation": at["rotation"]}
                pose = {"header": header, "pose": at}
                messages.append(message("/label", "geometry_msgs/PoseStamped", time, pose))
    write_messages(tmp_path / "seen.mcap", messages)
    upper, lower = ({"file": "seen.mcap", "topic": "/tf", "frame": name, "time": {}, **LABELED} for name in LINKS)
    by_tree = {key: value for key, value in CAMERA_TABLE.items() if not key.startswith("in_base")}
    mapping = mapping_of(fold, object=str(FOLD), camera={**by_tree, "parts": [upper, lower]})
    same_frames(import_csv(tmp_path, fold, mapping).camera, fold.camera)
    label = {"file": "seen.mcap", "topic": "/label", "time": {}, **LABELED}
    mapping = mapping_with(fold, str(FOLD), [upper | {"base": "camera"}, label])
    same_frames(import_csv(tmp_path, fold, mapping).camera, fold.camera)
    parts = [upper, lower | {"frame": "lover"}]
    mapping = mapping_of(fold, object=str(FOLD), camera={**by_tree, "parts": parts})
    wrong = "camera.parts.1.frame: got 'lover'; allowed: one of camera, lower, upper (nearest: lower)"
    assert wrong in refused(tmp_path / "log.csv", mapping)


def transform(place: np.ndarray, turned: Rotation) -> dict[str, Any]:
    return {
        "translation": dict(zip("xyz", place.tolist(), strict=True)),
        "rotation": dict(zip("xyzw", turned.as_quat().tolist(), strict=True)),
    }


def stamp_of(time: float) -> dict[str, int]:
    whole = round((EPOCH + time) * 1e9)
    return {"sec": whole // 10**9, "nanosec": whole % 10**9}


def message(topic: str, kind: str, time: float, content: dict[str, Any]) -> tuple[str, str, int, bytes]:
    return topic, kind, round((EPOCH + time) * 1e9), json.dumps(content).encode()


def test_what_does_not_fit_is_refused(push: Trajectory, fold: Trajectory, tmp_path: Path):
    part, log = part_of(write_frames(tmp_path / "frames.csv", push)), write_csv(tmp_path / "push.csv", push)
    upright = (LABEL * Rotation.from_euler("x", 180, degrees=True)).as_quat(scalar_first=True).tolist()
    for mapping, error in (
        (mapping_of(push), "camera: got None; allowed: the poses of a pushed object"),
        (mapping_with(push, "L2", [part, part]), "camera.parts: got '2 tables'; allowed: one, of a rigid object"),
        (mapping_with(push, "L2", []), "camera.parts"),
        (mapping_with(push, "L2", [part], in_base_m=[0.3, -0.24, 0.9]), "from the fingertip that pushes it"),
        (mapping_with(push, "L2", [part | {"object_wxyz": upright}]), "from the base's"),
        (mapping_with(push, "L2", [part | {"object_wxyz": [1.0, 1.0, 0.0, 0.0]}]), "a unit quaternion"),
        (mapping_with(push, "L2", [part | {"position": ["x", "y"]}]), "x and y with orientation_as"),
        (mapping_with(push, "L2", [part | {"orientation_as": "yaw"}]), "1 column for yaw"),
        (mapping_with(push, "L2", [part], delay_s=-100.0), "camera.parts.0: no frame during the trial"),
        (mapping_of(push, object="L2", action=push.action.to_dict() | {"point": [0.0, 0.2]}), "a point of the outline"),
    ):
        assert error in refused(log, mapping)
    links = [part_of(write_frames(tmp_path / f"link_{i}.csv", fold, i)) for i in range(2)]
    log = write_csv(tmp_path / "fold.csv", fold)
    for mapping, error in (
        (mapping_of(fold, object=str(FOLD)), "camera: got None; allowed: the poses of 2 links"),
        (mapping_with(fold, str(FOLD), links[:1]), "allowed: 2, one per link"),
        (mapping_with(fold, str(FOLD), links[::-1]), "order of [[camera.parts]]"),
    ):
        assert error in refused(log, mapping)
