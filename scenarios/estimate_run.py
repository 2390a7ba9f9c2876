"""`heft estimate`: every method asked about the trials that a folder has of a real bench."""

from __future__ import annotations

import shlex
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from scenarios.cells import Cell
from scenarios.estimates import run_estimates
from scenarios.execution import default_workers, open_executor
from scenarios.folder_lock import exclusive
from scenarios.main_run import Asked, changed, show_tables
from scenarios.measured import Measured, measured_in
from scenarios.progress import show_progress
from scenarios.report_run import report
from scenarios.schema import Scenario, Sweep, load_scenario
from scenarios.store import Store, rows_of, write_json
from scenarios.sweep import manifest

SENSING = "as measured"
"""Name of the sensor in the results: its errors are in the records."""


@dataclass(frozen=True)
class Wish:
    """Which methods are asked about what."""

    objects: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    scenario: str = "blocks"
    held_out: int = 0
    workers: int | None = None


def estimate_recorded(folder: Path, wish: Wish) -> int:
    """Ask the methods, write results, tables and report; 0 where every method has an answer, else 1.

    Raises:
        InvalidValueError: no measured trials, no weighing, or no such object, method or scenario.
    """
    console = Console() if sys.stdout.isatty() else Console(width=120)
    methods = changed(load_scenario(wish.scenario)[1], Asked(methods=wish.methods))
    workers, begin = default_workers() if wish.workers is None else wish.workers, time.monotonic()
    found, left_out = measured_in(folder, wish.objects, wish.held_out)
    for line in left_out:
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    scenario = _of(found, methods)
    cells = [_cell(one, scenario) for one in found]
    store = Store(folder.absolute())
    with exclusive(folder), open_executor("local", workers) as tasks:
        store.remove_leftovers()
        with show_progress(console) as told:
            results = rows_of(store.put_table(run_estimates(cells, [], store, tasks, told)))
        said = {
            "name": folder.resolve().name,
            "command": _command(folder, wish),
            "wall_s": round(time.monotonic() - begin, 1),
        }
        write_json(folder / "manifest.json", manifest(scenario) | {"scenario": _shown(scenario)} | said)
    show_tables(console, scenario, results)
    console.print(f"report: {report(folder)}; heft view {folder} shows the maps", highlight=False, soft_wrap=True)
    bad = [row for row in results if row["status"] != "ok"]
    for row in bad:
        line = f"{row['object']}, {row['support']}, {row['method']}: {row['status']}: {row.get('message') or ''}"
        console.print(line, highlight=False, markup=False, soft_wrap=True)
    return int(any(row.get("mass_kg") is None for row in bad))


def _of(found: Sequence[Measured], methods: Scenario) -> Scenario:
    """A scenario of these trials: its methods asked once, with no sensor's errors drawn."""
    changes: dict[str, Any] = {
        "objects": list(dict.fromkeys(one.object.name for one in found)),
        "random": [],
        "support": list(dict.fromkeys(_in_a_file(one) for one in found)),
        "sensing": [SENSING],
        "seeds": 1,
        "sweep": Sweep(),
    }
    return methods.model_copy(update=changes)


def _in_a_file(one: Measured) -> str | float:
    """Its support as a scenario has it."""
    return one.support.stiffness if 0 < one.support.stiffness < float("inf") else one.support.name


def _cell(one: Measured, scenario: Scenario) -> Cell:
    """Its trials are made: nothing is left to a policy."""
    keys, held_out = [one.weighing, *one.moved], list(one.held_out)
    policy = scenario.policy.build((), one.object, scenario.simulation.build())
    obj = one.object
    return Cell(scenario, {}, obj, obj, one.support, (), policy, (), keys=keys, held_out_keys=held_out)


def _shown(scenario: Scenario) -> dict[str, Any]:
    """What of a scenario holds for measured trials."""
    return scenario.model_dump(include={"objects", "support", "sensing", "methods"})


def _command(folder: Path, wish: Wish) -> str:
    """What runs this again."""
    parts = ["heft", "estimate", str(folder)]
    for flag, values in (("objects", wish.objects), ("methods", wish.methods)):
        parts += [f"--{flag}", *values] if values else []
    parts += ["--scenario", wish.scenario] if wish.scenario != "blocks" else []
    return shlex.join(parts + (["--held-out", str(wish.held_out)] if wish.held_out else []))
