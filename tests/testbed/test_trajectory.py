"""Trajectories and foot forces: checked, stored, read back, replayed."""

import dataclasses
import json
import pickle
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from scenarios.results.files import write_json
from testbed import Accelerate, Action, Rotate, SetupErrors, Slide, Weigh, draw_sensing, load_object, preset
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.files import UNSEALED, DamagedFileError, write_sealed, write_whole
from testbed.foot_forces import FootForces, load_foot_forces, save_foot_forces
from testbed.replay import Recording, ReplayRunner
from testbed.sensing.compensation import compensate
from testbed.trajectory import Phase, Tool, Trajectory, load_trajectory, save_trajectory
from testbed.trial import RIGID, Trial
from tests.helpers.records import TOOL, moving_hand, record

SERIES = [name for name, value in vars(record(3)).items() if isinstance(value, np.ndarray)]
"""Names of all arrays of a trajectory."""


@pytest.fixture
def full() -> Trajectory:
    """A record with odd numbers in every field."""
    rng = np.random.default_rng(3)
    noise = {name: rng.normal(size=getattr(record(50), name).shape) for name in SERIES}
    noise |= {"time_s": np.cumsum(rng.uniform(0.001, 0.02, 50)), "phase": rng.integers(0, 7, 50)}
    noise |= {"segment": rng.integers(-1, 3, 50)}
    turned = noise["sensor_orientation"]
    noise["sensor_orientation"] = turned / np.linalg.norm(turned, axis=1, keepdims=True)
    noise["sensor_wrench"][:3, 0] = [-0.0, 5e-324, -1.7976931348623157e308]
    return record(
        50,
        action=Rotate(2, -0.1, 3.0, (0.1, -0.0)),
        status="slipped",
        reason="moved 3 mm in the grip \N{GREEK SMALL LETTER MU}",
        figures={"slip_m": 0.003, "grip_N": 1 / 3},
        provenance={"runner": "by hand", "seed": "7"},
        setup=SetupErrors(contact_points=4, grasp_offset=0.0013),
        **noise,
    )


def same_bits(a: np.ndarray, b: np.ndarray) -> bool:
    return a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()


@pytest.mark.parametrize("action", [None, Weigh(), Rotate(0), Accelerate(1), Slide(2, 0.5)], ids=lambda a: str(a)[:8])
def test_a_trajectory_comes_back_bit_for_bit(action: Action | None, full: Trajectory, tmp_path: Path):
    given = full if action is None else replace(full, action=action, tool=None)
    save_trajectory(given, tmp_path / "t.parquet")
    back = load_trajectory(tmp_path / "t.parquet")
    for name in SERIES:
        assert same_bits(getattr(back, name), getattr(given, name)), name
    for name in ("action", "status", "reason", "setup", "figures", "provenance"):
        assert getattr(back, name) == getattr(given, name), name
    if given.tool is None:
        assert back.tool is None
        return
    assert back.tool is not None and back.tool.mass == TOOL.mass
    for name in ("com", "inertia", "tcp"):
        assert same_bits(getattr(back.tool, name), getattr(TOOL, name)), name


def test_a_file_is_plain_parquet_with_a_json_header(full: Trajectory, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    def refuse(*_: object, **__: object) -> None:
        raise AssertionError("pickled")

    for name in ("dump", "dumps", "load", "loads"):
        monkeypatch.setattr(pickle, name, refuse)
    save_trajectory(full, tmp_path / "t.parquet")
    assert load_trajectory(tmp_path / "t.parquet").status == "slipped"
    table = pq.read_table(tmp_path / "t.parquet")
    assert {str(kind) for kind in table.schema.types} == {"double", "int64"}
    assert json.loads(table.schema.metadata[b"heft"])["action"]["kind"] == "rotate"


def rewrite_header(path: Path, change: Callable[[dict[str, Any]], dict[str, Any]], without: str = "") -> None:
    """Change the header of a stored trajectory, and drop the columns that `without` names."""
    table = pq.read_table(path)
    header = change(json.loads(table.schema.metadata[b"heft"]))
    table = table.drop_columns([name for name in table.column_names if name in without])
    changed = table.replace_schema_metadata({"heft": json.dumps(header), "checksum": UNSEALED})
    write_sealed(path, lambda part: pq.write_table(changed, part))


@pytest.mark.parametrize("kept", [None, "text", 0, 0.3, 0.99])
def test_a_damaged_file_is_refused(full: Trajectory, tmp_path: Path, kept: float | str | None):
    path = tmp_path / "t.parquet"
    if isinstance(kept, str):
        path.write_text("time_s\n0.1\n")
    elif kept is not None:
        save_trajectory(full, path)
        path.write_bytes(path.read_bytes()[: int(kept * path.stat().st_size)])
    with pytest.raises(DamagedFileError, match=r"t\.parquet: not a whole trajectory file"):
        load_trajectory(path)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda header: header | {"schema_version": 99}, "schema 99; this version of heft reads 1"),
        (lambda header: header | {"action": {"kind": "shove"}}, "action.kind: got 'shove'"),
        (lambda header: header | {"action": {"kind": "rotate"}}, "allowed: fields grasp as well"),
        (lambda header: header | {"status": "fine"}, "Trajectory.status: got 'fine'; allowed: one of ok, slipped"),
        (lambda header: header | {"tool": header["tool"] | {"mass": None}}, "Tool.mass: got None; allowed: a finite"),
        (lambda header: {k: v for k, v in header.items() if k != "tool"}, "not a whole trajectory file: 'tool'"),
        (lambda header: header, "sensor_wrench.fz_N"),  # without this column
    ],
)
def test_a_header_of_another_kind_is_refused(full: Trajectory, tmp_path: Path, change, said: str):
    path = tmp_path / "t.parquet"
    save_trajectory(full, path)
    rewrite_header(path, change, without=said)
    with pytest.raises(DamagedFileError, match=re.escape(said)):
        load_trajectory(path)


def test_a_reader_of_the_old_file_keeps_it_while_a_new_one_is_written(tmp_path: Path):
    path = tmp_path / "t.txt"
    write_whole(path, lambda part: part.write_text("old"))
    with path.open() as reader:
        write_whole(path, lambda part: part.write_text("new"))
        assert reader.read() == "old"
    assert path.read_text() == "new"


@pytest.mark.parametrize("there", [[], ["t.parquet"]], ids=["nothing", "an old file"])
def test_a_writer_that_fails_leaves_what_was_there(there, full: Trajectory, tmp_path: Path, monkeypatch):
    for name in there:
        save_trajectory(full, tmp_path / name)
    before = {path: path.read_bytes() for path in tmp_path.iterdir()}

    def fail(table: object, part: Path, **_: object) -> None:
        part.write_bytes(b"PAR1")
        raise OSError("disk full")

    monkeypatch.setattr(pq, "write_table", fail)
    with pytest.raises(OSError, match="disk full"):
        save_trajectory(record(), tmp_path / "t.parquet")
    assert {path: path.read_bytes() for path in tmp_path.iterdir()} == before


def changed(name: str, index: int, value: object) -> np.ndarray:
    """A series of five samples with one entry changed."""
    values = np.array(getattr(record(5), name))
    values.flat[index] = value
    return values


UNCHECKED = ("phase", "segment")
FIXED = ("time_s", "sensor_bias_std", "sensor_drift_std")
SERIES_REFUSED: list[tuple[str, object]] = [
    *((name, changed(name, 2, bad)) for name in SERIES if name not in UNCHECKED for bad in (np.nan, np.inf)),
    *((name, getattr(record(4), name)) for name in SERIES if name not in FIXED),
    *(("time_s", bad) for bad in ([], [0.0, 0.0, 0.1, 0.2, 0.3], [0.1, 0.0, 0.2, 0.3, 0.4])),
    *(("phase", bad) for bad in ([0, 0, 1, 5, 7], [-1, 0, 1, 5, 9], [0.0, 0.0, 1.0, 5.0, 6.0], [True] * 5)),
    *(("segment", bad) for bad in ([-2, -1, 0, 0, 1], [0.5] * 5, np.full(5, 2**63, dtype=np.uint64))),
    *(("status", bad) for bad in ("fine", "OK", "", None)),
    *(("sensor_orientation", changed("sensor_orientation", 13, bad)) for bad in (0.0, 2.0, 0.9)),
]


SETUP = [field.name for field in dataclasses.fields(SetupErrors)]
TOOL_AT_REST = {"mass": 0.9, "com": np.zeros(3), "inertia": np.eye(3), "tcp": np.zeros(3)}
FEET = {"time_s": np.arange(4) / 10, "particle": np.array([0]), "force": np.zeros((4, 1, 3))}
REFUSED: list[tuple[Callable[..., object], dict[str, Any], str, object]] = [
    *((record, {"count": 5}, name, value) for name, value in SERIES_REFUSED),
    *((Tool, TOOL_AT_REST, "mass", bad) for bad in (-0.1, np.nan, np.inf, None, "0.9", True)),
    (Tool, TOOL_AT_REST, "com", np.array([0, 0, np.nan])),
    *((FootForces, FEET, "force", bad) for bad in (np.zeros((4, 2, 3)), np.full((4, 1, 3), np.nan))),
    *((SetupErrors, {}, name, bad) for name in SETUP for bad in (-1e-9, np.nan, np.inf, None, "0", True)),
]


@pytest.mark.parametrize(("make", "given", "name", "value"), REFUSED)
def test_a_value_out_of_range_is_refused(make, given: dict[str, Any], name: str, value: object):
    with pytest.raises(InvalidValueError) as refused:
        make(**given | {name: value})
    assert refused.value.field == f"{'Trajectory' if make is record else make.__name__}.{name}"


def test_a_trajectory_is_frozen_and_does_not_follow_the_arrays_it_was_made_from():
    given = {name: np.array(getattr(record(5), name)) for name in SERIES}
    made = record(5, **given)  # type: ignore[arg-type]
    with pytest.raises(dataclasses.FrozenInstanceError):
        made.status = "fault"  # type: ignore[misc]
    for name, values in given.items():
        before = getattr(made, name).copy()
        values[...] = 1
        assert np.array_equal(getattr(made, name), before), name
        with pytest.raises(ValueError, match="read-only"):
            getattr(made, name)[0] = 0


def test_properties_of_a_trajectory_and_of_its_setup():
    made = record(6, phase=[0, 0, 1, 4, 5, 6])
    assert made.mask(Phase.TARE, Phase.STEADY).tolist() == [True, True, False, False, True, False]
    assert [record(3, status=s).ok for s in ("ok", "slipped", "limit", "fault")] == [True, False, False, False]
    assert SetupErrors().none and not any(SetupErrors(**{name: 1e-3}).none for name in SETUP)


def test_foot_forces_come_back_and_a_cut_file_is_refused(tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "feet.parquet"
    feet = FootForces(np.arange(4) / 10, np.array([5, 1, 7]), rng.normal(size=(4, 3, 3)))
    save_foot_forces(feet, path)
    back = load_foot_forces(path)
    np.testing.assert_array_equal(back.time_s, feet.time_s)
    np.testing.assert_array_equal(back.particle, feet.particle)
    np.testing.assert_allclose(back.force, feet.force, rtol=1e-6)
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(DamagedFileError, match=r"feet\.parquet"):
        load_foot_forces(path)


L2, F2 = load_object("L2"), load_object("F2")
TURN = Rotate(1, duration=3.0, back=True)


def taken(name: str = "L2", action: Action = TURN, mark: float = 0.0, **provenance: str) -> Trajectory:
    """Record of a bench, with a mark as its first reading."""
    wrench = np.zeros((400, 6))
    wrench[0, 0] = mark
    named = {"object": name} if name else {}
    return record(action=action, sensor_wrench=wrench, provenance={"runner": "robot"} | named | provenance)


def mark_of(trajectory: Trajectory) -> float:
    return float(trajectory.sensor_wrench[0, 0])


def put(root: Path, key: str, trajectory: Trajectory, content: dict[str, object] | None) -> None:
    """Store a trial in a results folder; one that did not finish has no content."""
    save_trajectory(trajectory, root / "trials" / key / "trajectory.parquet")
    if content is not None:
        write_json(root / "trials" / key / "trial.json", content)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    back = replace(TURN, speed=-TURN.speed)
    records = [("L2", TURN), ("F2", TURN), ("L2", Slide(1, 0.4)), ("L2", TURN), ("L2", back)]
    for i, (name, action) in enumerate(records, 1):
        save_trajectory(taken(name, action, float(i)), tmp_path / f"{i}.parquet")
    return tmp_path


def test_a_trial_gets_its_own_record(folder: Path):
    with ReplayRunner(folder) as runner:
        assert mark_of(runner.run(Trial(F2, TURN))) == 2.0
        assert mark_of(runner.run(Trial(L2, Slide(1, 0.4 + 1e-9)))) == 3.0
        assert mark_of(runner.run(Trial(L2, replace(TURN, speed=-TURN.speed)))) == 5.0


def test_repeats_come_in_order_and_come_to_an_end(folder: Path):
    runner = ReplayRunner(folder)
    for _ in range(2):
        with runner:
            assert [mark_of(runner.run(Trial(L2, TURN))) for _ in range(2)] == [1.0, 4.0]
            with pytest.raises(InfeasibleTrialError, match=r"L2: rotate \(grasp 1.*all 2 recordings have been played"):
                runner.run(Trial(L2, TURN))


def test_a_trial_without_a_record_is_refused_with_those_there_are(folder: Path, tmp_path: Path):
    put(tmp_path / "results", "k1", taken(""), {"asked": {}})
    there = r"no L2: rotate \(grasp 0.*support own_weight; it has L2: rotate \(grasp 1, .*; F2: rotate .*; L2: slide"
    refused = [
        (folder, Trial(L2, Rotate(0)), there),
        (folder, Trial(L2, Weigh()), "no L2: weigh, support own_weight"),
        (tmp_path / "results", Trial(L2, TURN), "it has an object without a name: rotate"),
    ]
    for root, trial, message in refused:
        with pytest.raises(InfeasibleTrialError, match=message):
            ReplayRunner(root).run(trial)


@pytest.mark.parametrize(
    ("records", "trial", "marks"),
    [
        ([taken("", mark=7.0)], Trial(L2, TURN, RIGID), [7.0]),
        ([taken("", mark=7.0)], Trial(F2, TURN, RIGID), [7.0]),
        ([taken(mark=1.0, support="rigid"), taken(mark=2.0, support="own_weight")], Trial(L2, TURN), [2.0]),
        ([taken(mark=1.0, support="rigid"), taken(mark=2.0, support="own_weight")], Trial(L2, TURN, RIGID), [1.0]),
        ([taken(mark=day, recorded=f"2026-01-0{day}") for day in (2, 1, 3)], Trial(L2, TURN), [1.0, 2.0, 3.0]),
    ],
    ids=["no name", "no name, another object", "own weight", "rigid", "order of recording"],
)
def test_records_fit_by_what_they_say_and_come_in_the_order_of_recording(records, trial, marks, tmp_path: Path):
    for name, record_of in zip("abc", records, strict=False):
        save_trajectory(record_of, tmp_path / f"{name}.parquet")
    runner = ReplayRunner(tmp_path)
    assert [mark_of(runner.run(trial)) for _ in marks] == marks


def test_a_results_folder_names_the_object(tmp_path: Path):
    put(tmp_path, "k1", taken("", mark=1.0), {"names": {"object": "F2"}})
    put(tmp_path, "k2", taken("", mark=2.0), {"names": {"object": "L2"}})
    put(tmp_path, "k3", taken("", mark=3.0), None)  # never finished
    runner = ReplayRunner(tmp_path)
    assert mark_of(runner.run(Trial(L2, TURN))) == 2.0
    assert len(runner.recordings) == 2


def test_yaws_are_unwrapped_and_seeds_depend_on_the_object():
    yaw = 3.0 + 0.1 * np.arange(10)
    pose = np.column_stack([np.zeros((10, 2)), np.remainder(yaw + np.pi, 2 * np.pi) - np.pi])
    assert np.allclose(record(10, object_pose=pose).object_pose[:, 2], yaw)
    seeds = {Trial(load_object(name), Rotate(0), seed=1).seed_under("s") for name in ("L2", "F2", "hammer")}
    assert len(seeds) == 3


def test_a_simulated_record_gets_the_trials_draw_and_a_measured_one_none(tmp_path: Path):
    clean = moving_hand(wrench_world=np.arange(6.0))
    clean = replace(clean, provenance={"runner": "simulation", "support": "own_weight"})
    save_trajectory(clean, tmp_path / "a.parquet")
    trial = Trial(L2, Rotate(0), sensing="ft300s", seed=3)
    given = ReplayRunner(tmp_path, secret="s").run(trial)
    expected = draw_sensing(clean, preset("ft300s"), trial.seed_under("s"))
    assert np.array_equal(given.wrench_on_object_world, expected.wrench_on_object_world)
    assert not given.is_clean
    measured = compensate(replace(moving_hand(), provenance={"runner": "robot"}))
    save_trajectory(measured, tmp_path / "a.parquet")
    given = ReplayRunner(tmp_path).run(trial)
    assert np.array_equal(given.sensor_wrench, measured.sensor_wrench)
    assert np.array_equal(given.wrench_on_object_world, measured.wrench_on_object_world)


def test_a_folder_without_records_or_with_another_file_among_them_is_refused(tmp_path: Path):
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(InvalidValueError, match=r"replay folder: .*a results folder, or one of trajectory files"):
            ReplayRunner(folder)
    path = tmp_path / "a.parquet"
    save_trajectory(record(), path)
    rewrite_header(path, lambda header: header | {"action": header["action"] | {"kind": "twist"}})
    with pytest.raises(DamagedFileError, match=r"a\.parquet: not a trajectory file: action\.kind: got 'twist'"):
        ReplayRunner(tmp_path)
    save_trajectory(record(), path)
    for provenance in ([], None, {"recorded": 5}):
        rewrite_header(path, lambda header, given=provenance: header | {"provenance": given})
        with pytest.raises(DamagedFileError, match=r"a\.parquet: not a trajectory file: provenance: got .* a table"):
            ReplayRunner(tmp_path)
    path.write_text("time_s\n0.1\n")
    with pytest.raises(DamagedFileError, match=r"a\.parquet: not a trajectory file"):
        ReplayRunner(tmp_path)


def test_a_recording_is_described_in_numbers_of_four_digits():
    action = Rotate(grasp=4, duration=4.0, pivot=(-0.01666666666666667, 0.10833333333333334), back=True)
    said = Recording(Path(), action, "L2", None).description
    assert said == "L2: rotate (grasp 4, speed 0.1745, duration 4, pivot (-0.01667, 0.1083), back True)"
