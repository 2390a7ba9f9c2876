"""Runs of a scenario: whatever happens to one, the same command goes on to the results of an undisturbed run."""

import os
import re
import shutil
import signal
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest

from scenarios.config import Scenario, Sweep, load_scenario
from scenarios.execution.executor import InlineExecutor
from scenarios.results.files import LOCK, STAGES, FolderInUseError, errors_left, exclusive, read_json, write_json
from scenarios.results.store import Store
from scenarios.results.table import rows_of
from scenarios.study import run as study
from scenarios.study import trials
from scenarios.study.experiment import experiments_of
from scenarios.study.run import ACTIVE_FIELDS, check_nothing_lost, manifest, run_scenario
from scenarios.views import finished as views
from testbed.errors import InfeasibleTrialError, InvalidValueError
from tests.helpers.commands import refusal
from tests.helpers.runs import Killing, assert_whole, done_in, kill_a_run, quiet, resumed, small_scenario
from tests.helpers.waiting import until

FAULTY = """
import functools, sys
import tests.fakes.misbehaving
from scenarios.study import run as sweep
from scenarios.cli.main import main
from scenarios.execution.executor import Limits
from scenarios.execution.select import open_executor
from estimators.registry import METHODS

METHODS["misbehaving"] = tests.fakes.misbehaving.Misbehaving

if __name__ == "__main__":
    from scenarios.views import finished

    finished.write_views = lambda *_, **__: ()
    sweep.open_executor = functools.partial(open_executor, limits=Limits(timeout_s=8.0, tries=1, memory_gib=1.0))
    main(sys.argv[1:])
"""


def test_a_run_answers_by_every_label(finished):
    rows = finished.rows
    assert len(rows) == 9
    assert set(zip(rows["method"], rows["kind"], rows["status"], strict=True)) == {
        ("hidden_states", "hidden_states", "ok"),
        ("bare", "random_search", "underdetermined"),
        ("given", "random_search", "unexplained"),
    }
    assert rows["nad"].tolist()[0] < 0.02
    given = rows[rows["method"] == "given"].iloc[0]
    assert sum(given["mass_kg"]) == pytest.approx(given["weight_kg"])
    with np.load(finished.out / "estimates" / given["key"] / "estimate.npz") as arrays:
        assert arrays["random.mass"].shape == (20, 2)
        assert (np.diff(arrays["random.loss"]) <= 0).all()
    assert {"mpd_open_loop_m", "mpd_turn_m"} <= set(rows.columns)
    assert max(rows["mpd_turn_of_truth_m"].dropna()) < 0.02


@pytest.mark.slow
def test_a_killed_run_goes_on(longer, tmp_path):
    """Three kills of one run, each after two more files; a run whose worker is killed ends by itself."""
    out = tmp_path / "out"
    for victim in ("driver", "both", "worker"):
        kill_a_run(longer.scenario, out, Killing(victim, done_in(out) + 2, 0.1, 0))
    pd.testing.assert_frame_equal(resumed(longer.scenario, out), longer.rows)
    assert not list(out.rglob("*.part"))


@pytest.mark.slow
def test_a_stopped_run_leaves_whole_files_and_the_next_one_goes_on(finished, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "heft", "run", str(finished.scenario), "--out", str(out), "--workers", "2"]
    for sent, code in ((signal.SIGINT, 130), (signal.SIGTERM, 143)):
        before = done_in(out)
        process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        until(lambda before=before: done_in(out) > before, seconds=60)
        os.killpg(process.pid, sent)
        _, stderr = process.communicate(timeout=60)
        assert process.returncode == code, stderr
        assert b"run the same command again to continue" in stderr and b"Traceback" not in stderr
        assert_whole(out)
        assert not list(out.rglob("*.part"))
    pd.testing.assert_frame_equal(resumed(finished.scenario, out), finished.rows)


@pytest.mark.slow
def test_an_objects_estimates_come_before_the_next_ones_trials(tmp_path):
    kinds: list[str] = []
    scenario = load_scenario(str(small_scenario(tmp_path, ("rigid",))))[1]
    other = (tmp_path / "pair.toml").read_text("utf-8").replace("pair", "other").replace("0.3", "0.4")
    (tmp_path / "other.toml").write_text(other, "utf-8")
    scenario = scenario.changed(objects=(*scenario.objects, str(tmp_path / "other.toml")))
    run_scenario(scenario, tmp_path / "out", 0, quiet, on_result=lambda kind, _: kinds.append(kind))
    each = [*["trial"] * (kinds.count("trial") // 2), *["estimate"] * (kinds.count("estimate") // 2)]
    assert kinds == each * 2


@pytest.mark.slow
def test_trials_that_no_wrench_decides_are_all_in_flight_at_once(finished, tmp_path, monkeypatch):
    running: list[int] = []

    class Wide(InlineExecutor):
        capacity = 50

        def wait(self) -> tuple[Any, Any]:
            running.append(self.running)
            return super().wait()

    monkeypatch.setattr(study, "open_executor", lambda *_, **__: nullcontext(Wide()))
    pd.testing.assert_frame_equal(resumed(finished.scenario, tmp_path / "out"), finished.rows)
    assert running[0] == len(list((tmp_path / "out").glob("trials/*")))


def test_a_finished_run_is_read_again_without_work(finished, copied):
    stamps = {path: path.stat().st_mtime_ns for kind in ("trials", "estimates") for path in copied.glob(f"{kind}/*/*")}
    pd.testing.assert_frame_equal(resumed(finished.scenario, copied, workers=2), finished.rows)  # starts no worker
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}


def test_errors_of_trials_and_estimates_that_a_run_no_longer_has_go_at_its_end(finished, copied):
    for stage in STAGES:
        Store(copied).put_error(stage, "0" * 20, "ValueError: it broke, and was mended\n")
    pd.testing.assert_frame_equal(resumed(finished.scenario, copied), finished.rows)
    assert not any(errors_left(copied, stage) for stage in STAGES)


CHANGES: list[tuple[dict[str, Any], str]] = [
    ({}, ""),
    ({"seeds": 9}, ""),
    ({"seeds": 1}, "seeds"),
    ({"sweep": {"axes": {"grid.feet": [3, 4]}}}, "sweep"),
    ({"objects": ["F2"]}, "objects"),
    ({"methods": {"mine": {"method": "hidden_states"}}}, "methods"),
    ({"grid": {"feet": 2}}, "grid"),
]


@pytest.mark.parametrize(("change", "field"), CHANGES, ids=str)
def test_a_folder_of_another_run_is_not_written_over(finished, change: dict[str, Any], field: str):
    asked = load_scenario(str(finished.scenario))[1]
    asked = Scenario.model_validate(asked.model_dump() | change)
    if not field:
        check_nothing_lost(finished.out, asked)
        return
    with pytest.raises(InvalidValueError, match=rf"results of another run \({field}\)") as refused:
        run_scenario(asked, finished.out, 0, quiet)
    assert refused.value.field == "--out"


AXES = {"grid.feet": [2, 3], "grid.particles": [3, 4]}
TURNED = {"grid.feet": [2, 3], "grid.particles": [4, 3]}


@pytest.mark.parametrize(
    ("held", "asked", "kept"),
    [
        (Sweep(axes=AXES), Sweep(axes=TURNED), True),
        (Sweep(axes=AXES), Sweep(axes=AXES | {"grid.feet": [1, 2, 3]}), True),
        (Sweep(axes=AXES), Sweep(mode="zip", axes=AXES), False),
        (Sweep(mode="zip", axes=AXES), Sweep(axes=AXES), True),
        (Sweep(mode="zip", axes=AXES), Sweep(mode="zip", axes=TURNED), False),
        (
            Sweep(mode="zip", axes=AXES),
            Sweep(mode="zip", axes={name: [1, *values] for name, values in AXES.items()}),
            True,
        ),
    ],
    ids=["turned grid", "larger grid", "zip of a grid", "grid of a zip", "turned zip", "longer zip"],
)
def test_no_point_of_a_sweep_is_lost(tmp_path, held: Sweep, asked: Sweep, kept: bool):
    blocks = load_scenario("blocks")[1]
    tmp_path.joinpath("results.parquet").touch()
    write_json(tmp_path / "manifest.json", manifest(blocks.model_copy(update={"sweep": held}), "secret"))
    with nullcontext() if kept else pytest.raises(InvalidValueError, match=r"results of another run \(sweep\)"):
        check_nothing_lost(tmp_path, blocks.model_copy(update={"sweep": asked}))


def test_an_active_run_and_a_scenario_do_not_replace_each_other(tmp_path):
    asked = Scenario(objects=["L2"], seeds=1)
    tmp_path.joinpath("results.parquet").touch()
    for fields, others in ((None, ACTIVE_FIELDS), (ACTIVE_FIELDS, None)):
        facts = manifest(asked, "secret") | {"scenario": asked.model_dump(include=fields)}
        write_json(tmp_path / "manifest.json", facts)
        check_nothing_lost(tmp_path, asked, "secret", fields)
        with pytest.raises(InvalidValueError, match=r"results of another run \(.*methods.*\)"):
            check_nothing_lost(tmp_path, asked, "secret", others)


def test_results_of_object_files_go_on_in_another_checkout(tmp_path):
    asked = load_scenario("blocks")[1].model_copy(update={"objects": ["/there/hammer.toml", "L2"]})
    tmp_path.joinpath("results.parquet").touch()
    write_json(tmp_path / "manifest.json", manifest(asked, "secret"))
    check_nothing_lost(tmp_path, asked.model_copy(update={"objects": ["L2", "/here/hammer.toml", "F1"]}))
    with pytest.raises(InvalidValueError, match=r"results of another run \(objects\)"):
        check_nothing_lost(tmp_path, asked.model_copy(update={"objects": ["L2", "/here/mallet.toml"]}))


def test_results_of_an_object_whose_file_has_changed_are_not_written_over(finished, copied, tmp_path):
    text = finished.scenario.read_text(encoding="utf-8").replace(str(finished.scenario.parent), str(tmp_path))
    (path := tmp_path / "small.toml").write_text(text, encoding="utf-8")
    mine = Path(shutil.copy(finished.scenario.with_name("pair.toml"), tmp_path))
    asked = load_scenario(str(path))[1]
    check_nothing_lost(copied, asked.model_copy(update={"seeds": asked.seeds + 1}))
    mine.write_text(re.sub("mass_kg = .*", "mass_kg = 0.7", mine.read_text(encoding="utf-8")), encoding="utf-8")
    with pytest.raises(InvalidValueError, match=r"results of another run \(pair, whose file has changed\)"):
        check_nothing_lost(copied, asked)


@pytest.mark.slow
def test_damage_and_leftovers_are_made_good_and_nothing_else_is_touched(finished, copied):
    trials, estimates = sorted(copied.glob("trials/*")), sorted(copied.glob("estimates/*"))
    for trial in (trials[0], trials[3]):
        record = trial / "trajectory.parquet"
        record.write_bytes(record.read_bytes()[:5000])
    (trials[1] / "trial.json").unlink()
    (estimates[0] / "result.json").write_text('{"nad": 0.', encoding="utf-8")
    (estimates[1] / "result.json").write_bytes(b"\xff\x00")
    (estimates[2] / "result.json").unlink()
    leftovers = [trials[2] / ".trajectory.parquet.123.part", estimates[0] / ".result.json.9.part", copied / ".x.1.part"]
    for path in leftovers:
        path.write_bytes(b"half")
    touched = {trials[0], trials[1], trials[3], *estimates[:3]}
    stamps = {p: p.stat().st_mtime_ns for p in copied.glob("[te]*s/*/*") if p.parent not in touched}
    pd.testing.assert_frame_equal(resumed(finished.scenario, copied), finished.rows)
    assert not any(path.exists() for path in leftovers)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items() if path not in leftovers)
    assert_whole(copied)


def test_a_second_run_on_the_same_folder_is_refused_in_one_line(finished, tmp_path, capsys):
    with exclusive(tmp_path):
        said = refusal(capsys, "run", str(finished.scenario), "--out", str(tmp_path), "--workers", "0")
    assert f"another run (process {os.getpid()} on " in said


def test_a_killed_run_lets_go_of_its_folder(tmp_path):
    hold = "from pathlib import Path; from scenarios.results.files import exclusive"
    code = f"{hold}; lock = exclusive(Path({str(tmp_path)!r})); lock.__enter__(); print('held', flush=True); input()"
    with subprocess.Popen([sys.executable, "-c", code], stdin=subprocess.PIPE, stdout=subprocess.PIPE) as holder:
        assert holder.stdout is not None
        holder.stdout.readline()
        with pytest.raises(FolderInUseError, match=f"process {holder.pid} on"), exclusive(tmp_path):
            pass
        holder.kill()
        holder.wait()
    with exclusive(tmp_path):
        assert (tmp_path / LOCK).is_file()


def test_a_refused_run_leaves_no_folder_behind(tmp_path):
    with pytest.raises(ValueError, match="refused"), exclusive(tmp_path / "out"):
        raise ValueError("refused")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize(("kind", "message"), [("full", "No space left on device"), ("read-only", "Read-only file")])
def test_a_disk_that_takes_nothing_more_is_one_line_and_no_half_file(finished, tmp_path, capfd, kind, message):
    """On a real file system of one size or of one mind."""
    out = tmp_path / "disk"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", out], check=False).returncode:
        pytest.skip("mounting is not possible here")
    try:
        if kind == "read-only":
            subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        said = refusal(capfd, "run", str(finished.scenario), "--out", str(out), "--workers", "0")
        assert re.search(rf"heft: .*{message}.*: {out}", said)
        assert_whole(out)
        assert not list(out.rglob("*.part"))
    finally:
        subprocess.run(["umount", out], check=True)


@pytest.mark.slow
def test_a_disk_that_fills_up_is_an_error_and_no_half_file(finished, tmp_path, monkeypatch):
    """Same check where mounting is not possible."""
    calls = 0

    def fsync(_: int) -> None:
        nonlocal calls
        calls += 1
        if calls > 5:
            raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match=f"No space left on device: '{tmp_path}/out/[^.]"):
        resumed(finished.scenario, tmp_path / "out")
    assert_whole(tmp_path / "out")
    begun = read_json(tmp_path / "out" / "manifest.json") or {}
    assert not begun["finished"]
    assert begun["expected"]["estimates"] == len(finished.rows)
    assert (read_json(finished.out / "manifest.json") or {})["finished"]
    assert not list((tmp_path / "out").rglob("*.part"))


@pytest.mark.slow
def test_a_method_that_hangs_crashes_or_eats_memory_is_a_row_and_the_rest_goes_on(tmp_path):
    ways = ("hang", "crash", "eat")
    more = "".join(f'[methods.{way}]\nmethod = "misbehaving"\nway = "{way}"\n' for way in ways)
    path = small_scenario(tmp_path, ("rigid",), more + "[methods.hidden_states]\n")
    path.write_text(path.read_text(encoding="utf-8").replace(', "ft300s"', ""), encoding="utf-8")  # one row per method
    (tmp_path / "faulty.py").write_text(FAULTY)
    command = [sys.executable, tmp_path / "faulty.py", "run", path, "--out", tmp_path / "out", "--workers", "2"]
    # the methods are added where the workers find them too: in the main module
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1, done.stderr
    rows = pd.read_parquet(tmp_path / "out" / "results.parquet").set_index("method")
    assert not set(rows.loc[["hidden_states"], "status"]) - {"ok", "unexplained"}  # one rigid body
    assert set(rows.loc[[*ways], "status"]) == {"failed"}
    assert set(rows.loc[["hang"], "message"]) == {"took longer than 8 s (tried once)"}
    assert set(rows.loc[["crash"], "message"]) == {"its worker process was killed by SIGSEGV (tried once)"}
    assert all("Unable to allocate" in message for message in rows.loc[["eat"], "message"])
    for key in rows.loc[[*ways], "key"]:
        assert (tmp_path / "out" / "estimates" / key / "error.txt").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_trial_that_fails_is_a_row_for_every_estimate_that_needs_it(tmp_path, monkeypatch):
    scenario, simulate = small_scenario(tmp_path, ("rigid",)), trials.simulate

    def broken(trial, settings, store):
        if type(trial.action).__name__ == "Rotate":
            raise RuntimeError("the table is gone")
        return simulate(trial, settings, store)

    monkeypatch.setattr(trials, "simulate", broken)
    rows = resumed(scenario, tmp_path / "out")
    assert len(rows) == 3
    assert set(rows["status"]) == {"failed"}
    assert all("RuntimeError: the table is gone" in message for message in rows["message"])
    (error,) = (tmp_path / "out").glob("trials/*/error.txt")
    assert "Traceback" in error.read_text(encoding="utf-8")
    monkeypatch.undo()
    assert not set(resumed(scenario, tmp_path / "out")["status"]) - {"ok", "unexplained"}
    assert not list((tmp_path / "out").rglob("error.txt"))


@pytest.mark.slow
def test_one_machine_of_a_ray_cluster_is_killed_and_the_results_are_the_same(longer, tmp_path):
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'heft-testbed[ray]'")
    cluster = pytest.importorskip("ray.cluster_utils").Cluster(
        initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False}
    )
    try:
        node = cluster.add_node(num_cpus=1)
        cluster.wait_for_nodes()
        ray.init(address=cluster.address, log_to_driver=False)
        out, killed = tmp_path / "out", []

        def progress(stage: str, done: int, total: int, failed: int = 0) -> None:
            if stage == "trials" and done >= 2 and not killed:
                killed.append(done)
                cluster.remove_node(node, allow_graceful=False)

        frame = run_scenario(load_scenario(str(longer.scenario))[1], out, 2, progress, "ray").drop(columns="seconds")
        assert killed
        pd.testing.assert_frame_equal(frame, longer.rows)
        assert_whole(out)
    finally:
        ray.shutdown()
        cluster.shutdown()


def test_a_folder_that_cannot_be_made_is_one_line(finished, capsys):
    assert "nowhere" in refusal(capsys, "run", str(finished.scenario), "--out", "/proc/nowhere", "--workers", "0")


@pytest.mark.parametrize(
    ("objects", "error", "message"),
    [
        (["heavy.toml"], InfeasibleTrialError, r"heavy: the bench cannot turn (.|\n)*A1: grip: "),
        (["I1", "Q9"], InvalidValueError, "allowed: one of F1"),
    ],
)
def test_an_unusable_object_is_refused_before_anything_is_written(tmp_path, monkeypatch, objects, error, message):
    monkeypatch.chdir(tmp_path)
    Path("heavy.toml").write_text('name = "heavy"\n[blocks]\nlayout = ["111"]\nmass_kg = 9.0\n')
    with pytest.raises(error, match=message):
        run_scenario(Scenario(objects=objects), tmp_path / "out", 0, quiet)
    assert not (tmp_path / "out").exists()


def test_an_object_that_the_scale_does_not_show_is_left_out_alone(tmp_path: Path):
    (feather := tmp_path / "feather.toml").write_text('name = "feather"\n[blocks]\nlayout = ["11"]\nmass_kg = 5e-5\n')
    scenario = Scenario(objects=[str(feather), "I1"], sensing=["ft300s"])
    kept, left_out = experiments_of(scenario, Store(tmp_path / "out"), quiet)
    assert {each.model.name for each in kept} == {"I1"}
    assert {each.name for each in left_out} == {"feather"}
    assert "the scale reads" in left_out[0].reason and "error of 1 g" in left_out[0].reason


@pytest.mark.slow
def test_a_missing_recording_is_reported_and_the_report_is_kept(copied, monkeypatch):
    def refused(*_: object) -> None:
        raise InvalidValueError("key", "0", "an estimate")

    monkeypatch.setattr(views, "record_worst", refused)
    rows = rows_of(pd.read_parquet(copied / "results.parquet"))
    lines = list(views.write_views(copied, rows, InlineExecutor(), recording=False))
    assert any(line.startswith("no recording: ") and "an estimate" in line for line in lines)
    assert f"report: {copied / 'report.html'}" in lines
