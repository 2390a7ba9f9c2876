"""`heft run`: progress while it runs, tables, figures and a report when it is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from estimators.evaluation.statistics import Row, axes_of, select
from estimators.registry import build_method, is_method
from scenarios.cli.progress import show_progress
from scenarios.cli.report import figures, report
from scenarios.cli.view import Recorder, record_all, record_results, record_worst
from scenarios.config import Scenario, load_scenario
from scenarios.execution.executor import default_workers
from scenarios.results.store import read_json, rows_of, write_json
from scenarios.study.dry_run import show_plan
from scenarios.study.run import run_scenario
from testbed.errors import HeftError, InvalidValueError
from testbed.plugins import nearest
from viz.recordings import viewer
from viz.report.tables import METRICS, hidden_table, metric_table, quantile_table
from viz.report.terminal import rich_table
from viz.values import support_name

NOTES = (
    "Cells: mean and spread over draws of the sensor's errors, [95 % bootstrap interval of the mean], and the paper's "
    "figure on the real robot. *: better than every other method in its column (paired by draw, p < 0.05). "
    "_M: given M; _cov: errors weighed by their covariance."
)
MOST_OBJECTS = 12
"""More objects than this are told by their quantiles."""
MOST_LINES = 20
"""Failures that are listed; the report has them all."""


@dataclass(frozen=True)
class Asked:
    """What the command line asks for beyond the scenario."""

    out: Path | None = None
    workers: int | None = None
    executor: str = "local"
    seeds: int | None = None
    objects: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    dry_run: bool = False
    record: bool = False
    live: bool = False


def run_and_show(name_or_path: str, asked: Asked) -> None:
    """Run a scenario and print its tables; exit code 1 where there is an estimate without an answer."""
    name, scenario = load_scenario(name_or_path)
    scenario = changed(scenario, asked)
    workers = default_workers() if asked.workers is None else asked.workers
    if workers < 0:
        raise InvalidValueError("--workers", workers, "an integer >= 0")
    folder = asked.out or Path("results") / name
    console = Console() if sys.stdout.isatty() else Console(width=120)
    if asked.dry_run:
        show_plan(console, scenario, folder, workers)
        return
    url = viewer.waiting() if asked.live else None
    seen = Recorder(folder, console, asked.record, url) if asked.record or asked.live else None
    begin = time.monotonic()
    with show_progress(console) as told:
        results = rows_of(run_scenario(scenario, folder, workers, told, asked.executor, seen))
    said = {"name": name, "command": _command(name_or_path, asked), "wall_s": round(time.monotonic() - begin, 1)}
    write_json(folder / "manifest.json", (read_json(folder / "manifest.json") or {}) | said)
    show_tables(console, scenario, results)
    for figure in figures(folder):
        if figure.suffix == ".pdf":
            console.print(f"figure: {figure}", highlight=False, soft_wrap=True)
    if asked.record:
        record_all(folder, console)
    try:
        record_worst(folder, results)
        if not _many(results):
            console.print(f"recording: {record_results(folder)}", highlight=False, soft_wrap=True)
    except HeftError as error:  # nothing to be seen takes the tables away
        console.print(f"no recording: {error}", highlight=False, soft_wrap=True)
    console.print(f"report: {report(folder)}", highlight=False, soft_wrap=True)
    failed = [row for row in results if row["status"] != "ok"]
    for line in list(_told(failed))[:MOST_LINES]:
        console.print(line, highlight=False, soft_wrap=True)
    took = f"{len(results)} estimates in {time.monotonic() - begin:.0f} s"
    console.print(f"{took}, {len(failed)} not ok; all of it in {folder}/", highlight=False, soft_wrap=True)
    if any(row.get("mass_kg") is None for row in failed):
        sys.exit(1)


def show_tables(console: Console, scenario: Scenario, results: Sequence[Row]) -> None:
    """Every metric under every support and sensing, and the hidden states; quantiles where there are many objects."""
    objects = list(dict.fromkeys(row["object"] for row in results))
    metrics = [metric for metric in METRICS if any(row.get(metric.column) is not None for row in results)]
    if _many(results):
        for metric in metrics:
            console.print(rich_table(quantile_table(results, metric)))
        return
    for support in scenario.supports():
        for sensing in scenario.sensing:
            rows = select(results, support=support.name, sensing=sensing)
            for metric in metrics:
                title = f"{metric.title}: {support_name(support.name)}, {sensing}"
                console.print(rich_table(metric_table(rows, metric, title, objects)))
    console.print(NOTES, highlight=False)
    console.print(rich_table(hidden_table(results, objects)))


def _command(name_or_path: str, asked: Asked) -> str:
    """What runs this again."""
    parts = ["heft run", name_or_path]
    for flag, value in (("seeds", asked.seeds), ("objects", asked.objects), ("methods", asked.methods)):
        if value:
            parts += [f"--{flag}", *([str(value)] if isinstance(value, int) else value)]
    return " ".join(parts)


def _many(results: Sequence[Row]) -> bool:
    """Whether there is too much for a column an object."""
    return bool(axes_of(results)) or len({row["object"] for row in results}) > MOST_OBJECTS


def _told(failed: Sequence[Row]) -> dict[str, None]:
    """A line for each kind of failure."""
    return dict.fromkeys(
        ", ".join(part for part in (row["object"], row["support"], row["method"]) if part)
        + f": {row['status']}: {row.get('message') or ''}"
        for row in failed
    )


def changed(scenario: Scenario, asked: Asked) -> Scenario:
    """The scenario with the command line's changes."""
    if asked.seeds is not None and asked.seeds < 1:
        raise InvalidValueError("--seeds", asked.seeds, "an integer >= 1")
    changes: dict[str, object] = {}
    if asked.seeds is not None:
        changes["seeds"] = asked.seeds
    if asked.objects:
        changes |= {"objects": list(asked.objects), "random": []}
    if asked.methods:
        known = scenario.methods
        if unknown := [label for label in asked.methods if not (label in known or is_method(label))]:
            allowed = f"some of the scenario's {', '.join(known)}{nearest(unknown[0], known)}; or any other method"
            raise InvalidValueError("--methods", " ".join(unknown), f"{allowed} by name or package:Class")
        changes["methods"] = {label: known.get(label, {}) for label in asked.methods}
        for label in asked.methods:
            build_method(label, known.get(label, {}))
    return scenario.model_copy(update=changes)
