"""Core-seconds of a whole `heft run`, by part: python bench/whole_run.py [arguments of heft run; blocks --seeds 2]."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from shared import head_table, show

PARTS = {
    "_tried": "trials: planning, scene, physics, writing",
    "estimate": "estimates: sensing draws, method, prediction, writing",
    "figures": "figures",
    "record_results": "recording",
    "record_worst": "recordings of the worst",
    "report": "report",
}
"""Parts of a run by the task that a worker is given."""


@dataclass(frozen=True)
class Task:
    """A task that has ended."""

    name: str
    """Name of its function."""
    cpu: float
    """Core-seconds [s]."""
    end: float
    """Time of `time.perf_counter` in the driver as it took the value [s]."""


class Metered:
    """Any executor, which adds its tasks to a list as they end."""

    def __init__(self, executor: Any):
        self._executor = executor
        self.tasks: list[Task] = []

    def __getattr__(self, name: str) -> Any:
        """Same property of the executor."""
        return getattr(self._executor, name)

    def start(self, label: Any, function: Callable[..., Any], *arguments: Any) -> None:
        """Same method of the executor."""
        self._executor.start((label, function.__name__), _timed, function, *arguments)

    def wait(self) -> tuple[Any, Any]:
        """Same method of the executor."""
        (label, name), (value, cpu) = self._executor.wait()
        self.tasks.append(Task(name, cpu, time.perf_counter()))
        return label, value


def _timed(function: Callable[..., Any], *arguments: Any) -> tuple[Any, float]:
    """Task: another task's value and core-seconds."""
    cpu = time.process_time()
    return function(*arguments), time.process_time() - cpu


def core_seconds(who: int) -> float:
    """Core-seconds of this process or of its children that have ended."""
    used = resource.getrusage(who)
    return used.ru_utime + used.ru_stime


def main() -> None:
    """Run in a folder that is thrown away, and print a table."""
    accounts: list[Metered] = []
    begin = time.perf_counter()
    from scenarios.cli.main import main as heft  # noqa: PLC0415  its start is part of the run
    from scenarios.results.estimates import load_results  # noqa: PLC0415
    from scenarios.study import run as study  # noqa: PLC0415

    before = study.open_executor

    @contextmanager
    def accounted(*arguments: Any, **settings: Any) -> Iterator[Metered]:
        with before(*arguments, **settings) as executor:
            accounts.append(Metered(executor))
            yield accounts[-1]

    study.open_executor = accounted
    with tempfile.TemporaryDirectory() as folder:
        heft(["run", *(sys.argv[1:] or ["blocks", "--seeds", "2"]), "--out", f"{folder}/out"])
        estimates = len(load_results(Path(folder) / "out"))
    end, tasks = time.perf_counter(), accounts[0].tasks
    seconds: defaultdict[str, float] = defaultdict(float)
    for task in tasks:
        seconds[task.name] += task.cpu
    driver, workers = core_seconds(resource.RUSAGE_SELF), core_seconds(resource.RUSAGE_CHILDREN)
    table = head_table("part", "core-seconds", left=("part",))
    for name, part in PARTS.items():
        table.add_row(part, f"{seconds[name]:.1f}")
    table.add_row("start of the workers", f"{workers - sum(seconds.values()):.1f}")
    table.add_row("driver: start, objects, grasps, policy, tables", f"{driver:.1f}")
    table.add_row("whole", f"{driver + workers:.1f}")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    after = end - max(task.end for task in tasks if task.name == "estimate")
    wall = f"{end - begin:.0f} s of wall time, {after:.1f} s of it after the last estimate; {peak:.0f} MiB in a worker"
    show(table, wall, f"{estimates} estimates, {estimates / seconds['estimate']:.1f} a core-second", width=100)


if __name__ == "__main__":
    main()
