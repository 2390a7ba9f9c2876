"""heft import, heft estimate: data of a real bench. Signatures alone, so that --help loads nothing heavy."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import tyro


def import_(
    mapping: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="MAPPING")],
    logs: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="[LOG ...]")] = (),
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/lab"),
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str, tyro.conf.arg(metavar="SUPPORT")] = "own_weight",
) -> None:
    """Read another bench's logs (CSV, or MCAP with JSON messages) as trials, which every method can be asked about.

    MAPPING is a TOML file that says which column is what, in which unit, and what was done: docs/formats.md has one to
    begin with. All that is wrong is told at once, and then nothing is written. A log that is imported again, by a
    corrected mapping, takes the place of its earlier import. Exit code: 1 where a trial is no data.

    Examples: heft import lab.toml turn_1.csv turn_2.csv --weight 1.8
              heft import lab.toml                 (the logs that its [[logs]] name)
              heft estimate results/lab

    Args:
        mapping: TOML file.
        logs: .csv or .mcap files, one a trial; those that the mapping names if left out.
        out: results folder to put the trials into.
        weight: mass of the object as a scale said; every method needs it once.
        support: who carries the object's weight, as far as you know: own_weight, rigid, or a stiffness in N/m.
    """
    from rich.console import Console  # noqa: PLC0415

    from scenarios.import_run import Wish, import_logs  # noqa: PLC0415

    _end(import_logs(Console(), mapping, logs, Wish(out, weight, support)))


def estimate(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    *,
    objects: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    methods: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="METHOD ...")] = None,
    scenario: Annotated[str, tyro.conf.arg(metavar="SCENARIO")] = "blocks",
    held_out: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    workers: Annotated[int | None, tyro.conf.arg(metavar="N")] = None,
) -> None:
    """Ask every method about the trials that a folder has of a real bench, and write its tables and report.

    The trials are those of heft robot trial and heft import, as they were measured: no sensor's errors are drawn. Those
    that are no data are left out. The last weighing counts. Masses in the object's file are taken for the truth: where
    they are a guess, so is the NAD, and only mass_kg of results.parquet says something.

    Exit code: 1 where some method has no answer.
    Examples: heft estimate results/robot --methods hidden_states explicit_state_M
              heft estimate results/lab --scenario my/scenario.toml --held-out 2

    Args:
        folder: results folder with measured trials.
        objects: names of the objects to ask about; all if left out.
        methods: labels of the scenario's methods, instead of all; or others: by name, or package:Class.
        scenario: whose methods, with their settings: name in the library, or path to a TOML file.
        held_out: last turns that no method is given, for the mean particle distance.
        workers: worker processes; one a core if left out, 0 runs everything in this process.
    """
    from scenarios.estimate_run import Wish, estimate_recorded  # noqa: PLC0415

    _end(estimate_recorded(folder, Wish(objects, methods, scenario, held_out, workers)))


def _end(code: int) -> None:
    """With this exit code, where it is not that of success."""
    if code:
        sys.exit(code)
