"""Logs of other robots come back as the trajectory behind them, whatever their units, frames and rates."""

import json
import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation, Slerp

from estimators.testing.recorded import load_block
from testbed import GRAVITY, HeftError, InvalidValueError, Rotate, Slide, load_object, preset, steady_windows
from testbed.frames import rotation_matrix
from testbed.importers.importer import import_trajectory
from testbed.importers.logs import LogError
from testbed.importers.mapping import Mapping
from testbed.sensing.compensation import compensate, tool_pulls
from testbed.trajectory import Phase, Trajectory, load_trajectory, save_trajectory
from tests.fakes.lab_bench import (
    EPOCH,
    at_other_rates,
    columns,
    import_csv,
    imported,
    mapping_of,
    phases_of,
    refused,
    tared_again,
    write_csv,
    write_joined_csv,
    write_messages,
    write_toml,
)
from tests.helpers.records import series_of
from tests.helpers.simulated import clean

POSITION, QUATERNION = ["px", "py", "pz"], ["qx", "qy", "qz", "qw"]
TURN = Rotate(2, duration=2.0, pivot=(-0.0333, 0.025), back=True)


@pytest.fixture(scope="module")
def turn() -> Trajectory:
    return compensate(clean("L2", TURN))


@pytest.fixture(scope="module")
def slide() -> Trajectory:
    return compensate(clean("L2", Slide(1, direction=0.4, duration=2.0)))


@pytest.fixture(scope="module")
def back(turn: Trajectory, tmp_path_factory: pytest.TempPathFactory) -> Trajectory:
    """The turn, written and imported."""
    return import_csv(tmp_path_factory.mktemp("log"), turn)


def windows_agree(found: Trajectory, original: Trajectory, part: float) -> None:
    """Steady wrenches agree within a part of the drag, 1 % of it in meters for torque."""
    ours, theirs = steady_windows(found), steady_windows(original)
    assert len(ours) == len(theirs)
    for a, b in zip(ours, theirs, strict=True):
        scale = part * np.linalg.norm(b.wrench[:2]) * np.array([1, 1, 1, 0.05, 0.05, 0.05])
        assert (np.abs(a.wrench - b.wrench) < np.maximum(scale, part * np.abs(b.wrench[5]))).all()
        assert_allclose(a.twist, b.twist, atol=2e-3)
        assert_allclose(a.tcp_height, b.tcp_height, atol=1e-4)


def same_orientation(found: Trajectory, original: Trajectory) -> None:
    same = np.abs(np.sum(found.sensor_orientation * original.sensor_orientation, axis=1))
    assert_allclose(same, 1.0, atol=1e-9)


def test_every_column_comes_back(back: Trajectory, turn: Trajectory):
    assert back.action == turn.action
    within = {"time_s": 1e-9, "tcp_position": 1e-6, "sensor_wrench": 1e-3, "joint_position": 1e-6}
    for name, tolerance in within.items():
        assert_allclose(getattr(back, name), getattr(turn, name), atol=tolerance, err_msg=name)
    same_orientation(back, turn)
    held = turn.mask(Phase.STEADY)
    for name, tolerance in {"object_pose": 1e-3, "tcp_velocity": 5e-3, "object_velocity": 5e-3}.items():
        assert_allclose(getattr(back, name)[held], getattr(turn, name)[held], atol=tolerance, err_msg=name)
    off = back.wrench_on_object_world[held] - turn.wrench_on_object_world[held]
    assert (np.abs(off) < [5e-3, 5e-3, 5e-3, 5e-4, 5e-4, 5e-4]).all()


def test_provenance_names_the_source_and_is_saved(back: Trajectory, tmp_path: Path):
    source = {"runner": "import", "object": "L2", "log": "log.csv", "recorded": "2026-01-01T00:00:00.000+00:00"}
    assert source.items() <= back.provenance.items()
    assert back.figures["bias_before_fx_N"] == pytest.approx(0.0, abs=0.1)
    assert_allclose(back.sensor_drift_std, preset("ft300s").drift_std)
    assert "assumed, for want of a second tare: 0.005 N" in back.provenance["drift"]
    save_trajectory(back, tmp_path / "t.parquet")
    assert load_trajectory(tmp_path / "t.parquet").provenance == back.provenance


@pytest.mark.parametrize("kind", ["turn", "slide"])
def test_phases_are_found_from_the_motion(
    kind: str, turn: Trajectory, slide: Trajectory, back: Trajectory, tmp_path: Path
):
    original, found = (turn, back) if kind == "turn" else (slide, import_csv(tmp_path, slide))
    for segment in range(original.segment.max() + 1):
        mine, theirs = (np.flatnonzero(t.segment == segment) for t in (found, original))
        # The hand overshoots as the object breaks loose: its speed is constant a fifth of a second late
        assert -10 <= mine[0] - theirs[0] <= 20
        assert abs(mine[-1] - theirs[-1]) <= 10
    tare = np.flatnonzero(found.phase == Phase.TARE)
    assert set(original.phase[tare]) == {Phase.TARE}
    assert len(tare) > 25
    windows_agree(found, original, 0.03)  # the drag still settles when a stretch begins


def test_a_second_tare_is_found_and_its_drift_judged(turn: Trajectory, tmp_path: Path):
    again = import_csv(tmp_path, tared_again(turn, 0.5))
    assert again.phase[-1] == Phase.TARE
    assert again.figures["drift_N"] == pytest.approx(0.5, abs=0.1)
    seconds = again.time_s[-1] - 0.5  # between the ends of the two tares
    assert_allclose(again.sensor_drift_std[:3], again.figures["drift_N"] / np.sqrt(3 * seconds), rtol=0.05)
    assert again.status == "fault"
    assert "drift" in again.reason


def test_phases_can_be_given(tmp_path: Path):
    original = load_block("L2-own_weight").clean[0]
    given = import_csv(tmp_path, original, mapping_of(original, phases=phases_of(original)))
    assert np.array_equal(given.segment, original.segment)
    windows_agree(given, original, 0.05)
    with pytest.raises(LogError, match=r"\[\[phases\]\]"):
        import_csv(tmp_path, original)


def test_a_stretch_of_a_log_is_zeroed_where_the_log_begins(tmp_path: Path):
    """2 s at a tilted pose, in which the sensor was zeroed, 1 s to the trial's first pose, and the trial."""
    original, resting, away = load_block("L2-own_weight").clean[3], 200, 300
    assert original.tool is not None
    rows = np.concatenate([np.zeros(away, dtype=int), np.arange(len(original.time_s))])
    begun = {name: np.array(values) for name, values in series_of(original, rows).items()}
    first = Rotation.from_quat(original.sensor_orientation[0], scalar_first=True)
    home = Rotation.from_rotvec([0.3, 0.0, 0.0]) * first
    part = np.concatenate([np.zeros(resting), np.linspace(0, 1, away - resting)])
    turned = Slerp([0, 1], Rotation.concatenate([home, first]))(part)
    begun["sensor_orientation"][:away] = turned.as_quat(scalar_first=True)
    begun["tcp_velocity"][:away], begun["time_s"] = 0.0, np.arange(len(rows)) / 100
    upright = np.array([[0.0, 0.0, GRAVITY]])
    load = tool_pulls(original.tool, rotation_matrix(begun["sensor_orientation"]), upright)[:, 0]
    begun["sensor_wrench"][:away] = load[:away]
    begun["sensor_wrench"] += 1e-3 * np.random.default_rng(0).standard_normal((len(rows), 6)) - load[0]
    longer = replace(original, **begun)
    steady = [{**p, "from_s": p["from_s"] + 3.0, "to_s": p["to_s"] + 3.0} for p in phases_of(original)]
    mapping = mapping_of(original, phases=[p for p in steady if p["phase"] == "steady"])
    mapping["sensor"]["zeroed"] = True
    whole = import_csv(tmp_path, longer, mapping)
    stretch = import_csv(tmp_path, longer, mapping | {"logs": [{"file": "log.csv", "from_s": 3.0}]})
    for one, other in zip(steady_windows(whole), steady_windows(stretch), strict=True):
        assert_allclose(one.wrench, other.wrench, atol=0.02)
        assert_allclose(one.since_tare, other.since_tare, atol=0.03)


def test_mapped_stretches_have_the_speed_and_the_sense_of_the_action(turn: Trajectory, tmp_path: Path):
    path, given = write_csv(tmp_path / "log.csv", turn), phases_of(turn)
    for factor, error in ((-1.0, "the action turns or slides at"), (1.2, "correct the action's speed")):
        action = turn.action.to_dict() | {"speed": factor * turn.action.steady[0].speed}
        assert error in refused(path, mapping_of(turn, phases=given, action=action))


@pytest.mark.parametrize("mapped", [True, False])
def test_a_turn_about_another_axis_than_the_vertical_is_refused(turn: Trajectory, mapped: bool, tmp_path: Path):
    path = write_csv(tmp_path / "log.csv", turn)
    mapping = mapping_of(turn, phases=phases_of(turn) if mapped else None)
    error = refused(path, mapping | {"hand": mapping["hand"] | {"orientation": ["qy", "qz", "qx", "qw"]}})
    assert "about x, y and z; allowed: about z" in error


def test_a_base_with_another_axis_up_is_turned(slide: Trajectory, turn: Trajectory, back: Trajectory, tmp_path: Path):
    """y up, as motion capture has it: (x, y, z) of the base is (x, z, -y) of the log."""
    up = Rotation.from_rotvec([math.pi / 2, 0, 0])
    for trial, straight in ((turn, back), (slide, import_csv(tmp_path, slide, mapping_of(slide)))):
        logged, mapping = columns(trial), mapping_of(trial)
        position, quaternion = (np.column_stack([logged[n] for n in names]) for names in (POSITION, QUATERNION))
        more = dict(zip(POSITION, up.inv().apply(position).T, strict=True))
        more |= dict(zip(QUATERNION, (up.inv() * Rotation.from_quat(quaternion)).as_quat().T, strict=True))
        mapping["hand"]["base_wxyz"] = up.as_quat(scalar_first=True).tolist()
        windows_agree(import_csv(tmp_path, trial, mapping, **more), straight, 1e-6)


@pytest.mark.parametrize(("sensor_hz", "hand_hz"), [(62.5, 100.0), (1000.0, 500.0)])
def test_rates_are_brought_together(turn: Trajectory, tmp_path: Path, sensor_hz: float, hand_hz: float):
    path = write_joined_csv(tmp_path / "log.csv", *at_other_rates(turn, sensor_hz, hand_hz))
    found = imported(path, mapping_of(turn, time={"column": "stamp"}))
    assert_allclose(np.diff(found.time_s), 0.01, atol=1e-12)
    windows_agree(found, turn, 0.03)


def write_mcap(path: Path, sensor: pd.DataFrame, hand: pd.DataFrame, encoding: str = "json", **options: Any) -> Path:
    rows = []
    for topic, table in (("/ft", sensor), ("/arm", hand)):
        for row in table.to_dict("records"):
            fields: dict[str, Any] = {str(name): float(value) for name, value in row.items()}
            stamp = 1_767_225_600_000_000_000 + round(1e9 * fields.pop("stamp"))
            if topic == "/ft":
                force, torque = {a: fields[f"f{a}"] for a in "xyz"}, [fields[f"t{a}"] for a in "xyz"]
                fields = {"frame": "sensor", "wrench": {"force": force, "torque": torque}}
            rows.append((topic, topic, stamp, json.dumps(fields).encode()))
    return write_messages(path, sorted(rows, key=lambda row: row[2]), encoding, **options)


def of_mcap(turn: Trajectory) -> dict[str, Any]:
    asked = mapping_of(turn, time={"column": "log_time"})
    asked["sensor"] |= {
        "topic": "/ft",
        "force": [f"wrench.force.{a}" for a in "xyz"],
        "torque": [f"wrench.torque.{i}" for i in range(3)],
    }
    asked["hand"] |= {"topic": "/arm"}
    asked["joints"] |= {"topic": "/arm"}
    return asked


def test_an_mcap_comes_back_and_its_errors_name_the_nearest(turn: Trajectory, tmp_path: Path):
    sensor, hand = at_other_rates(turn, 100.0, 40.0)
    path, mapping = write_mcap(tmp_path / "log.mcap", sensor, hand), of_mcap(turn)
    windows_agree(imported(path, mapping), turn, 0.03)
    for change, error in (
        ({"topic": "/fts"}, "log.mcap: sensor.force, sensor.torque.topic: got '/fts'; allowed: one of /arm, /ft"),
        ({"force": ["wrench.forces.x", "wrench.force.y", "wrench.force.z"]}, "(nearest: wrench.force.x)"),
    ):
        assert error in refused(path, mapping | {"sensor": mapping["sensor"] | change})
    cdr = write_mcap(tmp_path / "ros.mcap", sensor, hand, encoding="cdr")
    assert "not a ROS 2 bag as a whole" in refused(cdr, mapping)
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(path.read_bytes()[:2000])
    assert "cut.mcap: " in refused(cut, mapping)


WRONG: tuple[tuple[Any, ...], ...] = (
    (
        {"sensor": {"force": ["Fx", "fy", "fz"]}},
        "sensor.force, sensor.torque: got 'Fx'; allowed: one of stamp, fx",
        "(nearest: fx)",
    ),
    ({"time": {"column": "time"}}, "time.column: got 'time'"),
    ({"sensor": {"force_unit": "n"}}, "sensor.force_unit: got 'n'; allowed: a unit of force: N, mN"),
    ({"sensor": {"torque_unit": "Nm"}}, "(nearest: N m)"),
    ({"sensor": {"torque_unit": "N*mm"}}, "(nearest: N mm)"),
    ({"hand": {"position_unit": "inch"}}, "a unit of length: m, cm, mm"),
    ({"sensor": {"sign": 0}}, "sensor.sign: got 0"),
    ({"sensor": {"tipoc": "/ft"}}, "sensor.tipoc: no such field; got '/ft' (nearest: topic)"),
    ({"sensor": {"topic": "/ft"}}, "topic: got '/ft'; allowed: none"),
    ({"hand": {"orientation_as": "roll_pitch_yaw"}}, "3 columns for roll_pitch_yaw"),
    (
        {"hand": {"position": ["px", "py"], "orientation": ["qz"], "orientation_as": "yaw"}},
        "a hand's yaw alone does not determine its tilt",
    ),
    ({"sensor": {"in_hand_wxyz": [1.0, 1.0, 0.0, 0.0]}}, "a unit quaternion"),
    ({"sensor": {"zeroed": "yes"}}, "sensor.zeroed: got 'yes'; allowed: a valid boolean"),
    ({"hand": {"closing_deg": "90"}}, "hand.closing_deg: got '90'; allowed: a valid number"),
    ({"setup": {"preset": "labb"}}, "setup.preset: got 'labb'; allowed: one of ideal, lab, rough (nearest: lab)"),
    ({"setup": {"grasp_offset": 0.7}}, "setup.grasp_offset: got 0.7; allowed: 0 to 0.1 m"),
    ({"action": {"kind": "weigh"}}, "action.kind: got 'weigh'; allowed: one of accelerate, push, rotate, slide"),
    ({"action": {"kind": "rotate", "grasp": 0, "speed": 0}}, "map.toml: action.speed: got 0"),
    ({"action": {"kind": "rotate", "grasp": 0, "pivot": [0, 11]}}, "action.pivot: got [0, 11]; allowed: within 10 m"),
    ({"action": {"kind": "rotate"}}, "fields grasp"),
    ({"action": {"kind": "rotate", "grasp": 99}}, "action.grasp: got 99; allowed: 0 ("),
    ({"action": {"kind": "rotate", "grasp": "A22"}}, "action.grasp: got 'A22'; allowed: 0 (", "(nearest: A2)"),
    ({"action": {"kind": "rotate", "grasp": 2, "speed": 0.4}}, "phases: "),
    ({"action": {"kind": "rotate", "grasp": 2, "speed": -0.1745, "duration": 2.0, "back": True}}, "phases: "),
    ({"object": "L3"}, "object: got 'L3'"),
    ({"phases": [{"phase": "steady", "from_s": 1.0, "to_s": 2.0}]}, 'one or more "tare"'),
    ({"phases": [{"phase": "tare", "from_s": 1.0, "to_s": 0.5}]}, "to_s: got 0.5"),
    ({"phases": [{"phase": "tear", "from_s": 0.0, "to_s": 0.5}]}, "phases.0.phase: got 'tear'"),
    ({"separator": ",", "decimal": ","}, "separator: got ','; allowed: another character"),
    ({"separator": "[,"}, "separator: got '[,'; allowed: a character, or a pattern ("),
    ({"longest_gap_s": 0.005}, "log: a sample every 0.01 s; allowed: 0.005 s"),
)
"""Changes of a mapping, fields of a table or the whole table, each with parts of its error."""


def test_a_wrong_mapping_is_refused(turn: Trajectory, tmp_path: Path):
    path = write_csv(tmp_path / "log.csv", turn)
    for change, *errors in WRONG:
        mapping = mapping_of(turn)
        for table, fields in change.items():
            mapping[table] = mapping[table] | fields if table in ("sensor", "hand", "time") else fields
        said = refused(path, mapping)
        assert all(error in said for error in errors), said


def test_a_wrong_log_is_refused(turn: Trajectory, tmp_path: Path):
    mapping = mapping_of(turn)
    path = write_csv(tmp_path / "log.csv", turn)
    table = pd.read_csv(path, dtype=str)
    for column, row, cell, error in (
        ("fy", 7, "high", "line 9: fy: got 'high'"),
        ("fy", 7, "", "line 9: fy is blank"),
        ("stamp", 7, "", "line 9: stamp is blank"),
        ("tz", 3, "inf", "line 5: tz is blank"),
        ("stamp", 7, "0", "time goes back by"),
        ("qw", 9, "0.9", "hand.orientation: length"),
    ):
        wrong = table.copy()
        wrong.loc[row, column] = cell
        wrong.to_csv(tmp_path / "wrong.csv", index=False)
        assert error in refused(tmp_path / "wrong.csv", mapping)
    pd.concat([table[:300], table[340:]]).to_csv(tmp_path / "gone.csv", index=False)
    table[:50].to_csv(tmp_path / "short.csv", index=False)
    for name in ("empty.csv", "log.xls"):
        (tmp_path / name).write_text("")
    for name, error in (
        ("gone.csv", "silent for 0.41 s at 2.99 s; allowed: 0.1 s"),
        ("short.csv", "0.49 s in common; allowed: 0.5 s or more"),
        ("empty.csv", "empty.csv: cannot be read"),
        ("log.xls", ".csv, .tsv, .txt, .parquet, .h5, .hdf5, .db3, .mcap"),
        ("none.csv", "an existing file (.csv"),
    ):
        assert error in refused(tmp_path / name, mapping)
    late = replace(turn, **series_of(turn, ~turn.mask(Phase.TARE)))
    assert "phases: no tare" in refused(write_csv(tmp_path / "log.csv", late), mapping)


def test_columns_that_measure_nothing_and_clocks_that_stand_are_refused(turn: Trajectory, tmp_path: Path):
    path, mapping = write_csv(tmp_path / "log.csv", turn), mapping_of(turn)
    table = pd.read_csv(path)
    held, coarse = np.flatnonzero(turn.segment == 0), table["tz"].round(3)  # of the size of its noise
    hand = [name for name in columns(turn) if name[0] in "pq"]
    for changes, *errors in (
        ({"fy": table["fy"].iloc[0]}, "sensor: fy is "),
        ({"tz": table["tz"].mask(table.index > held[50]).ffill()}, "s, in motion; allowed: 0.5 s: it was stuck"),
        ({"tz": coarse.mask(table.index > held[50]).ffill()}, "s, in motion; allowed: 0.5 s: it was stuck, or clipped"),
        (
            {"stamp": 1e3 * table["stamp"]},
            "a sample every 10 s; allowed: 0.1 s (longest_gap_s)",
            "is time.unit another",
        ),
        ({name: 1e3 * table[name] for name in hand[:3]}, "is position_unit another?"),
        ({name: table[name].iloc[0] for name in hand}, "the log has none: it does not turn, at most"),
        ({"stamp": table["stamp"].iloc[0]}, "samples have the time 1.76723e+09 s; allowed: a clock that runs"),
        (
            {"stamp": table["stamp"] // 20 * 20},
            "samples have the time of the one before and other values; allowed: 5 %",
        ),
    ):
        table.assign(**changes).to_csv(tmp_path / "wrong.csv", index=False)
        said = refused(tmp_path / "wrong.csv", mapping)
        assert all(error in said for error in errors), said
    table[:1].to_csv(tmp_path / "wrong.csv", index=False)
    assert "got 1 samples at different times" in refused(tmp_path / "wrong.csv", mapping)
    header, rest = path.read_text().split("\n", 1)
    (tmp_path / "wrong.csv").write_text(header.replace("fy", "fx") + "\n" + rest)
    assert "fx: 2 columns have this name; allowed: one" in refused(tmp_path / "wrong.csv", mapping)
    coarse = table.assign(**{name: table[name].round(1) for name in ("fx", "fy", "fz")})  # a sensor of few counts
    coarse.to_csv(path, index=False)
    assert imported(path, mapping).ok


def test_times_may_be_dates(turn: Trajectory, back: Trajectory, tmp_path: Path):
    stamps = pd.to_datetime(EPOCH * 10**9 + np.round(turn.time_s * 1e9).astype(np.int64) + 123, unit="ns", utc=True)
    dates = [f"{stamp.tz_localize(None).isoformat()}+02:00" for stamp in stamps + pd.Timedelta("2h")]
    mapping = mapping_of(turn, time={"column": "date", "unit": "iso"})
    again = import_csv(tmp_path, turn, mapping, date=dates)
    assert_allclose(again.sensor_wrench, back.sensor_wrench, atol=1e-4)
    assert again.provenance["recorded"] == "2026-01-01T00:00:00.000+00:00"
    table = pd.read_csv(tmp_path / "log.csv", dtype=str).assign(date=["soon", *dates[1:]])
    table.to_csv(tmp_path / "log.csv", index=False)
    assert "line 2: date: got 'soon'; allowed: a date by ISO 8601" in refused(tmp_path / "log.csv", mapping)


def test_wrenches_come_by_the_axes_of_the_base_too(turn: Trajectory, back: Trajectory, tmp_path: Path):
    logged, sensor = columns(turn), Rotation.from_quat(turn.sensor_orientation, scalar_first=True)
    parts = {a: sensor.apply(np.column_stack([logged[f"{a}{b}"] for b in "xyz"])) for a in "ft"}
    more = {f"{a}{b}": part[:, i] for a, part in parts.items() for i, b in enumerate("xyz")}
    mapping = mapping_of(turn)
    mapping["sensor"] |= {"axes": "base"}
    assert_allclose(import_csv(tmp_path, turn, mapping, **more).sensor_wrench, back.sensor_wrench, atol=1e-6)
    late = {name: np.concatenate([np.repeat(values[0], 10), values[:-10]]) for name, values in more.items()}
    mapping["sensor"] |= {"delay_s": 0.1}  # it is taken off before the wrench is turned
    found = import_csv(tmp_path, turn, mapping, **late)
    assert_allclose(found.sensor_wrench, back.sensor_wrench[: len(found.time_s)], atol=1e-5)


def test_a_suffix_in_capitals_is_that_of_a_log(turn: Trajectory, back: Trajectory, tmp_path: Path):
    log, mapping = write_csv(tmp_path / "LOG.CSV", turn), mapping_of(turn)
    pd.read_csv(log).to_parquet(tmp_path / "LOG.PARQUET")
    for path in (log, tmp_path / "LOG.PARQUET"):
        assert_allclose(imported(path, mapping).sensor_wrench, back.sensor_wrench, atol=1e-9)
    sent = write_mcap(tmp_path / "LOG.MCAP", *at_other_rates(turn, 100.0, 40.0))
    assert imported(sent, of_mcap(turn)).ok


def test_a_wrong_speed_is_told_with_the_one_that_was_seen(turn: Trajectory, tmp_path: Path):
    asked = mapping_of(turn, action=turn.action.to_dict() | {"speed": 0.4})
    error = refused(write_csv(tmp_path / "log.csv", turn), asked)
    assert "steady stretches of +0.4 rad/s (+22.9 deg/s) for 2.0 s, -0.4 rad/s" in error
    seen = re.findall(r"([+-][\d.]+) rad/s \([^)]*\) for ([\d.]+) s", error.split("the log has")[1])
    assert_allclose(np.array(seen, dtype=float), [[0.1745, 2.0], [-0.1745, 2.0]], rtol=0.05, atol=0.2)


def test_a_damaged_mcap_is_refused_wherever_it_is_hit(turn: Trajectory, tmp_path: Path):
    plain = pytest.importorskip("mcap.writer").CompressionType.NONE
    path = write_mcap(tmp_path / "log.mcap", *at_other_rates(turn, 100.0, 40.0), compression=plain)
    mapping = of_mcap(turn)
    content = path.read_bytes()
    at = [found.start() for found in re.finditer(rb'"force": \{"x": -?\d', content)]
    for begin in at[:: len(at) // 5]:
        digit = content.index(b".", begin) - 1
        path.write_bytes(content[:digit] + bytes([content[digit] ^ 1]) + content[digit + 1 :])
        assert "crc validation failed" in refused(path, mapping)


def test_blank_rows_and_repeated_stamps_do_no_harm(turn: Trajectory, tmp_path: Path):
    path = write_csv(tmp_path / "log.csv", turn)
    lines = path.read_text().splitlines()
    lines.insert(50, "")
    lines.insert(80, lines[79])
    path.write_text("\n".join(lines) + "\n")
    assert_allclose(imported(path, mapping_of(turn)).sensor_wrench, turn.sensor_wrench, atol=1e-3)


def test_orientations_come_as_vectors_or_angles_too(turn: Trajectory, tmp_path: Path):
    logged = columns(turn)
    hand = Rotation.from_quat(np.column_stack([logged[name] for name in QUATERNION]))
    vectors, angles = hand.as_rotvec(degrees=True), hand.as_euler("xyz", degrees=True)
    more = {f"{n}{i}": v[:, i] for n, v in (("v", vectors), ("e", angles)) for i in range(3)}
    for kind, letter in (("rotation_vector", "v"), ("roll_pitch_yaw", "e")):
        mapping = mapping_of(turn)
        names = [f"{letter}{i}" for i in range(3)]
        mapping["hand"] |= {"orientation": names, "orientation_as": kind, "angle_unit": "deg"}
        same_orientation(import_csv(tmp_path, turn, mapping, **more), turn)


def test_a_grasp_has_a_number_or_a_name(back: Trajectory, turn: Trajectory, tmp_path: Path):
    name = load_object("L2").shape.grasps[TURN.grasp].name
    again = import_csv(tmp_path, turn, mapping_of(turn, action=turn.action.to_dict() | {"grasp": name}))
    assert again.action == turn.action
    assert_allclose(again.object_pose, back.object_pose, atol=1e-12)


def test_a_logged_velocity_is_used(turn: Trajectory, tmp_path: Path):
    names = {f"v{i}": (1e3 if i < 3 else 180 / np.pi) * turn.tcp_velocity[:, i] for i in range(6)}
    velocity = {"linear": ["v0", "v1", "v2"], "linear_unit": "mm/s"}
    velocity |= {"angular": ["v3", "v4", "v5"], "angular_unit": "deg/s"}
    again = import_csv(tmp_path, turn, mapping_of(turn, velocity=velocity, joints=None), **names)
    assert_allclose(again.tcp_velocity, turn.tcp_velocity, atol=1e-5)
    assert again.provenance["velocity"] == "as logged"
    assert again.provenance["joints"] == "not logged: zeros"
    assert not again.joint_position.any()


def test_all_errors_come_at_once(turn: Trajectory, tmp_path: Path):
    asked = mapping_of(turn)
    asked |= {"object": "L3", "time": asked["time"] | {"column": "time"}}
    asked["sensor"] |= {"force": ["Fx", "Fy", "fz"]}
    asked["hand"] |= {"position": ["px", "py", "pzz"]}
    path = write_csv(tmp_path / "log.csv", turn)
    lines = refused(path, asked).splitlines()
    for error in ("object: got 'L3'", "time.column: got 'time'", "got 'Fx'", "got 'Fy'", "got 'pzz'"):
        assert sum(error in line for line in lines) == 1, error
    assert len(lines) == 5


def test_one_file_serves_logs_of_several_actions(turn: Trajectory, slide: Trajectory, tmp_path: Path):
    (tmp_path / "logs").mkdir()
    first, second = (write_csv(tmp_path / "logs" / f"{i}.csv", t) for i, t in enumerate((turn, slide)))
    entries = [{"file": "logs/0.csv"}, {"file": "logs/1.csv", "action": slide.action.to_dict()}]
    mapping = write_toml(tmp_path / "map.toml", mapping_of(turn, logs=entries))
    assert import_trajectory(first, mapping).action == turn.action
    assert import_trajectory(second, mapping).action == slide.action
    none = write_toml(tmp_path / "none.toml", mapping_of(turn, action=None, logs=entries))
    assert import_trajectory(second, none).action == slide.action
    twice = write_toml(tmp_path / "twice.toml", mapping_of(turn, logs=[entries[0], *entries]))
    with pytest.raises(InvalidValueError, match=r"logs\.file: got 'logs/0.csv'; allowed: each stretch"):
        import_trajectory(first, twice)
    for one, other in (({}, {"px": 1.0}), ({"px": 1.0, "py": 2.0}, {"py": 2.0, "px": 1.0})):
        parts = [entries[0] | {"where": where} for where in (one, other)]
        found = Mapping.model_validate(mapping_of(turn, logs=parts))
        if one != other:
            assert len(found.entries(first, tmp_path)) == 2
        else:
            with pytest.raises(InvalidValueError, match=r"logs\.file: got 'logs/0.csv, py 2, px 1'"):
                found.entries(first, tmp_path)
    with pytest.raises(InvalidValueError, match="action: got None"):
        import_trajectory(first, none)
    bad = write_toml(tmp_path / "bad.toml", mapping_of(turn, logs=[{"file": "a", "action": {"kind": "weigh"}}]))
    with pytest.raises(HeftError, match=r"bad\.toml: logs\.0\.action\.kind: got 'weigh'"):
        import_trajectory(first, bad)


def test_an_object_beside_the_mapping_is_found(turn: Trajectory, tmp_path: Path):
    (tmp_path / "mine.toml").write_text(
        'name = "mine"\n[blocks]\nlayout = ["1", "1", "1", "111"]\nmass_kg = 0.3\n', encoding="utf-8"
    )
    assert import_csv(tmp_path, turn, mapping_of(turn, object="mine.toml")).provenance["object"] == "mine"
