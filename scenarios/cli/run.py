"""heft run and heft status: run a scenario with a display of progress, and show the state of a results folder."""

from __future__ import annotations

import math
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro
from rich.console import Console
from rich.progress import (
    BarColumn,
    MofNCompleteColumn,
    TaskID,
    TextColumn,
    TimeElapsedColumn,
    TimeRemainingColumn,
)
from rich.progress import Progress as Bars

from scenarios.cli.terminal import open_console
from testbed.errors import HeftError, InvalidValueError

if TYPE_CHECKING:
    from estimators.evaluation.statistics import Row
    from scenarios.config import Scenario
    from scenarios.study.experiment import Progress

NOTES = (
    "Cells: mean and spread over draws of the sensor's errors, [95 % interval of the mean]. *: better than "
    "every other method in its column (paired by draw, p < 0.05). No interval and no star below {fewest} draws. The "
    "paper's own figures, on its real robot, have rows of their own. The true masses predict with their true support: "
    "what is left is the error of sensor and model. _M: given M; _cov: errors weighed by their covariance."
)
OWN_ERROR = f"{HeftError.__module__}.{HeftError.__name__}: "
"""Prefix of the last line of a traceback, which adds nothing to the message."""
FRAME, SCREEN = 5, 20
"""Lines around the rows of a table, and those of a screen for all tables."""
MOST_LINES = 20
"""Number of failures that are listed; the report has them all."""
EVERY_S = 10.0
"""Time between two plain lines of progress [s]."""


def run(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    *,
    out: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    executor: Literal["inline", "local", "ray"] = "local",
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    seeds: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="OBJECT ...")] = None,
    world: Annotated[str | None, tyro.conf.arg(metavar="WORLD")] = None,
    data: Annotated[Path | None, tyro.conf.arg(metavar="DIR")] = None,
    secret: Annotated[str | None, tyro.conf.arg(metavar="TEXT")] = None,
    record: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    live: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    allow_code: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    tables: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    dry_run: bool = False,
) -> None:
    """Run a scenario: every object under every support with every method, with a table and a report.

    Ctrl-C keeps finished files; run the same command again to continue, also after kill -9.

    Examples: heft run blocks --objects L2 my/object.toml --out results/mine
              heft run my/scenario.toml --methods hidden_states explicit_state --seeds 20 --out results/tonight

    Args:
        scenario: name in the library (see heft scenarios), or path to a TOML file.
        out: results folder; default: results/<scenario>.
        executor: inline (this process), local (worker processes), or ray (extra "ray"; at RAY_ADDRESS if set).
        workers: number of worker processes; default: one per core. 0 runs everything in this process.
        methods: labels of methods in the scenario, or other methods by name or package:Class; default: all of the
            scenario.
        seeds: number of sensor-error draws per trial; default: as in the scenario.
        objects: names in the library or paths to TOML files; default: as in the scenario.
        world: ideal, lab or rough; default: as in the scenario.
        data: folder of mesh files, for a scenario with [meshes] such as tools.
        secret: text that seeds all draws: the same text repeats a run. Default: random. It is stored in
            DIR/manifest.json and hidden from every method.
        record: write a recording of every trial and estimate to DIR/recordings during the run.
        live: show every trial and estimate in a running or new viewer during the run.
        allow_code: allow the scenario to load classes from the current folder; --methods needs no permission.
        tables: print every table of the report, not only the main one.
        dry_run: print the number of trials and estimates and the expected time, and run nothing.
    """
    from scenarios.config import load_scenario
    from scenarios.execution.executor import default_workers
    from scenarios.results.files import read_manifest, tally, write_json
    from scenarios.results.table import rows_of
    from scenarios.study.dry_run import show_dry_run
    from scenarios.study.meshes import with_meshes
    from scenarios.study.run import carry_out, check_nothing_lost, command_words
    from scenarios.views.finished import write_views
    from scenarios.views.pages import Recorder, record_all
    from testbed.plugins import find_code_here
    from viz.recordings import viewer

    if allow_code or any(":" in method for method in methods or ()):
        find_code_here()
    name, study = load_scenario(scenario)
    folder = out or Path("results") / name
    workers = default_workers() if workers is None else workers
    if workers < 0:
        raise InvalidValueError("--workers", workers, "an integer >= 0")
    console = open_console()
    with TemporaryDirectory(prefix="heft-") if dry_run else nullcontext(folder) as place:
        with show_progress() as progress:
            study, lines = with_meshes(study.changed(seeds, objects, methods, world), data, Path(place), progress)
        print("".join(f"{line}\n" for line in lines).replace(str(place), str(folder)), end="")
        check_nothing_lost(folder, study, secret)
        if dry_run:
            show_dry_run(console, study, folder, workers)
            return
    recorder = Recorder(folder, record, viewer.open_viewer() if live else None) if record or live else None
    begin = time.monotonic()
    views = (write_views.__module__,)  # imported while the first trials are planned, not after the last estimate
    with ExitStack() as stack:
        with show_progress() as progress:
            table, tasks = stack.enter_context(
                carry_out(study, folder, workers, progress, executor, recorder, views, secret)
            )
        results = rows_of(table)
        given = {
            "seeds": seeds,
            "objects": objects or None,
            "methods": methods or None,
            "world": world,
            "data": data,
            "out": out,
            "secret": secret,
            "allow_code": allow_code,
        }
        facts = {
            "name": name,
            "command": shlex.join(command_words("heft", "run", scenario, **given)),
            "wall_s": round(time.monotonic() - begin, 1),
        }
        write_json(folder / "manifest.json", (read_manifest(folder) or {}) | facts)
        (show_tables if tables else show_main_table)(console, study, results)
        if record:
            with show_progress() as progress:
                record_all(folder, progress)
        good = say_failures(folder, results)
        for line in write_views(folder, results, tasks, recording=not _many(results)):
            if not line.startswith("figure: "):
                print(line, flush=True)
    amiss = tally(row["status"] for row in results)
    reasons = f" ({amiss}: report.html has the reasons)" if amiss else ""
    print(f"{len(results)} estimates in {time.monotonic() - begin:.0f} s{reasons}; results in {folder}/")
    print(f"view: heft view {folder}")
    if not good:
        sys.exit(1)


def say_failures(folder: Path, results: Sequence[Row]) -> bool:
    """Print the estimates without masses, by method and reason; return True if none of them is a failure.

    An estimate without data, as of an object that slips in all trials, is no failure if the method answers elsewhere.
    """
    from estimators.base import NO_MASSES
    from scenarios.results.estimates import load_tracebacks
    from viz.report.lists import failures

    empty = [row for row in results if row.get("mass_kg") is None and row["status"] not in NO_MASSES]
    for failure in failures(empty, load_tracebacks(folder))[:MOST_LINES]:
        print(failure.line)
        if failure.path:
            print(f"  traceback: {folder / failure.path}")
    answering = {row["method"] for row in results if row.get("mass_kg") is not None}
    return all(row["status"] == "no_data" and row["method"] in answering for row in empty)


def show_main_table(console: Console, scenario: Scenario, results: Sequence[Row]) -> None:
    """Print the NAD by object where that fits on a screen, otherwise its median over objects."""
    from estimators.evaluation.statistics import FEWEST
    from viz.report.tables import NAD, metric_table, overview, points_of
    from viz.report.terminal import fits, rich_table

    each = [] if _many(results) else _settings(scenario, results)
    tables = [metric_table(rows, NAD, f"{NAD.title}: {setting}") for setting, rows in each]
    drawn = any(cell.interval for table in tables for _, cells in table.rows for cell in cells)
    whole = all(fits(table, console) for table in tables)
    if not (tables and whole) or sum(FRAME + (1 + drawn) * len(table.rows) for table in tables) > SCREEN:
        tables, drawn = [overview(points_of([row for row in results if row["method"]]))], False
    for table in tables:
        console.print(rich_table(table))
    if drawn:
        console.print(NOTES.format(fewest=FEWEST))


def _settings(scenario: Scenario, results: Sequence[Row]) -> list[tuple[str, Sequence[Row]]]:
    """Name and rows of each pair of support and sensing."""
    from estimators.evaluation.statistics import select
    from viz.values import support_name

    return [
        (f"{support_name(support.name)}, {sensing}", select(results, support=support.name, sensing=sensing))
        for support in scenario.supports()
        for sensing in scenario.sensing
    ]


def show_tables(console: Console, scenario: Scenario, results: Sequence[Row]) -> None:
    """Print every metric under every support and sensing, and the hidden states; of many objects, quantiles."""
    from estimators.evaluation.statistics import FEWEST, assumptions
    from viz.report.tables import (
        CLAIMS,
        COM,
        INERTIA,
        NAD,
        claims_table,
        hidden_table,
        metric_table,
        metrics_of,
        quantile_table,
    )
    from viz.report.terminal import rich_table

    objects = list(dict.fromkeys(row["object"] for row in results))
    metrics = metrics_of(results) or [NAD]  # the statuses then
    if _many(results):
        for metric in metrics:
            console.print(rich_table(quantile_table(results, metric)))
        for metric in (COM, INERTIA):
            if known := [row for row in results if math.isfinite(row.get(metric.column) or math.nan)]:
                console.print(rich_table(quantile_table(known, metric)))
        return
    for setting, rows in _settings(scenario, results):
        for metric in metrics:
            console.print(rich_table(metric_table(rows, metric, f"{metric.title}: {setting}", objects)))
        if claims := claims_table(rows, f"{CLAIMS}: {setting}"):
            console.print(rich_table(claims))
    console.print(NOTES.format(fewest=FEWEST))
    for line in assumptions(results):
        console.print(line)
    hidden = hidden_table(results, objects)
    if hidden.rows:
        console.print(rich_table(hidden))


def _many(results: Sequence[Row]) -> bool:
    """True if there are swept axes, or too many objects for a column each: quantiles are printed then."""
    from estimators.evaluation.statistics import axes_of
    from viz.report.tables import MOST_OBJECTS

    return bool(axes_of(results)) or len({row["object"] for row in results}) > MOST_OBJECTS


def status(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Show the progress of a results folder: finished trials and estimates, those that are not ok, and failures.

    Args:
        folder: results folder of a finished, running or stopped run.
    """
    from scenarios.results.files import STAGES, errors_left, is_held, read_manifest, stored, tally
    from testbed.files import unless_damaged

    if not (folder / "manifest.json").is_file():
        allowed = "a folder with a manifest.json, as `heft run` and `heft estimate` make it"
        raise InvalidValueError("DIR", folder, allowed)
    manifest = unless_damaged(lambda: read_manifest(folder), "rewritten by the same command") or {}
    expected, failed, counts = manifest.get("expected") or {}, [], []
    for stage in STAGES:
        found = [content or {} for _, content in stored(folder, stage, "of unknown status")]
        errors = errors_left(folder, stage)
        amiss = tally(str(each.get("status", "ok")) for each in found)
        listed = f" ({amiss})" if amiss else ""
        total = expected.get(stage) or 0
        more = f" of about {total}" if total > len(found) else ""
        counts.append(f"{stage}: {len(found)} done{more}{listed}, {len(errors)} failed")
        failed = [*errors, *failed]
    print(f"{folder}: {_state(manifest, running=is_held(folder))}")
    print("; ".join(counts))
    for error in failed[:MOST_LINES]:
        lines = error.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        print(f"{error}: {lines[-1].removeprefix(OWN_ERROR) if lines else 'no reason given'}")


def _state(manifest: dict[str, Any], *, running: bool) -> str:
    """State of the last run of a folder in words, by its manifest."""
    if running:
        return "a run is writing here now"
    if "finished" not in manifest:  # of an earlier version
        return "nothing is running here"
    return "finished" if manifest["finished"] else "stopped early; run the same command again to continue"


@contextmanager
def show_progress() -> Iterator[Progress]:
    """Show the progress of a run, its throughput and the time left."""
    console = open_console()
    if console.is_terminal:
        with Bars(
            TextColumn("{task.description:<10}"),
            BarColumn(),
            MofNCompleteColumn(),
            TextColumn("{task.fields[rate]}"),
            TimeElapsedColumn(),
            TimeRemainingColumn(),
            TextColumn("{task.fields[failed]}", style="red"),
            console=console,
            transient=True,
        ) as bars:
            yield _Bars(bars)
    else:
        yield _Lines()


class _Stages:
    """Start and first count of each stage: results of an earlier run do not count as throughput."""

    def __init__(self) -> None:
        self._begun: dict[str, tuple[float, int]] = {}

    def rate(self, stage: str, done: int) -> float:
        """Number done per second since the stage began; 0 during its first half second."""
        since, first = self._begun.setdefault(stage, (time.monotonic(), done))
        seconds = time.monotonic() - since
        return (done - first) / seconds if seconds > 0.5 else 0.0


class _Bars:
    def __init__(self, bars: Bars):
        self._bars, self._stages = bars, _Stages()
        self._tasks: dict[str, TaskID] = {}

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        speed, lost = f"{rate:.1f}/s" if rate else "", f"{failed} failed" if failed else ""
        if stage not in self._tasks:
            self._tasks[stage] = self._bars.add_task(stage, total=total, rate=speed, failed=lost)
        self._bars.update(self._tasks[stage], completed=done, total=total, rate=speed, failed=lost)


class _Lines:
    def __init__(self) -> None:
        self._stages = _Stages()
        self._printed: dict[str, tuple[float, str]] = {}

    def __call__(self, stage: str, done: int, total: int, failed: int = 0) -> None:
        rate = self._stages.rate(stage, done)
        since, last = self._printed.get(stage, (0.0, ""))
        if time.monotonic() - since < EVERY_S and done != total:
            return
        parts = [f"{stage}: {done} of {'' if done == total else 'about '}{total}"]
        if rate and done != total:
            parts += [f"{rate:.1f}/s", f"about {(total - done) / rate:.0f} s left"]
        if failed:
            parts.append(f"{failed} failed")
        line = ", ".join(parts)
        self._printed[stage] = time.monotonic(), line
        if line != last:
            print(line, flush=True)
