"""`heft run`: progress while it runs, tables when it is done."""

from __future__ import annotations

import sys
import time
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from scenarios.execution import default_workers
from scenarios.schema import Scenario, load_scenario
from scenarios.sweep import run_scenario
from scenarios.tables import hidden_table, nad_table
from testbed.errors import InvalidValueError
from testbed.object_files import load_object


def run_and_show(
    name_or_path: str, out: Path | None, worker_count: int | None, seeds: int | None, objects: tuple[str, ...] | None
) -> None:
    """Run a scenario and print its tables; exit code 1 where a trial or an estimate failed."""
    name, scenario = load_scenario(name_or_path)
    scenario = _changed(scenario, seeds, objects)
    count = default_workers() if worker_count is None else worker_count
    if count < 0:
        raise InvalidValueError("--workers", count, "an integer >= 0")
    folder = out or Path("results") / name
    console = Console() if sys.stdout.isatty() else Console(width=120)
    begin = time.monotonic()
    with _progress(console) as show:
        results = run_scenario(scenario, folder, count, show)
    labels = [load_object(o, 1).name for o in scenario.objects]
    console.print(nad_table(results, labels))
    console.print(hidden_table(results, labels))
    failed = [row for row in results.to_dict("records") if row["status"] != "ok"]
    for line in dict.fromkeys(
        f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row['message']}" for row in failed
    ):
        console.print(line, highlight=False)
    console.print(
        f"{len(results)} estimates in {time.monotonic() - begin:.0f} s; all of it in {folder}/", highlight=False
    )
    if failed:
        sys.exit(1)


def _changed(scenario: Scenario, seeds: int | None, objects: tuple[str, ...] | None) -> Scenario:
    """The scenario with the command line's changes."""
    if seeds is not None and seeds < 1:
        raise InvalidValueError("--seeds", seeds, "an integer >= 1")
    changes = {"seeds": seeds, "objects": list(objects) if objects else None}
    return scenario.model_copy(update={key: value for key, value in changes.items() if value is not None})


class _progress:
    """Bars on a terminal, a plain line now and then elsewhere."""

    def __init__(self, console: Console):
        self._console = console
        self._bars = Progress(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            console=console,
            transient=True,
        )
        self._tasks: dict[str, object] = {}
        self._said = 0.0

    def __enter__(self) -> _progress:
        if self._console.is_terminal:
            self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._bars.stop()

    def __call__(self, stage: str, done: int, total: int) -> None:
        if self._console.is_terminal:
            task = self._tasks.setdefault(
                stage, self._bars.add_task(stage, total=total) if stage not in self._tasks else None
            )
            self._bars.update(task, completed=done, total=total)  # pyright: ignore[reportArgumentType]
        elif time.monotonic() - self._said > 10 or done == total:
            self._said = time.monotonic()
            print(f"{stage}: {done} of {'' if done == total else 'about '}{total}", flush=True)
