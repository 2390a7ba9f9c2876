"""`heft run`: progress while it runs, tables when it is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn, TimeRemainingColumn

from scenarios.comparison import Row, select
from scenarios.execution import default_workers
from scenarios.schema import Scenario, load_scenario
from scenarios.store import rows_of
from scenarios.sweep import run_scenario
from scenarios.tables import METRICS, SUPPORT_NAMES, hidden_table, metric_table
from testbed.errors import InvalidValueError
from testbed.object_files import load_object
from testbed.objects import ObjectShape
from viz.heatmap import absolute_difference, save_figure

NOTES = (
    "Cells: mean and spread over draws of the sensor's errors, [95 % bootstrap interval of the mean], and the paper's "
    "figure on the real robot. *: better than every other method in its column (paired by draw, p < 0.05). _M: given M."
)


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
        results = rows_of(run_scenario(scenario, folder, count, show))
    shapes = {model.name: model.shape for model in (load_object(o) for o in scenario.objects)}
    show_tables(console, scenario, results, list(shapes))
    figures = save_figures(scenario, results, shapes, folder)
    console.print(f"figures: {', '.join(figures)}", highlight=False)
    failed = [row for row in results if row["status"] != "ok"]
    for line in dict.fromkeys(
        f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row['message']}" for row in failed
    ):
        console.print(line, highlight=False)
    console.print(
        f"{len(results)} estimates in {time.monotonic() - begin:.0f} s; all of it in {folder}/", highlight=False
    )
    if failed:
        sys.exit(1)


def show_tables(console: Console, scenario: Scenario, results: Sequence[Row], objects: list[str]) -> None:
    """Every metric under every support and sensing, and the hidden states."""
    for support in scenario.supports():
        for sensing in scenario.sensing:
            for metric in METRICS:
                if any(row.get(metric.column) is not None for row in results):
                    console.print(metric_table(results, metric, support.name, sensing, objects))
    console.print(NOTES, highlight=False)
    console.print(hidden_table(results, objects))


def save_figures(scenario: Scenario, results: Sequence[Row], shapes: dict[str, ObjectShape], folder: Path) -> list[str]:
    """The heatmap of every support and sensing; paths without suffix."""
    saved = []
    for support in scenario.supports():
        for sensing in scenario.sensing:
            name = f"absolute_difference_{support.name}_{sensing}".replace(" ", "_").replace("/", "_per_")
            rows = select(results, support=support.name, sensing=sensing)
            title = f"{SUPPORT_NAMES.get(support.name, support.name)}, {sensing}"
            save_figure(absolute_difference(rows, shapes, title), folder / "figures" / name)
            saved.append(f"{folder / 'figures' / name}.pdf")
    return saved


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
