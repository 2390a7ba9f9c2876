"""heft run: run a scenario, with progress while it runs, and tables, figures and a report when it is done."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro
from rich.console import Console

from testbed.errors import HeftError, InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from scenarios.config import Scenario

NOTES = (
    "Cells: mean and spread over draws of the sensor's errors, [95 % bootstrap interval of the mean], and the paper's "
    "figure on the real robot. *: better than every other method in its column (paired by draw, p < 0.05). "
    "_M: given M; _cov: errors weighed by their covariance."
)
MOST_OBJECTS = 12
"""Largest number of objects with a column each; of more, quantiles are printed."""
MOST_LINES = 20
"""Failures that are listed; the report has them all."""


def run(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    executor: Literal["inline", "local", "ray"] = "local",
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="OBJECT ...")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    live: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    dry_run: bool = False,
) -> None:
    """Run a scenario: every object under every support by every method, with tables and a report.

    Ctrl-C leaves whole files; the same command goes on from them, after kill -9 too.
    Examples: heft run blocks --objects L2 my/object.toml
              heft run my/scenario.toml --methods hidden_states explicit_state --seeds 20 --out results/tonight

    Args:
        scenario: name in the library (see heft scenarios), or path to a TOML file.
        out: folder for the results; results/<scenario> if left out.
        executor: inline (this process), local (worker processes), or ray (extra "ray"; joins a running cluster).
        workers: worker processes; one a core if left out, 0 runs everything in this process.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        seeds: sensing draws of each trial; the scenario's own number if left out.
        objects: names in the library or paths to TOML files, instead of the scenario's own.
        record: write a recording of every trial and estimate as it is done, into DIR/recordings.
        live: show every trial and estimate as it is done in an open viewer, or in a new one.
        dry_run: print how many trials and estimates there are and how long they take, and run nothing.
    """
    from scenarios.cli.progress import show_progress
    from scenarios.config import load_scenario
    from scenarios.execution.executor import default_workers
    from scenarios.results.store import read_json, rows_of, write_json
    from scenarios.study.dry_run import show_dry_run
    from scenarios.study.run import run_scenario
    from scenarios.views.figures import figures
    from scenarios.views.pages import Recorder, record_all, record_results, record_worst
    from scenarios.views.report import report
    from viz.recordings import viewer

    name, study = load_scenario(scenario)
    study = study.changed(seeds, objects, methods)
    workers = default_workers() if workers is None else workers
    if workers < 0:
        raise InvalidValueError("--workers", workers, "an integer >= 0")
    folder = out or Path("results") / name
    console = Console() if sys.stdout.isatty() else Console(width=120)
    if dry_run:
        show_dry_run(console, study, folder, workers)
        return
    url = viewer.waiting() if live else None
    recorder = Recorder(folder, console, record, url) if record or live else None
    begin = time.monotonic()
    with show_progress(console) as progress:
        results = rows_of(run_scenario(study, folder, workers, progress, executor, recorder))
    facts = {
        "name": name,
        "command": _command(scenario, seeds, objects, methods),
        "wall_s": round(time.monotonic() - begin, 1),
    }
    write_json(folder / "manifest.json", (read_json(folder / "manifest.json") or {}) | facts)
    show_tables(console, study, results)
    for figure in figures(folder):
        if figure.suffix == ".pdf":
            console.print(f"figure: {figure}", highlight=False, soft_wrap=True)
    if record:
        with show_progress(console) as progress:
            record_all(folder, console, progress)
    try:
        record_worst(folder, results)
        if not _many(results):
            console.print(f"recording: {record_results(folder)}", highlight=False, soft_wrap=True)
    except HeftError as error:  # nothing to be seen takes the tables away
        console.print(f"no recording: {error}", highlight=False, soft_wrap=True)
    console.print(f"report: {report(folder)}", highlight=False, soft_wrap=True)
    failed = [row for row in results if row["status"] != "ok"]
    for line in list(_reasons(failed))[:MOST_LINES]:
        console.print(line, highlight=False, soft_wrap=True)
    took = f"{len(results)} estimates in {time.monotonic() - begin:.0f} s"
    console.print(f"{took}, {len(failed)} not ok; all of it in {folder}/", highlight=False, soft_wrap=True)
    if any(row.get("mass_kg") is None for row in failed):
        sys.exit(1)


def show_tables(console: Console, scenario: Scenario, results: Sequence[Row]) -> None:
    """Print every metric under every support and sensing, and the hidden states; of many objects, quantiles."""
    from estimators.evaluation.statistics import select
    from viz.report.tables import METRICS, hidden_table, metric_table, quantile_table
    from viz.report.terminal import rich_table
    from viz.values import support_name

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


def _command(scenario: str, seeds: int | None, objects: Sequence[str] | None, methods: Sequence[str] | None) -> str:
    """Command line that runs this again."""
    parts = ["heft run", scenario]
    for flag, value in (("seeds", seeds), ("objects", objects), ("methods", methods)):
        if value:
            parts += [f"--{flag}", *([str(value)] if isinstance(value, int) else value)]
    return " ".join(parts)


def _many(results: Sequence[Row]) -> bool:
    """True if there are too many for a column each."""
    from estimators.evaluation.statistics import axes_of

    return bool(axes_of(results)) or len({row["object"] for row in results}) > MOST_OBJECTS


def _reasons(failed: Sequence[Row]) -> dict[str, None]:
    """A line for each kind of failure."""
    return dict.fromkeys(
        ", ".join(part for part in (row["object"], row["support"], row["method"]) if part)
        + f": {row['status']}: {row.get('message') or ''}"
        for row in failed
    )
