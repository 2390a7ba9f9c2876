"""Damage on disk: named in every file, made again where it can be, left out where it cannot, and never silent."""

import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import rerun as rr
import rerun.blueprint as rrb

from scenarios.cli.main import main
from scenarios.results.estimates import load_estimate, load_results, load_rows
from scenarios.results.files import read_json, read_manifest, write_json
from scenarios.results.store import Store, key_of, object_request
from scenarios.results.trials import measured_records, read_trial
from scenarios.views import finished as finished_views
from testbed.errors import HeftError
from testbed.files import DamagedFileError, DamagedFileWarning, load_sealed, read_file, write_whole
from testbed.objects.files import load_object
from testbed.objects.random import Family
from testbed.trajectory import save_trajectory
from testbed.trial import Trial
from tests.helpers.changes import resealed
from tests.helpers.records import record
from tests.helpers.runs import resumed
from viz.recordings.page import SIM_TIME, Page, save

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


def test_no_bit_of_a_stored_file_turns_unseen(finished, tmp_path):
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


@pytest.mark.parametrize("harm", [flip, pytest.param(lose, marks=pytest.mark.slow)])
def test_a_run_names_what_is_damaged_and_makes_it_again(finished, copied, harm):
    before = {path: path.read_bytes() for path in copied.rglob("*.*")}
    harmed = [*(copied / "notes").iterdir(), copied / "manifest.json", copied / "results.parquet"]
    for kind, names in (("trials", KINDS[2:5]), ("estimates", KINDS[5:])):
        folders = [f for f in sorted((copied / kind).iterdir()) if all((f / name).exists() for name in names)]
        harmed += [folder / name for folder, name in zip(folders, names, strict=False)]
    for path in harmed:
        harm(path)
    with pytest.warns(DamagedFileWarning) as told:
        pd.testing.assert_frame_equal(resumed(finished.scenario, copied), finished.rows)
    said = "\n".join(str(warning.message) for warning in told)
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
def test_a_measured_trial_is_left_out_told_and_kept(tmp_path, name):
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
        with pytest.warns(DamagedFileWarning) as told:
            main([command, str(copied), *options])
        assert {str(warning.message).partition(": ")[0] for warning in told} == {str(path) for path in files}
    for command in (["export", row["key"]], ["view", trial.name, "--film"]):
        with pytest.raises(SystemExit, match="2"):
            main([command[0], str(copied), *command[1:]])
        said = capsys.readouterr().err
        assert said.startswith(f"heft: {copied}") and ": not a whole" in said and said.count("\n") == 1


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
    ("field", "value"), [("scenario", 3), ("expected", []), ("scenario", {"sensing": 1}), ("name", {})]
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


@pytest.mark.parametrize("stage", ["figures", "record_results", "report"])
def test_a_full_disk_at_the_end_is_no_run_that_is_done(finished, copied, monkeypatch, capsys, stage):
    def full(*_: object) -> None:
        raise OSError(28, "No space left on device", str(copied / stage))

    for name in ("figures", "record_results", "record_worst", "report"):
        monkeypatch.setattr(finished_views, name, full if name == stage else lambda *_: copied / "x.pdf")
    with pytest.raises(SystemExit, match="2"):
        main(["run", str(finished.scenario), "--out", str(copied), "--workers", "0"])
    assert capsys.readouterr().err == f"heft: No space left on device: {copied / stage}\n"


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
