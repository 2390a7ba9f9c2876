"""Whatever happens to a run, the same command goes on from it, and ends with the results of an undisturbed run."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from estimators.registry import METHODS
from scenarios.cli.main import main
from scenarios.results.store import LOCK, FolderInUseError, exclusive
from tests.fakes.misbehaving import Misbehaving
from tests.helpers.sweep_kills import (
    VICTIMS,
    assert_whole,
    done_in,
    draw_killing,
    kill_a_run,
    resumed,
    small_scenario,
)

FAULTY = """
import functools, sys
import tests.fakes.misbehaving
from scenarios.study import run as sweep
from scenarios.cli.main import main
from scenarios.execution.executor import Limits, open_executor
from estimators.registry import METHODS

METHODS["misbehaving"] = tests.fakes.misbehaving.Misbehaving

if __name__ == "__main__":
    sweep.open_executor = functools.partial(open_executor, limits=Limits(timeout_s=8.0, tries=1, memory_gib=1.0))
    main(sys.argv[1:])
"""


@pytest.fixture(scope="module")
def scenario(tmp_path_factory) -> Path:
    return small_scenario(tmp_path_factory.mktemp("scenario"), ("own_weight",))


@pytest.fixture(scope="module")
def undisturbed(scenario, tmp_path_factory) -> tuple[pd.DataFrame, Path]:
    """The results and the folder of a run that nothing happened to."""
    out = tmp_path_factory.mktemp("undisturbed") / "out"
    return resumed(scenario, out), out


@pytest.fixture(scope="module")
def longer_scenario(tmp_path_factory) -> Path:
    return small_scenario(tmp_path_factory.mktemp("longer"))


@pytest.fixture(scope="module")
def longer_undisturbed(longer_scenario, tmp_path_factory) -> tuple[pd.DataFrame, Path]:
    out = tmp_path_factory.mktemp("longer_undisturbed") / "out"
    return resumed(longer_scenario, out), out


@pytest.fixture
def copied(undisturbed, tmp_path) -> Path:
    """A finished folder to damage."""
    out = tmp_path / "out"
    subprocess.run(["cp", "-a", undisturbed[1], out], check=True)
    return out


@pytest.mark.slow
@pytest.mark.parametrize("victim", ["worker", "both"])
def test_a_killed_run_goes_on(scenario, undisturbed, tmp_path, victim):
    frame, _ = undisturbed
    kill_a_run(scenario, tmp_path / "out", draw_killing(np.random.default_rng(7), victim, 4), workers=1)
    pd.testing.assert_frame_equal(resumed(scenario, tmp_path / "out"), frame)
    assert not list((tmp_path / "out").rglob("*.part"))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(8))  # `python bench/sweeps.py kills` does twenty
def test_a_run_killed_at_any_moment_goes_on(longer_scenario, longer_undisturbed, tmp_path, seed):
    frame, out = longer_undisturbed
    killing = draw_killing(np.random.default_rng(seed), VICTIMS[seed % 3], done_in(out))
    kill_a_run(longer_scenario, tmp_path / "out", killing)
    pd.testing.assert_frame_equal(resumed(longer_scenario, tmp_path / "out"), frame)
    assert not list((tmp_path / "out").rglob("*.part"))


@pytest.mark.slow
@pytest.mark.parametrize("workers", [1, 3])
def test_executors_and_numbers_of_workers_change_nothing(longer_scenario, longer_undisturbed, tmp_path, workers):
    pd.testing.assert_frame_equal(resumed(longer_scenario, tmp_path / "out", workers), longer_undisturbed[0])


def test_a_finished_run_is_read_again_without_work(scenario, undisturbed, copied):
    stamps = {path: path.stat().st_mtime_ns for kind in ("trials", "estimates") for path in copied.glob(f"{kind}/*/*")}
    pd.testing.assert_frame_equal(resumed(scenario, copied, workers=2), undisturbed[0])  # starts no worker
    assert stamps == {path: path.stat().st_mtime_ns for path in stamps}


@pytest.mark.parametrize("which", range(5))  # of a weighing, of what methods see, and of what is held out
def test_any_record_cut_short_is_made_again(scenario, undisturbed, copied, which):
    record = sorted(copied.glob("trials/*/trajectory.parquet"))[which]
    record.write_bytes(record.read_bytes()[:5000])
    (estimate := next(copied.glob("estimates/*/result.json"))).unlink()
    pd.testing.assert_frame_equal(resumed(scenario, copied), undisturbed[0])
    assert len(record.read_bytes()) > 5000 and estimate.is_file()


def test_damage_and_leftovers_are_made_good_and_nothing_else_is_touched(scenario, undisturbed, copied):
    trials, estimates = sorted(copied.glob("trials/*")), sorted(copied.glob("estimates/*"))
    record = trials[0] / "trajectory.parquet"
    record.write_bytes(record.read_bytes()[:5000])
    (trials[1] / "trial.json").unlink()
    (estimates[0] / "result.json").write_text('{"nad": 0.', encoding="utf-8")
    (estimates[1] / "result.json").write_bytes(b"\xff\x00")
    (estimates[2] / "result.json").unlink()
    leftovers = [trials[2] / ".trajectory.parquet.123.part", estimates[0] / ".result.json.9.part", copied / ".x.1.part"]
    for path in leftovers:
        path.write_bytes(b"half")
    touched = {trials[0], trials[1], *estimates[:3]}
    stamps = {p: p.stat().st_mtime_ns for p in copied.glob("[te]*s/*/*") if p.parent not in touched}
    pd.testing.assert_frame_equal(resumed(scenario, copied), undisturbed[0])
    assert not any(path.exists() for path in leftovers)
    assert all(path.stat().st_mtime_ns == stamp for path, stamp in stamps.items() if path not in leftovers)
    assert_whole(copied)


def test_a_second_run_on_the_same_folder_is_refused_in_one_line(scenario, tmp_path, capsys):
    with exclusive(tmp_path), pytest.raises(SystemExit) as exit_:
        main(["run", str(scenario), "--out", str(tmp_path), "--workers", "0"])
    assert exit_.value.code == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"another run (process {os.getpid()} on " in said


def test_a_killed_run_lets_go_of_its_folder(tmp_path):
    hold = "from pathlib import Path; from scenarios.results.store import exclusive"
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
def test_a_disk_that_takes_nothing_more_is_one_line_and_no_half_file(scenario, tmp_path, capfd, kind, message):
    """On a real file system of one size or of one mind."""
    out = tmp_path / "disk"
    out.mkdir()
    if subprocess.run(["mount", "-t", "tmpfs", "-o", "size=128k", "tmpfs", out], check=False).returncode:
        pytest.skip("mounting is not possible here")
    try:
        if kind == "read-only":
            subprocess.run(["mount", "-o", "remount,ro", out], check=True)
        with pytest.raises(SystemExit) as exit_:
            main(["run", str(scenario), "--out", str(out), "--workers", "0"])
        said = capfd.readouterr().err
        assert exit_.value.code == 2
        assert message in said
        assert said.count("\n") == 1
        assert_whole(out)
        assert not list(out.rglob("*.part"))
    finally:
        subprocess.run(["umount", out], check=True)


def test_a_disk_that_fills_up_is_an_error_and_no_half_file(scenario, tmp_path, monkeypatch):
    """As above, where mounting is not possible."""
    calls = 0

    def fsync(_: int) -> None:
        nonlocal calls
        calls += 1
        if calls > 5:
            raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "fsync", fsync)
    with pytest.raises(OSError, match="No space left"):
        resumed(scenario, tmp_path / "out")
    assert_whole(tmp_path / "out")
    assert not list((tmp_path / "out").rglob("*.part"))


def test_a_method_that_raises_or_answers_nan_is_a_row_with_its_reason(tmp_path, monkeypatch):
    monkeypatch.setitem(METHODS, "misbehaving", Misbehaving)
    ways = ("raise", "nan", "exit")
    more = "".join(f'[methods.{way}]\nmethod = "misbehaving"\nway = "{way}"\n' for way in ways)
    path = small_scenario(tmp_path, ("rigid",), more + "[methods.hidden_states]\n")
    rows = resumed(path, tmp_path / "out").set_index("method")
    assert set(rows.loc["hidden_states", "status"]) == {"ok"}
    assert set(rows.loc[[*ways], "status"]) == {"failed"}
    assert set(rows.loc["raise", "message"]) == {"RuntimeError: out of ideas"}
    assert set(rows.loc["exit", "message"]) == {"SystemExit: 3"}
    assert all("MassDistribution.mass: got '2 NaN" in message for message in rows.loc["nan", "message"])
    for key in rows.loc[[*ways], "key"]:
        assert "Traceback" in (tmp_path / "out" / "estimates" / key / "error.txt").read_text(encoding="utf-8")


@pytest.mark.slow
def test_a_method_that_hangs_crashes_or_eats_memory_is_a_row_and_the_rest_goes_on(tmp_path):
    ways = ("hang", "crash", "leave", "eat")
    more = "".join(f'[methods.{way}]\nmethod = "misbehaving"\nway = "{way}"\n' for way in ways)
    path = small_scenario(tmp_path, ("rigid",), more + "[methods.hidden_states]\n")
    (tmp_path / "faulty.py").write_text(FAULTY)
    command = [sys.executable, tmp_path / "faulty.py", "run", path, "--out", tmp_path / "out", "--workers", "2"]
    # the methods are added where the workers find them too: in the main module
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 1, done.stderr
    rows = pd.read_parquet(tmp_path / "out" / "results.parquet").set_index("method")
    assert set(rows.loc["hidden_states", "status"]) == {"ok"}
    assert set(rows.loc[[*ways], "status"]) == {"failed"}
    assert set(rows.loc["hang", "message"]) == {"took longer than 8 s (tried once)"}
    assert set(rows.loc["crash", "message"]) == {"its worker process was killed by SIGSEGV (tried once)"}
    assert all("Unable to allocate" in message for message in rows.loc["eat", "message"])
    for key in rows.loc[[*ways], "key"]:
        assert (tmp_path / "out" / "estimates" / key / "error.txt").read_text(encoding="utf-8")


def test_a_trial_that_fails_is_a_row_for_every_estimate_that_needs_it(tmp_path, monkeypatch):
    from scenarios.study import trials  # noqa: PLC0415

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
    assert set(resumed(scenario, tmp_path / "out")["status"]) == {"ok"}
    assert not list((tmp_path / "out").rglob("error.txt"))


@pytest.mark.slow
def test_one_machine_of_a_ray_cluster_is_killed_and_the_results_are_the_same(
    longer_scenario, longer_undisturbed, tmp_path
):
    ray = pytest.importorskip("ray", reason="Ray is not installed: pip install 'heft[ray]'")
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

        from scenarios.config import load_scenario  # noqa: PLC0415
        from scenarios.study.run import run_scenario  # noqa: PLC0415

        frame = run_scenario(load_scenario(str(longer_scenario))[1], out, 2, progress, "ray").drop(columns="seconds")
        assert killed
        pd.testing.assert_frame_equal(frame, longer_undisturbed[0])
        assert_whole(out)
    finally:
        ray.shutdown()
        cluster.shutdown()
