"""Scenario runs: resumed, shared between workers, and refused with reasons."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from scenarios.cli.main import main
from scenarios.config import Scenario, load_scenario, scenario_names
from scenarios.study.run import run_scenario
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.toml import InvalidFileError

OBJECT = """
name = "pair"
[blocks]
layout = ["11"]
mass_kg = [0.3, 0.2]
"""
SCENARIO = """
objects = ["{folder}/pair.toml"]
sensing = ["ideal", "ft300s"]
seeds = 2
[policy]
pivots = 2
duration = 2.0
accelerated = 0
"""


@pytest.fixture
def scenario(tmp_path: Path) -> Path:
    (tmp_path / "pair.toml").write_text(OBJECT)
    path = tmp_path / "small.toml"
    path.write_text(SCENARIO.format(folder=tmp_path))
    return path


def quiet(stage: str, done: int, total: int, failed: int = 0) -> None:
    """No progress."""


def run(path: Path, out: Path, workers: int = 0) -> pd.DataFrame:
    return run_scenario(load_scenario(str(path))[1], out, workers, quiet).drop(columns="seconds")


def test_a_scenario_runs_and_goes_on_from_what_is_there(scenario, tmp_path):
    out = tmp_path / "out"
    first = run(scenario, out)
    assert len(first) == 3
    assert set(first["status"]) == {"ok"}
    assert first["nad"].tolist()[0] < 0.02
    stamps = {path: path.stat().st_mtime_ns for path in out.glob("trials/*/*")}
    victim, other = sorted(out.glob("trials/*"))[:2]
    (victim / "trajectory.parquet").write_bytes(b"half a file")
    (other / "trial.json").unlink()
    for path in out.glob("estimates/*/result.json"):
        path.unlink()
    pd.testing.assert_frame_equal(run(scenario, out), first)
    kept = [path for path in out.glob("trials/*/*") if path.parent not in (victim, other)]
    assert kept
    assert all(path.stat().st_mtime_ns == stamps[path] for path in kept)
    assert not list(out.rglob("*.part"))


@pytest.mark.slow
def test_workers_change_nothing(scenario, tmp_path):
    pd.testing.assert_frame_equal(run(scenario, tmp_path / "a"), run(scenario, tmp_path / "b", workers=2))


@pytest.mark.slow
def test_ctrl_c_leaves_whole_files_and_the_next_run_goes_on(scenario, tmp_path):
    out = tmp_path / "out"
    command = [sys.executable, "-m", "scenarios", "run", str(scenario), "--out", str(out), "--workers", "2"]
    process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
    deadline = time.monotonic() + 60
    while not list(out.glob("trials/*/trial.json")) and time.monotonic() < deadline:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)
    _, said = process.communicate(timeout=60)
    assert process.returncode == 130, said
    assert b"goes on from here" in said
    assert b"Traceback" not in said
    assert not list(out.rglob("*.part"))
    for path in out.rglob("*.json"):
        json.loads(path.read_text())
    pd.testing.assert_frame_equal(run(scenario, out), run(scenario, tmp_path / "undisturbed"))


@pytest.mark.parametrize("name", scenario_names())
def test_the_librarys_scenarios_are_valid(name):
    load_scenario(name)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ('sensing = ["best"]', r"sensing.*got 'best'; allowed: one of ideal, ft300s"),
        ('support = ["soft"]', r"support.*got 'soft'; allowed: .*rigid"),
        ("seeds = 0", r"seeds: got 0; allowed: greater than or equal to 1"),
        ("colour = 1", r"colour: no such field"),
        ("[methods.magic]", r"methods: got 'magic'; allowed: one of hidden_states"),
        ("[methods.hidden_states]\nsteps = 0", r"steps: got 0; allowed: an integer >= 1"),
        ("[methods.hidden_states]\nspeed = 1", r"got 'speed'; allowed: settings method, .*solver"),
        ("[policy]\npivots = 0", r"policy.pivots: got 0"),
        ("[grid]\nfeet = 0", r"grid.feet: got 0"),
    ],
)
def test_a_wrong_scenario_is_refused_with_its_field(tmp_path, change, message):
    path = tmp_path / "wrong.toml"
    path.write_text(f'objects = ["I1"]\n{change}\n')
    with pytest.raises(InvalidFileError, match=message) as error:
        load_scenario(str(path))
    assert str(path) in str(error.value)


def test_a_method_that_raises_is_a_row_and_the_rest_goes_on(scenario, tmp_path, monkeypatch):
    def broken(*_: object, **__: object) -> None:
        raise RuntimeError("out of ideas")

    monkeypatch.setattr("estimators.hidden_states.estimator.observe", broken)
    out = tmp_path / "out"
    rows = run_scenario(load_scenario(str(scenario))[1], out, 0, quiet)
    assert set(rows["status"]) == {"failed"}
    assert rows["message"].tolist()[0] == "RuntimeError: out of ideas"
    assert "Traceback" in next(out.glob("estimates/*/error.txt")).read_text()
    monkeypatch.undo()
    assert set(run(scenario, out)["status"]) == {"ok"}


def test_a_folder_that_cannot_be_written_is_one_line(scenario, capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["run", str(scenario), "--out", "/proc/nowhere", "--workers", "0"])
    assert exit_.value.code == 2
    assert "nowhere" in capsys.readouterr().err


def test_unknown_names_are_refused_with_the_nearest(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["run", "block"])
    assert exit_.value.code == 2
    assert "nearest: blocks" in capsys.readouterr().err


def test_an_object_beyond_the_bench_is_refused_before_anything_is_written(tmp_path):
    heavy = tmp_path / "heavy.toml"
    heavy.write_text('name = "heavy"\n[blocks]\nlayout = ["111"]\nmass_kg = 9.0\n')
    with pytest.raises(InfeasibleTrialError, match=r"heavy: the bench cannot turn (.|\n)*A1: grip: "):
        run_scenario(Scenario(objects=[str(heavy)]), tmp_path / "out", 0, quiet)
    assert not (tmp_path / "out").exists()


def test_an_unknown_object_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(InvalidValueError, match="allowed: one of F1"):
        run_scenario(Scenario(objects=["I1", "Q9"]), tmp_path / "out", 0, quiet)
    assert not (tmp_path / "out").exists()


def test_help_teaches(capsys):
    with pytest.raises(SystemExit) as exit_:
        main(["run", "--help"])
    assert exit_.value.code == 0
    said = capsys.readouterr().out
    assert "Ctrl-C leaves whole files" in said
    assert "--workers" in said


def test_one_method_runs_under_two_labels(scenario, tmp_path):
    text = scenario.read_text() + '[methods.bare]\nmethod = "random_search"\n[methods.told]\nmethod = "random_search"\n'
    scenario.write_text(text + "use_weight = true\niterations = 20\n")
    results = run(scenario, tmp_path / "out")
    assert set(zip(results["method"], results["kind"], strict=True)) == {
        ("bare", "random_search"),
        ("told", "random_search"),
    }
    told = results[results["method"] == "told"].iloc[0]
    assert sum(told["mass_kg"]) == pytest.approx(told["weight_kg"])
    arrays = np.load(
        next(p for p in (tmp_path / "out").glob("estimates/*/estimate.npz") if len(np.load(p)["random.loss"]) == 20)
    )
    assert arrays["random.mass"].shape == (20, 2)
    assert (np.diff(arrays["random.loss"]) <= 0).all()
    assert {"mpd_open_loop_m", "mpd_turn_m"} <= set(results.columns)
    assert max(results["mpd_turn_of_truth_m"]) < 0.02
