"""Logs with values that look like data and are none, and tables in the ways that people save them."""

import gzip
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose

from estimators.testing.recorded import load_block
from testbed import HeftError, Phase, Trajectory, steady_windows
from testbed.importers.columns import HandMap, TimeMap
from testbed.importers.logs import LogError, Series
from testbed.importers.messages import JOINT_STATE, Message, MessageLog
from testbed.importers.phases import MOST_LEFT_OUT, without_faults
from testbed.importers.poses import hand_pose
from testbed.robot.calibration.recorded_poses import recorded_poses
from testbed.robot.calibration.static_poses import CalibrationError, StaticPose, calibrate
from tests.fakes.lab_bench import imported, mapping_of, write_csv
from tests.fakes.static_hand import POSES, off, recorded

TURN = load_block("L2-own_weight").trials("ft300s", 0)[-1]
WRENCH = ["fx", "fy", "fz", "tx", "ty", "tz"]


def logged(folder: Path, **changes: object) -> tuple[Path, dict[str, object], pd.DataFrame]:
    """The turn's table as CSV, its mapping and its values."""
    path = write_csv(folder / "log.csv", TURN)
    return path, mapping_of(TURN, joints=None, **changes), pd.read_csv(path)


@pytest.fixture(scope="module")
def usual(tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """The turn, written and imported."""
    path, mapping, _ = logged(tmp_path_factory.mktemp("usual"))
    return imported(path, mapping)


def agree(found: Trajectory, within: float = 0.02) -> None:
    for mine, theirs in zip(steady_windows(found), steady_windows(TURN), strict=True):
        assert_allclose((mine.wrench - theirs.wrench)[:3], 0, atol=within)
        assert_allclose((mine.wrench - theirs.wrench)[3:], 0, atol=within / 10)


def test_lost_frames_and_spikes_are_left_out_and_named(usual: Trajectory, tmp_path: Path):
    path, mapping, table = logged(tmp_path)
    rng, count = np.random.default_rng(0), len(table)
    lost = rng.choice(count, count // 50, replace=False)
    table.loc[lost, WRENCH] = 0.0
    struck = np.setdiff1d(np.arange(600, 900, 60), lost)
    table.loc[struck, "fx"] += 8.0  # 80 N
    table.to_csv(path, index=False)
    found = imported(path, mapping)
    said = found.provenance["left out"]
    assert f"{len(lost)} samples of six zeros; {len(struck)} spikes of fx at 6.00, " in said
    agree(found)
    assert "left out" not in usual.provenance


def test_more_than_some_lost_frames_or_zeros_alone_are_refused():
    time, values = np.arange(100) / 100, np.ones((100, 6))
    values[: round(100 * MOST_LEFT_OUT) + 1] = 0.0
    with pytest.raises(LogError, match="21 of 100 samples are zeros or spikes; allowed: 20 %"):
        without_faults(Series(time, values))
    with pytest.raises(LogError, match="all 100 samples are zeros"):
        without_faults(Series(time, 0 * values))


def test_an_impact_is_no_spike():
    rng = np.random.default_rng(1)
    values = rng.normal(0, 0.05, (200, 6))
    values[100:] += 30.0 * np.exp(-np.arange(100) / 3)[:, None] + 2.0
    series, said = without_faults(Series(np.arange(200) / 100, values))
    assert said == "" and len(series.time_s) == 200


def test_a_torque_about_the_tcp_is_moved_to_the_sensor(tmp_path: Path):
    """Torque about the TCP, N mm, as a UR reports it; forces in kgf."""
    path, mapping, table = logged(tmp_path)
    assert TURN.tool is not None
    force, torque = 9.80665 * table[WRENCH[:3]].to_numpy(), 1e-3 * table[WRENCH[3:]].to_numpy()
    table[WRENCH[3:]] = 1e3 * (torque - np.cross(TURN.tool.tcp, force))
    table.to_csv(path, index=False)
    sensor = mapping["sensor"]
    assert isinstance(sensor, dict)
    agree(imported(path, mapping | {"sensor": sensor | {"torque_about": "tcp"}}))
    with pytest.raises(AssertionError):
        agree(imported(path, mapping))


def test_joints_that_wrap_at_a_turn_are_unwrapped(tmp_path: Path):
    path, _, table = logged(tmp_path)
    names = [f"j{i}" for i in range(1, 8)]
    for i, name in enumerate(names):
        table[name] = (350.0 + 0.06 * (i + 1) * np.arange(len(table))) % 360
    table.iloc[::2].assign(stamp=table["stamp"].iloc[::2] + 3.0).to_csv(path, index=False)
    found = imported(path, mapping_of(TURN, joints={"position": names, "unit": "deg"}))
    assert np.abs(np.diff(np.degrees(found.joint_position), axis=0)).max() < 0.5


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    ("coding", "end", "decimal", "separator"),
    [
        *((coding, "\r\n", ",", "\t") for coding in ("utf-8-sig", "utf-16", "utf-8")),
        ("utf-8", "\n# a mark\n", ",", "\t"),
        *(("utf-8", end, ".", separator) for end, separator in (("\r", "\t"), ("\n", r"\s+"), ("\n", "[\t;]"))),
    ],
)
def test_tables_are_read_as_people_save_them(
    coding: str, end: str, decimal: str, separator: str, usual: Trajectory, tmp_path: Path
):
    path, mapping, table = logged(tmp_path)
    path.write_bytes(table.to_csv(index=False, sep="\t", decimal=decimal, lineterminator=end).encode(coding))
    found = imported(path, mapping | {"separator": separator, "decimal": decimal})
    assert_allclose(found.sensor_wrench, usual.sensor_wrench, atol=1e-12)
    with pytest.raises(HeftError, match=r'has no separator ","; allowed: .* separator = "\\t"'):
        imported(path, mapping)


def test_a_table_without_names_has_numbered_columns(tmp_path: Path):
    path, mapping, table = logged(tmp_path)
    table.to_csv(path, index=False, header=False)
    with pytest.raises(HeftError, match=r"no header: line 1 holds numbers alone; allowed: .*header = false"):
        imported(path, mapping)
    number = {name: str(index) for index, name in enumerate(table, 1)}

    def numbered(value: object) -> object:
        if isinstance(value, dict):
            return {key: numbered(each) for key, each in value.items()}
        if isinstance(value, list):
            return [numbered(each) for each in value]
        return number.get(value, value) if isinstance(value, str) else value

    agree(imported(path, {k: numbered(v) for k, v in mapping.items()} | {"header": False}))


def test_what_cannot_be_read_says_why(tmp_path: Path):
    path, mapping, table = logged(tmp_path)
    path.write_bytes(table.rename(columns={"qw": "W\u00e4rme"}).to_csv(index=False).encode("latin-1"))
    with pytest.raises(HeftError, match=r"line 1: byte 0xe4 is not UTF-8; save the table as UTF-8"):
        imported(path, mapping)
    names, *rows = table.to_csv(index=False).splitlines()
    for text, said in (
        (
            ["Recorded by a logger v2.1", names, *rows],
            r"line 2: \d+ columns, after 1; allowed: .*a line above the names",
        ),
        ([names, "s" + ",N" * names.count(","), *rows], r"line 2: \w+: got '[sN]'; .*a line of units below the names"),
        (["# a", names, *rows[:9], rows[9] + ",1"], r"line 12: \d+ columns, after \d+"),
        ([names], "got 0 samples at different times"),
        ([names.replace(",", ";"), rows[0].replace(",", ";").replace(".", ",")], r'decimal commas, decimal = ","'),
    ):
        path.write_text("\n".join(text) + "\n", encoding="utf-8")
        more = {"separator": ";"} if ";" in text[-1] else {"comment": "#"} if text[0] == "# a" else {}
        with pytest.raises(HeftError, match=said):
            imported(path, mapping | more)
    path.write_text("\n".join(["# " + names, *rows]) + "\n", encoding="utf-8")
    with pytest.raises(HeftError, match=r"line 2 holds numbers alone; .*line 1 has names, but begins with comment"):
        imported(path, mapping | {"comment": "#"})
    path.write_bytes(gzip.compress(path.read_bytes()))
    with pytest.raises(HeftError, match="compressed by gzip; allowed: text: unpack it"):
        imported(path, mapping)
    table.astype(str).to_parquet(path.with_suffix(".parquet"))
    with pytest.raises(HeftError, match="no column holds numbers; allowed"):
        imported(path.with_suffix(".parquet"), mapping)
    path.write_text("version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n", encoding="ascii")
    with pytest.raises(HeftError, match="git lfs pull"):
        imported(path, mapping)
    table.iloc[::10].to_csv(path, index=False)
    with pytest.raises(HeftError, match=r"a sample every 0\.1 s; allowed: 0\.05 s"):
        imported(path, mapping | {"longest_gap_s": 0.05})
    slow = table["stamp"].iloc[0] + 1.0002 * (table["stamp"] - table["stamp"].iloc[0])
    table.assign(stamp=slow).iloc[::10].to_csv(path, index=False)
    with pytest.raises(HeftError, match=r"silent for 0\.10002 s .* allowed: 0\.1 s"):
        imported(path, mapping | {"longest_gap_s": 0.1})
    table.iloc[::10].to_csv(path, index=False)
    assert imported(path, mapping | {"longest_gap_s": 0.1}).ok  # as long but for rounding


def changed(folder: Path, change) -> tuple[Path, Path]:
    """Poses of a static hand with a change of their table."""
    log, mapping = recorded(folder)
    table = pd.read_csv(log)
    change(table).to_csv(log, index=False)
    return log, mapping


def moved(parent: str, child: str, second: int) -> dict[str, object]:
    place, turn = dict.fromkeys("xyz", 0.001 * second), {"x": 0, "y": 0, "z": 0, "w": 1}
    header = {"stamp": {"sec": second, "nanosec": 0}, "frame_id": parent}
    return {"header": header, "child_frame_id": child, "transform": {"translation": place, "rotation": turn}}


APART = [*(moved("map", "base", s) for s in (0, 1)), *(moved("base", "tcp", s) for s in (10, 11))]


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ({"transforms": APART}, r"hand\.frame: tcp at 10.00 to 11.00 s, base at 0.00 to 1.00 s; allowed: frames whose"),
        ({"transform": APART}, r"hand\.topic /tf: got 'transforms'; allowed: one of "),
        ({"transforms": None}, r"hand\.topic /tf: got None; allowed: a list of transforms"),
        ({"transforms": [{"child": "tcp"}]}, r"hand\.topic /tf: got 'child_frame_id'; allowed: one of child"),
    ],
)
def test_a_tree_that_gives_no_pose_says_why(content: dict[str, object], said: str):
    log = MessageLog(
        Path("log.mcap"), {"/tf": "tf2_msgs/msg/TFMessage"}, lambda _: [Message(0, 0, json.dumps(content).encode())]
    )
    with pytest.raises(HeftError, match=rf"log\.mcap: {said}"):
        hand_pose(log, HandMap(topic="/tf", frame="tcp"), TimeMap(), Path(), 0.1)


def test_a_joint_state_without_names_says_so():
    log = MessageLog(Path("log.mcap"), {"/joints": JOINT_STATE}, lambda _: [Message(0, 0, b'{"position": [0.1]}')])
    with pytest.raises(HeftError, match="topic /joints: got 'name'; allowed: one of position"):
        log.messages("/joints")


def test_lost_frames_do_not_count_in_a_calibration(tmp_path: Path):
    def lose(table: pd.DataFrame) -> pd.DataFrame:
        rows = np.random.default_rng(0).random(len(table)) < 0.05
        table.loc[rows, WRENCH] = 0.0
        return table

    poses, said = recorded_poses(*changed(tmp_path, lose))
    assert "samples of six zeros" in said and len(poses) == len(POSES)
    assert np.abs(off(calibrate(poses))).max() < 4


def test_rests_that_are_interpolated_are_no_poses(tmp_path: Path):
    log, mapping = changed(tmp_path, lambda table: table.iloc[::400])
    text = mapping.read_text(encoding="utf-8")
    mapping.write_text("longest_gap_s = 60.0\n" + text, encoding="utf-8")
    with pytest.raises(LogError, match="a sample every 4 s; allowed: 5 or more measured in 1 s"):
        recorded_poses(log, mapping)


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> list[StaticPose]:
    return recorded_poses(*recorded(tmp_path_factory.mktemp("static")))[0]


def scaled(pose: StaticPose, force: float, torque: float) -> StaticPose:
    """The pose with its forces and torques in other units [N, N m]."""
    scale = np.repeat([force, torque], 3)
    return replace(pose, wrench=scale * pose.wrench, standard_error=scale * pose.standard_error)


FAR = r"\d+\.?\d* m from the sensor; allowed: 0\.5 m; .* \(torque_unit\)"


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda pose: scaled(pose, 1.0, 1e3), FAR),
        (lambda pose: scaled(pose, 1.0, 1e2), FAR),
        (
            lambda pose: scaled(pose, 1 / 9.80665, 1.0),
            r"m from the sensor; allowed: 0\.5 m; is the unit of the force kgf \(force_unit\)",
        ),
        (lambda pose: replace(pose, hand=np.roll(pose.hand, 1)), "quaternions in another order"),
        (lambda pose: replace(pose, hand=np.roll(pose.hand, -1)), "quaternions in another order"),
        (lambda pose: replace(pose, hand=pose.hand * [1, -1, -1, -1]), "their inverse: of the base in the hand"),
        (lambda pose: replace(pose, wrench=pose.wrench * [1, -1, 1, 1, 1, 1]), "axes of one handedness"),
    ],
)
def test_poses_in_other_units_orders_or_axes_are_named(change, words: str, poses: list[StaticPose]):
    with pytest.raises(CalibrationError, match=words):
        calibrate([change(pose) for pose in poses])


def test_a_stuck_component_is_named_in_a_calibration(tmp_path: Path):
    with pytest.raises(LogError, match=r"fy is 1\.25 in all samples"):
        recorded_poses(*changed(tmp_path, lambda table: table.assign(fy=1.25)))


def frozen(folder: Path, count: int) -> tuple[Path, pd.DataFrame, int]:
    """The turn's log with its pose as it was at a row amid its first way, in some rows after that; and that row."""
    log, _, table = logged(folder)
    at = int(np.flatnonzero(TURN.segment == 0)[40])
    pose = [name for name in table if str(name)[0] in "pq"]
    table.loc[at : at + count, pose] = table.loc[at, pose].to_numpy()
    return log, table, at


def test_a_pose_that_freezes_amid_a_turn_is_a_gap(tmp_path: Path):
    log, table, _ = frozen(tmp_path, 20)
    table.to_csv(log, index=False)
    with pytest.raises(LogError, match=r"silent for 0\.21 s at .*repeated ones"):
        imported(log, mapping_of(TURN))


def test_a_rest_ends_with_no_jump_where_a_quaternion_changes_its_sign(tmp_path: Path):
    """q and -q are one rotation: neither is a pose that stands while the hand moves on, nor a step of it."""
    log, mapping, table = logged(tmp_path)
    rest = np.flatnonzero(TURN.phase == Phase.SETTLE)
    pose = [name for name in table if str(name)[0] in "pq"]
    table.loc[rest, pose] = table.loc[rest[0], pose].to_numpy()
    for at in (int(rest[-1]) - 5, int(np.flatnonzero(TURN.segment == 0)[40])):
        table.loc[at:, ["qw", "qx", "qy", "qz"]] *= -1
    table.to_csv(log, index=False)
    agree(imported(log, mapping))
