"""heft import, heft estimate: measured trials, and what the methods say of them."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro
from rich.console import Console

if TYPE_CHECKING:
    from scenarios.results.logs import ImportedLog


def import_(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = (),
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/lab"),
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
) -> None:
    """Read another robot's logs (CSV, or MCAP with JSON messages) as trials, for every method.

    MAPPING is a TOML file that says which column is what, in which unit, and what was done: docs/formats.md has one to
    begin with. All errors are listed at once, and then nothing is written. A log that is imported again, by a
    corrected mapping, takes the place of its earlier import. Exit code: 1 where a trial is no data.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: .csv or .mcap files, one a trial; those that the mapping names if left out.
        out: results folder to put the trials into.
        weight: mass of the object as a scale read it; every method needs it once.
        support: support of the object's weight, as far as you know: own_weight, rigid, or a stiffness in N/m.
    """
    from scenarios.cli.progress import show_progress
    from scenarios.results.logs import import_logs

    console = Console()
    with show_progress(console) as progress:
        imported = import_logs(mapping, logs, out, support, weight, progress)
    for log in imported:
        console.print(_summary(log), highlight=False, markup=False, soft_wrap=True)
    bad, name = sum(not log.trajectory.ok for log in imported), imported[0].object.name
    console.print(
        f"{len(imported)} trial{'s' * (len(imported) > 1)} of {name} in {out}, {bad} of them no data; "
        f"heft estimate {out} asks every method"
        + ("" if weight is not None else f", once it knows what {name} weighs: --weight KG"),
        highlight=False,
        soft_wrap=True,
    )
    if bad:
        sys.exit(1)


def _summary(log: ImportedLog) -> str:
    """Reading of a log in words, for the operator to check."""
    from testbed.replay import Recording

    trajectory, facts = log.trajectory, log.trajectory.provenance
    why = f": {trajectory.reason}" if trajectory.reason else ""
    action = Recording(log.path, trajectory.action, log.object.name, None).description
    return (
        f"{trajectory.status:8}{log.path}: {action}: trial {log.key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {facts['phases']}; velocity {facts['velocity']}; "
        f"joints {facts['joints']}\n        drift: {facts['drift']}"
    )


def estimate(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    *,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    held_out: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Estimate from the measured trials of a folder by every method, and write its tables and report.

    The trials are those of heft robot trial and heft import, as they were measured: no sensor's errors are drawn. Those
    that are no data are left out. The last weighing counts. Masses in the object's file are taken for the truth: where
    they are a guess, so is the NAD, and only mass_kg of results.parquet says something.

    Exit code: 1 where some method has no answer.
    Examples: heft estimate results/robot --methods hidden_states explicit_state_M
              heft estimate results/lab --scenario my/scenario.toml --held-out 2

    Args:
        folder: results folder with measured trials.
        objects: names of the objects; all if left out.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        scenario: scenario of the methods and their settings: name in the library, or path to a TOML file.
        held_out: last turns that no method is given, for the mean particle distance.
        workers: worker processes; one a core if left out, 0 runs everything in this process.
    """
    from scenarios.cli.progress import show_progress
    from scenarios.cli.run import show_tables
    from scenarios.study.measured import EstimateRequest, estimate_measured
    from scenarios.views.report import report

    console = Console() if sys.stdout.isatty() else Console(width=120)
    request = EstimateRequest(objects, methods, scenario, held_out, workers)
    with show_progress(console) as progress:
        done = estimate_measured(folder, request, progress)
    for line in done.left_out:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    show_tables(console, done.scenario, done.rows)
    console.print(f"report: {report(folder)}; heft view {folder} shows the maps", highlight=False, soft_wrap=True)
    bad = [row for row in done.rows if row["status"] != "ok"]
    for row in bad:
        line = f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row.get('message') or ''}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    if any(row.get("mass_kg") is None for row in bad):
        sys.exit(1)
