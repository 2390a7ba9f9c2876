"""A small sweep that is killed after a number of files, and the checks of its files afterwards."""

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd

from scenarios import load_scenario, run_scenario
from testbed.trajectory import load_trajectory

Victim = Literal["worker", "driver", "both"]
OBJECT = """
name = "pair"
[blocks]
layout = ["11"]
mass_kg = [0.3, 0.2]
"""
SCENARIO = """
objects = ["{folder}/pair.toml"]
support = {support}
sensing = ["ideal", "ft300s"]
seeds = 2
simulation = {{ grip = "weld", timestep_s = 0.002 }}
grid = {{ feet = 2, particles = 2 }}
[policy]
pivots = 2
duration = 2.0
accelerated = 0
"""


def small_scenario(folder: Path, support: tuple[str, ...] = ("own_weight", "rigid"), more: str = "") -> Path:
    """The file of a sweep of a few seconds: three trials for each support."""
    (folder / "pair.toml").write_text(OBJECT, encoding="utf-8")
    path = folder / "small.toml"
    path.write_text(SCENARIO.format(folder=folder, support=json.dumps(support)) + more, encoding="utf-8")
    return path


def quiet(stage: str, done: int, total: int, failed: int = 0) -> None:
    """No progress."""


def resumed(scenario: Path, out: Path, workers: int = 0, executor: str = "local") -> pd.DataFrame:
    """The results of a run in this process, without wall times."""
    frame = run_scenario(load_scenario(str(scenario))[1], out, workers, quiet, executor, secret="tests")
    return frame.drop(columns="seconds", errors="ignore")


@dataclass(frozen=True)
class Killing:
    """Victim and moment of a killing."""

    victim: Victim
    files: int
    """Number of finished trials and estimates to wait for."""
    delay_s: float
    """Time from then to the killing [s]."""
    which: int
    """Index of the killed worker, modulo the number of workers."""


def done_in(out: Path) -> int:
    """Number of finished trials and estimates."""
    return len([*out.glob("trials/*/trial.json"), *out.glob("estimates/*/result.json")])


def children_of(parent: int) -> dict[int, str]:
    """Process and command line of every child."""
    found = {}
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(fields[1]) == parent:
                found[int(folder.name)] = (folder / "cmdline").read_text().replace("\0", " ")
        except OSError:
            continue
    return found


def workers_of(parent: int) -> list[int]:
    """Its worker processes."""
    return [pid for pid, command in sorted(children_of(parent).items()) if "spawn_main" in command]


def alive(pid: int) -> bool:
    """True if a process exists and is no zombie."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def kill_a_run(scenario: Path, out: Path, killing: Killing, workers: int = 2) -> str:
    """Start a run and kill its driver, a worker, or both; returns a line about its end.

    Raises:
        AssertionError: a worker outlives its driver, a driver does not survive its worker, or a file is incomplete.
    """
    run = f"from tests.helpers.runs import *; resumed(Path({str(scenario)!r}), Path({str(out)!r}), {workers})"
    command = [sys.executable, "-c", run]
    with open(out.with_suffix(".log"), "w", encoding="utf-8") as log:
        driver = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT)
    deadline = time.monotonic() + 120
    while driver.poll() is None and done_in(out) < killing.files and time.monotonic() < deadline:
        time.sleep(0.01)
    time.sleep(killing.delay_s)
    children, running = [*children_of(driver.pid)], workers_of(driver.pid)
    at = done_in(out)
    if running and killing.victim != "driver":
        os.kill(running[killing.which % len(running)], signal.SIGKILL)
    if killing.victim != "worker":
        driver.kill()
    code = driver.wait(timeout=120)
    said = out.with_suffix(".log").read_text(encoding="utf-8")
    assert "Traceback" not in said, said
    if killing.victim == "worker":
        assert code == 0, said
    until = time.monotonic() + 10
    while any(alive(pid) for pid in children) and time.monotonic() < until:
        time.sleep(0.05)
    left = [pid for pid in children if alive(pid)]
    assert not left, f"processes left behind: {left}"
    assert_whole(out)
    ended = "no worker" if not running else f"code {code}"
    return f"killed {killing.victim:<6} with {at:2d} done ({len(running)} workers): {ended}, {done_in(out):2d} done"


def assert_whole(out: Path) -> None:
    """Check that every finished file can be read."""
    for path in out.rglob("*.json"):
        json.loads(path.read_text(encoding="utf-8"))
    for path in out.glob("trials/*/trajectory.parquet"):
        load_trajectory(path)
    for path in out.glob("estimates/*/estimate.npz"):
        with np.load(path) as arrays:
            assert all(arrays[name] is not None for name in arrays)
