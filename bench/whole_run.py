"""Core-seconds of a whole `heft run`, by part: python bench/whole_run.py [arguments of heft run; blocks --seeds 2]."""

from __future__ import annotations

import resource
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from metered import Metered
from rich import box
from rich.console import Console
from rich.table import Table

PARTS = {
    "_tried": "trials: planning, scene, physics, writing",
    "estimate": "estimates: sensing draws, method, prediction, writing",
    "figures": "figures",
    "record_results": "recording",
    "record_worst": "recordings of the worst",
    "report": "report",
}
"""Parts of a run by the task that a worker is given."""


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
    table = Table(box=box.SIMPLE_HEAD)
    table.add_column("part")
    table.add_column("core-seconds", justify="right")
    for name, part in PARTS.items():
        table.add_row(part, f"{seconds[name]:.1f}")
    table.add_row("start of the workers", f"{workers - sum(seconds.values()):.1f}")
    table.add_row("driver: start, objects, grasps, policy, tables", f"{driver:.1f}")
    table.add_row("whole", f"{driver + workers:.1f}")
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    after = end - max(task.end for task in tasks if task.name == "estimate")
    console = Console(width=100)
    console.print(table)
    console.print(
        f"{end - begin:.0f} s of wall time, {after:.1f} s of it after the last estimate; {peak:.0f} MiB in a worker"
    )
    console.print(f"{estimates} estimates, {estimates / seconds['estimate']:.1f} a core-second")


if __name__ == "__main__":
    main()
