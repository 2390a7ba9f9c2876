"""`heft import`: logs of another bench become trials of a results folder."""

from __future__ import annotations

import hashlib
import shlex
import shutil
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from scenarios.cli.progress import show_progress
from scenarios.cli.report import report
from scenarios.cli.run import Asked, changed, show_tables
from scenarios.config import Scenario, Sweep, load_scenario
from scenarios.execution.executor import default_workers, open_executor
from scenarios.results.lock import exclusive
from scenarios.results.measured import Measured, measured_in
from scenarios.results.store import Store, key_of, object_request, read_json, rows_of, write_json
from scenarios.study.estimates import run_estimates
from scenarios.study.experiment import Cell
from scenarios.study.run import manifest
from testbed.errors import HeftError, InvalidValueError
from testbed.importers.importer import import_trajectory, object_of
from testbed.importers.logs import LogError, read_all
from testbed.importers.mapping import Mapping
from testbed.objects.files import load_toml
from testbed.objects.model import ObjectModel
from testbed.replay import Recording
from testbed.robot.runner import read_off
from testbed.trajectory import SCHEMA_VERSION, Trajectory
from testbed.trial import Support, Trial, parse_support
from testbed.validation import check_positive


@dataclass(frozen=True)
class ImportRequest:
    """Where the trials go, and what the logs do not say."""

    out: Path
    weight: float | None = None
    support: str = "own_weight"


def import_logs(console: Console, mapping: Path, logs: Sequence[Path], wish: ImportRequest) -> int:
    """Read all logs, then write all trials; 0 where every one is data, else 1.

    Raises:
        HeftError: a file is not what it should be; a line for each error of all files, and nothing is written.
    """
    asked, support = load_toml(mapping, Mapping), parse_support(wish.support)
    paths = list(dict.fromkeys(logs)) or [mapping.parent / entry.file for entry in asked.logs]
    if not paths:
        raise InvalidValueError("LOG", None, f"one .csv or .mcap file or more, or [[logs]] tables in {mapping}")
    if wish.weight is not None:
        check_positive("--weight", wish.weight)
    with show_progress(console) as progress:
        told = partial(progress, "logs", total=len(paths))
        reads = [partial(_read, path, mapping, partial(told, i + 1)) for i, path in enumerate(paths)]
        model, *trajectories = read_all(lambda: object_of(asked, mapping), *reads)
    with exclusive(wish.out):
        store = Store(wish.out.absolute())
        store.remove_leftovers()
        for path, trajectory in zip(paths, trajectories, strict=True):
            key = _stored(store, model, support, trajectory, path, asked.of(path, mapping.parent))
            console.print(_said(path, model, trajectory, key), highlight=False, markup=False, soft_wrap=True)
        if wish.weight is not None:
            _put_weight(store, model, support, wish.weight)
    bad = sum(not trajectory.ok for trajectory in trajectories)
    console.print(
        f"{len(paths)} trial{'s' * (len(paths) > 1)} of {model.name} in {wish.out}, {bad} of them no data; "
        f"heft estimate {wish.out} asks every method"
        + ("" if wish.weight is not None else f", once it knows what {model.name} weighs: --weight KG"),
        highlight=False,
        soft_wrap=True,
    )
    return int(bad > 0)


def _read(path: Path, mapping: Path, told: Callable[[], None]) -> Trajectory:
    """Every line of an error begins with the file that is wrong."""
    try:
        return import_trajectory(path, mapping)
    except HeftError as error:
        lines = str(error).splitlines()
        named = [line if Path(line.split(": ")[0]).is_file() else f"{path}: {line}" for line in lines]
        raise LogError("\n".join(named)) from None
    finally:
        told()


def _stored(
    store: Store, model: ObjectModel, support: Support, trajectory: Trajectory, path: Path, mapping: Mapping
) -> str:
    """Put a trial where simulated ones are kept, in the place of an earlier import of the same log; its key."""
    content = hashlib.sha256(path.read_bytes()).hexdigest()
    imported = {"log": path.name, "sha256": content, "mapping": mapping.model_dump(exclude_none=True)}
    asked = _asked(model, support, trajectory) | {"import": imported}
    key = key_of(asked)
    store.put_trial(key, Trial(model, trajectory.action, support), asked, trajectory)
    for said in store.root.glob("trials/*/trial.json"):
        earlier = (read_json(said) or {}).get("asked", {}).get("import", {}).get("sha256")
        if earlier == content and said.parent.name != key:
            shutil.rmtree(said.parent)
    return key


def _put_weight(store: Store, model: ObjectModel, support: Support, weight: float) -> None:
    """Keep a scale's reading (kg) as a weighing."""
    read = read_off(weight)
    read = replace(read, provenance=read.provenance | {"runner": "import"})
    asked = _asked(model, support, read) | {"weight_kg": weight}
    store.put_trial(key_of(asked), Trial(model, read.action, support), asked, read)


def _asked(model: ObjectModel, support: Support, trajectory: Trajectory) -> dict[str, Any]:
    return {
        "schema": SCHEMA_VERSION,
        "object": object_request(model),
        "action": trajectory.action.to_dict(),
        "support": support.name,
    }


def _said(path: Path, model: ObjectModel, trajectory: Trajectory, key: str) -> str:
    """What a log was taken for, to be held against what one knows of it."""
    why, said = f": {trajectory.reason}" if trajectory.reason else "", trajectory.provenance
    done = Recording(path, trajectory.action, model.name, None).said
    return (
        f"{trajectory.status:8}{path}: {done}: trial {key[:8]}{why}\n"
        f"        {trajectory.time_s[-1]:.1f} s; phases {said['phases']}; velocity {said['velocity']}; "
        f"joints {said['joints']}\n        drift: {said['drift']}"
    )


SENSING = "as measured"
"""Name of the sensor in the results: its errors are in the records."""


@dataclass(frozen=True)
class EstimateRequest:
    """Which methods are asked about what."""

    objects: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    scenario: str = "blocks"
    held_out: int = 0
    workers: int | None = None


def estimate_recorded(folder: Path, wish: EstimateRequest) -> int:
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


def _command(folder: Path, wish: EstimateRequest) -> str:
    """What runs this again."""
    parts = ["heft", "estimate", str(folder)]
    for flag, values in (("objects", wish.objects), ("methods", wish.methods)):
        parts += [f"--{flag}", *values] if values else []
    parts += ["--scenario", wish.scenario] if wish.scenario != "blocks" else []
    return shlex.join(parts + (["--held-out", str(wish.held_out)] if wish.held_out else []))
