"""Results on disk: stored and read back; damage is named, made again or left out, and never silent."""

import dataclasses
import json
import math
import shlex
import shutil
import subprocess
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rerun as rr
import rerun.blueprint as rrb
from numpy.testing import assert_array_equal

from estimators.base import Estimate, HiddenStateEstimate, Trace
from estimators.evaluation.statistics import axis_columns, axis_values
from estimators.identifiability.report import identifiability
from scenarios.cli.main import main
from scenarios.results.estimates import load_estimate, load_results, load_rows
from scenarios.results.files import read_json, read_manifest, write_json
from scenarios.results.marks import ESTIMATE, mark_of
from scenarios.results.store import Store, key_of, keys_of_seeds, object_request, trial_request
from scenarios.results.table import ResultTable, rows_of, write_rows
from scenarios.results.trials import keys_of, measured_records, read_trial
from scenarios.views import finished as finished_views
from testbed import RIGID, HeftError, InvalidValueError, Rotate, Slide, Trial, Weigh, load_object, save_trajectory
from testbed.files import DamagedFileError, DamagedFileWarning, load_sealed, read_file, write_text, write_whole
from testbed.objects.model import STROKE
from testbed.objects.random import Family
from testbed.simulation.settings import GripSettings, SimulationSettings
from tests.helpers.changes import resealed
from tests.helpers.commands import refusal
from tests.helpers.records import record
from tests.helpers.runs import resumed
from tests.helpers.simulated import put_trial
from viz.recordings.page import SIM_TIME, Page, save

SLIDE = Slide(0, duration=0.2)
L2, HAMMER = load_object("L2"), load_object("hammer")


def test_solids_and_gripped_faces_are_in_the_key():
    first, grasp = HAMMER.solids[0], HAMMER.shape.grasps[0]
    stretched = dataclasses.replace(first, vertices=first.vertices * [1.0, 1.0, 1.1])
    others = [dataclasses.replace(HAMMER, solids=each) for each in ((), (stretched, *HAMMER.solids[1:]))]
    for faces in ({"bottom": 0.001}, {"top": 0.03}, {"top": None}):
        grasps = (dataclasses.replace(grasp, **faces), *HAMMER.shape.grasps[1:])
        others.append(dataclasses.replace(HAMMER, shape=dataclasses.replace(HAMMER.shape, grasps=grasps)))
    keys = [key_of(trial_request(Trial(o, Rotate(0)), SimulationSettings())) for o in (HAMMER, *others)]
    assert len({*keys}) == len(keys)
    assert keys[0] == key_of(trial_request(Trial(load_object("hammer"), Rotate(0)), SimulationSettings()))


def test_a_key_depends_on_content_alone_and_keys_of_many_seeds_are_those_of_each():
    assert key_of({"a": 1, "b": [1, 2]}) == key_of({"b": [1, 2], "a": 1}) != key_of({"a": 1})
    request = {"b": [1, 2], "z": {"seed": 1}, "a": "x"}
    assert keys_of_seeds(request, [0, 7, 12]) == [key_of(request | {"seed": seed}) for seed in (0, 7, 12)]


def test_a_swept_setting_of_words_and_numbers_is_kept_in_words(tmp_path):
    swept = (["own_weight"], [10], [1000.0], ["rigid"], ["own_weight", "rigid"], [])
    rows = [axis_columns({"support": value}) | {"nad": 0.1} for value in swept]
    kept = write_rows(tmp_path, [*rows, {"axis.support": None, "nad": 0.1}])["axis.support"]
    assert list(pd.read_parquet(tmp_path / "results.parquet")["axis.support"].dropna()) == list(kept.dropna())
    words = ["own_weight", "10", "1000.0", "rigid", "own_weight, rigid", "none"]
    assert list(kept)[:6] == axis_values(rows_of(kept.to_frame()), "axis.support") == words
    assert list(axis_columns({"a": [["low"]], "b": [2], "c": [{"n": 1}], "d": (1, 2)}).values()) == [
        "low", 2, "n = 1", "1, 2"]  # fmt: skip


def test_a_row_of_the_last_table_is_taken_while_the_files_of_its_estimate_stay_as_they_were_read(tmp_path):
    files = [tmp_path / "estimates" / "a" / name for name in ("result.json", "estimate.npz")]
    for file in files:
        write_text(file, "sound")
    rows = [{"object": "old", "key": key, "status": status, "nad": 0.25, "trials": 3, "more": None}
            for key, status in (("a", "ok"), ("b", "failed"))]  # fmt: skip
    write_rows(tmp_path, [row | {"axis.of_another_sweep": 1} for row in rows])
    labels = {"object": "new"}
    assert not ResultTable(tmp_path).recall((1,), labels, "a"), "its files were not read yet"
    table = ResultTable(tmp_path)
    table.marks |= {"estimates/a": mark_of(files[0].parent, ESTIMATE), "estimates/b": "none"}
    assert table.recall((1,), labels, "a")
    assert not table.recall((0,), labels, "b") and not table.recall((0,), labels, "c")
    table.add((0,), labels, rows[1] | {"status": "ok", "nad": None, "more": "words"})
    frame = table.write()
    assert rows_of(frame) == rows_of(load_results(tmp_path)) == [
        {"object": "new", "key": "b", "status": "ok", "nad": None, "trials": 3, "more": "words"},
        {"object": "new", "key": "a", "status": "ok", "nad": 0.25, "trials": 3, "more": None},
    ]  # fmt: skip
    assert frame["trials"].dtype == int
    assert ResultTable(tmp_path).recall((0,), labels, "a")
    (tmp_path / "results.parquet").touch()
    assert ResultTable(tmp_path).recall((0,), labels, "a")
    for change in (files[0].touch, lambda: write_text(files[0], "sound"), files[1].unlink):
        table = ResultTable(tmp_path)
        time.sleep(0.02)  # a file system's clock ticks every few milliseconds
        change()
        assert not table.recall((0,), labels, "a")
        table.marks["estimates/a"] = mark_of(files[0].parent, ESTIMATE)
        table.write()


def test_a_trial_is_read_again_once_it_has_changed(copied):
    store, marks = Store(copied), dict[str, str]()
    key = next(key for key in keys_of(copied) if store.trajectory(key).action.moves)
    path = copied / "trials" / key / "trajectory.parquet"
    assert store.has_sound_trial(key, marks) and [*marks] == [f"trials/{key}"]
    assert store.has_sound_trial(key, marks)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 1
    path.write_bytes(data)
    with pytest.warns(DamagedFileWarning, match="made again"):
        assert not store.has_sound_trial(key, marks)
    assert not store.has_trial(key)


def same(a: object, b: object) -> None:
    """Equal to the last bit, through dataclasses and tuples."""
    if dataclasses.is_dataclass(a):
        assert type(a) is type(b)
        for field in dataclasses.fields(a):
            same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, tuple):
        assert isinstance(b, tuple) and len(a) == len(b)
        for one, other in zip(a, b, strict=True):
            same(one, other)
    else:
        assert_array_equal(a, b)  # pyright: ignore[reportArgumentType]


FULL = Estimate(
    L2.truth,
    "underdetermined",
    "the order of B and C is open",
    np.diag([1e-3, 2e-3, 1e-3, 1e-3, 1e-3, math.inf]),
    identifiability(L2.shape, L2.truth, np.random.default_rng(0).normal(size=(4, L2.shape.n_m + L2.shape.n_mu))),
    HiddenStateEstimate(1.8, math.nan, np.array([0.01, math.nan]), np.ones(6), tuple((g, 0) for g in range(6)), "I_cm"),
    (
        Trace("rms prop", (2.0, 1.0), (0.1, 0.2), 36.0, np.ones((2, 6))),
        Trace("adam", (3.0,), (0.1,), 36.0, np.zeros((0, 0))),
    ),
    0.3,
    {"loss": 1.25, "rank": 6.0},
    "every mass group rests on its own weight",
)


@pytest.mark.parametrize("answer", [FULL, Estimate(None, "no_data", "no trial is usable")], ids=["full", "empty"])
def test_load_estimate_is_the_inverse_of_put_estimate(tmp_path, answer):
    optimizer = answer.traces[0].method if answer.traces else ""
    row = {name: getattr(answer, name) for name in ("status", "message", "seconds", "assumes")} | {
        "optimizer": optimizer
    }
    Store(tmp_path).put_estimate("key", row, answer, L2.shape)
    same(load_estimate(tmp_path, "key"), answer)
    for name in ("estimate.npz", "result.json"):
        (tmp_path / "estimates" / "key" / name).write_bytes(b"{")
        with pytest.raises(HeftError, match=f"{name}: not a whole"):
            load_estimate(tmp_path, "key")


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    """A folder with a slide of L2, one of the hammer, and a weighing."""
    folder = tmp_path_factory.mktemp("results")
    keys = [put_trial(folder, "L2", SLIDE), put_trial(folder, "hammer", SLIDE, RIGID), put_trial(folder, "L2", Weigh())]
    return folder, dict(zip(("L2", "hammer", "weigh"), keys, strict=True))


@pytest.mark.parametrize(("known", "support"), [(L2, "own_weight"), (HAMMER, "rigid")], ids=["L2", "hammer"])
def test_a_trial_is_read_back(root, known, support):
    record = read_trial(root[0], root[1][known.name][:7])
    assert object_request(record.object) == object_request(known)
    assert (record.object.name, record.support, record.trajectory.action) == (known.name, support, SLIDE)
    assert record.object.shape.group_names == known.shape.group_names
    assert [grasp.name for grasp in record.object.shape.grasps] == [grasp.name for grasp in known.shape.grasps]
    for read, solid in zip(record.object.solids, known.solids, strict=True):
        assert_array_equal(read.vertices, solid.vertices)
    assert record.pads == (known.shape.grasps[0].width, STROKE)
    assert isinstance(read_trial(root[0], root[1]["weigh"]).trajectory.action, Weigh)


@pytest.mark.parametrize("name", ["wrench", "no such object", None])
def test_an_object_that_is_another_now_is_known_by_its_particles(root, tmp_path, name):
    copy, content = copied(root, tmp_path, "hammer")
    content["names"] = {} if name is None else {"object": name}
    del content["asked"]["simulation"]  # as one of a real robot
    write_json(copy / "trial.json", content)
    record = read_trial(tmp_path, copy.name)
    assert record.object.solids == () and record.object.name == (name or "object")
    assert_array_equal(record.object.shape.particles, HAMMER.shape.particles)


def test_welded_fingers_stay_open(tmp_path):
    key = put_trial(tmp_path, "L2", SLIDE, settings=SimulationSettings(grip=GripSettings(mode="weld")))
    assert read_trial(tmp_path, key).pads == (STROKE, STROKE)


def test_no_trial_or_several_are_refused(root):
    keys = keys_of(root[0])
    for wrong, allowed in (("x", "beginning of one trial's key"), ("", "more of the key, this is ambiguous")):
        with pytest.raises(InvalidValueError, match=allowed) as error:
            read_trial(root[0], wrong)
        assert all(key[:8] in str(error.value) for key in keys)
    with pytest.raises(InvalidValueError, match="a results folder"):
        read_trial(root[0] / "trials", "x")


@pytest.mark.parametrize("harm", ["{", "[]", {"asked": {}}, {"asked": {"object": {"particles": "many"}}}, None])
def test_a_damaged_trial_is_an_error_and_stays(root, tmp_path, harm):
    copy, _ = copied(root, tmp_path, "L2")
    if harm is None:
        record = copy / "trajectory.parquet"
        record.write_bytes(record.read_bytes()[:-100])
    elif isinstance(harm, str):
        (copy / "trial.json").write_text(harm)
    else:
        write_json(copy / "trial.json", harm)
    file = "trajectory.parquet" if harm is None else "trial.json"
    with pytest.raises(DamagedFileError, match=f"{file}: not a whole"):
        read_trial(tmp_path, copy.name)
    assert (copy / "trial.json").is_file()


def copied(root, tmp_path, name):
    """A trial's folder, copied, and the content of its trial.json."""
    source = root[0] / "trials" / root[1][name]
    folder = shutil.copytree(source, tmp_path / "trials" / source.name)
    return folder, json.loads((folder / "trial.json").read_text())


KINDS = (
    *("manifest.json", "results.parquet", "trajectory.parquet", "trial.json", "foot_forces.parquet"),
    *("estimate.npz", "result.json"),
)


def flip(path: Path, at: float = 0.5) -> None:
    """Turn one bit of a file, at this part of its length."""
    data = bytearray(path.read_bytes())
    data[int(at * len(data))] ^= 4
    path.write_bytes(data)


def lose(path: Path) -> None:
    """Fill a sector of a file with zeros."""
    data = bytearray(path.read_bytes())
    begin = min(512, len(data) // 2) // 16 * 16
    data[begin : begin + 512] = bytes(len(data[begin : begin + 512]))
    path.write_bytes(data)


def test_a_changed_bit_of_a_stored_file_is_detected(finished, tmp_path):
    rng, path = np.random.default_rng(0), tmp_path / "file"
    for name in KINDS:
        whole = next(finished.out.rglob(name))
        data = whole.read_bytes()
        assert load_sealed(whole, "file", len) == len(data)
        for at in [0, len(data) - 1, *rng.integers(len(data), size=10)]:
            harmed = bytearray(data)
            harmed[at] ^= 1 << rng.integers(8)
            path.write_bytes(harmed)
            with pytest.raises(DamagedFileError, match="not a whole file"):
                load_sealed(path, "file", len)


@pytest.mark.slow
def test_a_run_names_what_is_damaged_and_makes_it_again(finished, copied):
    before = {path: path.read_bytes() for path in copied.rglob("*.*")}
    harmed = [*(copied / "notes").iterdir(), copied / "manifest.json", copied / "results.parquet"]
    for kind, names in (("trials", KINDS[2:5]), ("estimates", KINDS[5:])):
        folders = [f for f in sorted((copied / kind).iterdir()) if all((f / name).exists() for name in names)]
        harmed += [folder / name for folder, name in zip(folders, names, strict=False)]
    for number, path in enumerate(harmed):
        (flip, lose)[number % 2](path)
    with pytest.warns(DamagedFileWarning) as warnings:
        pd.testing.assert_frame_equal(resumed(finished.scenario, copied), finished.rows)
    said = "\n".join(str(warning.message) for warning in warnings)
    for path in harmed:
        assert path.name == "results.parquet" or f"{path}: not a whole" in said or path.name == "manifest.json"
    assert len(load_results(copied)) == len(finished.rows)
    for path, data in before.items():
        if path.parent.name != "out":
            load_sealed(path, "file", len)
            assert path in harmed or path.parent in {p.parent for p in harmed} or path.read_bytes() == data


def test_a_drawn_object_is_drawn_again(tmp_path):
    store, path = Store(tmp_path), tmp_path / "objects" / "key" / "r_0.toml"
    assert not store.has_object(path)
    store.put_object(path, Family(name="r", count=1).draw(0, 0))
    assert store.has_object(path) and load_object(path).name == "r_0"
    flip(path)
    with pytest.warns(DamagedFileWarning, match="r_0.toml: not a whole object file: .*; made again"):
        assert not store.has_object(path)


@pytest.mark.parametrize("name", ["trajectory.parquet", "trial.json"])
def test_a_damaged_measured_trial_is_left_out_with_a_warning_and_kept(tmp_path, name):
    obj, store = load_object("L2"), Store(tmp_path)
    for number in range(2):
        taken = record(provenance={"runner": "robot", "recorded": str(number)})
        request = {"object": object_request(obj), "support": "own_weight", "number": number}
        store.put_trial(key_of(request), Trial(obj, taken.action), request, taken)
    first, second = (trial.folder for trial in measured_records(tmp_path))
    flip(first / name)
    with pytest.warns(DamagedFileWarning, match=f"{name}: not a whole .*; left out"):
        (left,) = measured_records(tmp_path)
    assert left.folder == second and (first / "trial.json").is_file()
    with pytest.raises(DamagedFileError):
        store.trajectory(first.name) if name == "trajectory.parquet" else read_json(first / name)
    assert (first / "trial.json").is_file()


@pytest.mark.slow
def test_what_shows_a_folder_names_what_is_damaged(finished, copied, capsys):
    row = finished.rows[finished.rows["method"] == "bare"].iloc[0]
    estimate, trial = copied / "estimates" / row["key"], copied / "trials" / row["trial_keys"][1]
    harmed = [copied / "manifest.json", trial / "trial.json", estimate / "estimate.npz"]
    for path in harmed:
        flip(path)
    for words, files in (("status", harmed[:2]), ("view --report", harmed), ("view --film", harmed[1:2])):
        command, *options = words.split()
        with pytest.warns(DamagedFileWarning) as warnings:
            main([command, str(copied), *options])
        assert {str(warning.message).partition(": ")[0] for warning in warnings} == {str(path) for path in files}
    for command in (["export", row["key"]], ["view", trial.name, "--film"]):
        said = refusal(capsys, command[0], str(copied), *command[1:])
        assert said.startswith(f"heft: {copied}") and ": not a whole" in said


def test_content_of_another_kind_is_read_or_refused(finished, copied):
    row = finished.rows[finished.rows["method"] == "bare"].iloc[0]
    key, trial = row["key"], row["trial_keys"][1]
    kinds: dict[Path, Callable[[], object]] = {
        copied / "manifest.json": lambda: read_manifest(copied),
        copied / "results.parquet": lambda: load_rows(copied),
        copied / "trials" / trial / "trial.json": lambda: read_trial(copied, trial),
        copied / "trials" / trial / "trajectory.parquet": lambda: read_trial(copied, trial),
        copied / "estimates" / key / "result.json": lambda: load_estimate(copied, key),
        copied / "estimates" / key / "estimate.npz": lambda: load_estimate(copied, key),
    }
    refused = 0
    for path, read in kinds.items():
        whole = path.read_bytes()
        for seed in range(4):
            resealed(path, np.random.default_rng(seed))
            try:
                read()
            except HeftError:
                refused += 1
            path.write_bytes(whole)
        read()
    assert refused > 4


@pytest.mark.parametrize(
    ("field", "value"),
    [("scenario", 3), ("expected", []), ("scenario", {"sensing": 1}), ("expected", {"trials": "many"}), ("name", {})],
)
def test_a_manifest_of_another_kind_is_refused(tmp_path, field, value):
    write_json(tmp_path / "manifest.json", {field: value})
    with pytest.raises(DamagedFileError, match="not of this version of heft"):
        read_manifest(tmp_path)


def test_what_is_no_plain_file_or_too_large_is_not_read(tmp_path):
    with pytest.raises(OSError, match="not a plain file"):
        read_file(Path("/dev/zero"))
    save_trajectory(record(), tmp_path / "t.parquet")
    with pytest.raises(OSError, match="more than the 0"):
        read_file(tmp_path / "t.parquet", 1000)


def test_a_run_removes_the_leftovers_of_heft_and_nothing_that_is_being_written_or_is_not_its_own(tmp_path):
    folder = tmp_path / "trials" / "k"
    folder.mkdir(parents=True)
    (aside := tmp_path / "aside").mkdir()
    names = {folder / ".trial.json.12.part": False, tmp_path / ".manifest.json.3.part": False}
    names |= {folder / ".song.part": True, aside / ".trial.json.12.part": True, tmp_path / ".git.part": True}
    for path in names:
        path.write_bytes(b"half")
    (folder / ".link.7.part").symlink_to(aside / ".trial.json.12.part")
    (tmp_path / "notes").symlink_to(aside)

    def write(part: Path) -> None:
        part.write_bytes(b"new")
        Store(tmp_path).remove_leftovers()
        assert part.is_file(), "a file that is being written"

    write_whole(folder / "trajectory.parquet", write)
    assert (folder / "trajectory.parquet").read_bytes() == b"new"
    assert {path: path.exists() for path in names} == names


def test_a_full_disk_at_the_end_is_no_run_that_is_done(finished, copied, monkeypatch, capsys, tmp_path):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(copied / "recording.rrd"))

    for name in ("figures", "record_results", "record_worst", "report"):
        monkeypatch.setattr(finished_views, name, full if name == "record_results" else lambda *_: copied / "x.pdf")
    scenario = shutil.copy(finished.scenario, tmp_path / "my scenario.toml")
    said = refusal(capsys, "run", str(scenario), "--out", str(copied), "--workers", "0")
    assert said == f"heft: No space left on device: {copied / 'recording.rrd'}\n"
    command = (read_manifest(copied) or {})["command"]
    assert shlex.split(command) == ["heft", "run", str(scenario), "--out", str(copied)]


def test_a_recording_that_does_not_fit_on_the_disk_is_an_error(tmp_path):
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=16k", "tmpfs", tmp_path], check=False).returncode:
        pytest.skip("mounting is not possible here")
    try:
        page = Page("n", "id", lambda stream: stream.log("x", rr.TextLog("x" * 50_000)), rrb.TextLogView(), SIM_TIME)
        with pytest.raises(OSError, match="No space left"):
            save(page, tmp_path / "a.rrd")
        assert not [*tmp_path.iterdir()]
    finally:
        subprocess.run(["umount", tmp_path], check=True)
