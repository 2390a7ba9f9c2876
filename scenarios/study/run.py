"""Runs: a scenario from its first trial to its results, or the methods of a scenario on measured trials."""

from __future__ import annotations

import json
import platform
import shlex
import time
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from scenarios.config import Grid, Scenario, Sweep, load_scenario
from scenarios.execution.executor import Executor, work_off
from scenarios.execution.select import open_executor
from scenarios.results.files import exclusive, read_manifest, write_json
from scenarios.results.store import Store, key_of, object_request
from scenarios.results.table import ResultTable, rows_of
from scenarios.results.trials import MeasuredTrials, measured_trials
from scenarios.study.dry_run import DryRun, check_code
from scenarios.study.estimates import EstimateRun, infeasible_row
from scenarios.study.experiment import Experiment, Progress, ResultCallback, experiments_of
from scenarios.study.trials import TrialRun
from testbed.errors import InvalidValueError
from testbed.files import unless_damaged
from testbed.objects.files import load_object
from testbed.worlds.seeds import new_secret

SENSING = "as measured"
"""Name of the sensor in the results: its errors are in the records."""
DEFAULT_SCENARIO = "blocks"
"""Scenario whose methods are used on measured trials by default."""
ACTIVE_FIELDS = {"objects", "support", "sensing", "seeds"}
"""Fields of a scenario that determine an active run: it has no methods."""


def run_scenario(
    scenario: Scenario,
    out: Path | str,
    worker_count: int,
    progress: Progress,
    executor: str = "local",
    on_result: ResultCallback | None = None,
    secret: str | None = None,
) -> pd.DataFrame:
    """Run or resume a scenario; return a table with a row per estimate.

    Args:
        scenario: scenario to run.
        out: results folder; finished trials and estimates in it are kept.
        worker_count: number of worker processes; 0 is this process.
        progress: callback for the progress.
        executor: inline, local or ray.
        on_result: called for each "trial" and "estimate", with its key, when it is done.
        secret: text that seeds all draws, to repeat them; default: the secret of the folder, or a new one.

    Raises:
        HeftError: something in the scenario cannot be done, `out` holds results of another scenario, as
            `check_nothing_lost` finds, or another run writes there.
        OSError: `out` cannot be written to.
    """
    check_nothing_lost(Path(out), scenario, secret)
    with carry_out(scenario, Path(out), worker_count, progress, executor, on_result, secret=secret) as (table, _):
        return table


@contextmanager
def carry_out(
    scenario: Scenario,
    out: Path,
    worker_count: int,
    progress: Progress,
    executor: str = "local",
    on_result: ResultCallback | None = None,
    preload: Sequence[str] = (),
    secret: str | None = None,
) -> Iterator[tuple[pd.DataFrame, Executor]]:
    """Run a scenario as `run_scenario` does; yield its table, and its workers for views of the results.

    Workers import the modules of `preload` when they start.
    """
    check_code(scenario)
    workers = open_executor(executor, worker_count, preload=(__name__, *preload))
    with exclusive(out), _without_partial_files(out), workers as tasks:
        store = Store(out.absolute(), _secret_of(out) or new_secret() if secret is None else secret)
        store.remove_leftovers()
        experiments, left_out = experiments_of(scenario, store, progress)
        contents = {"contents": _contents(scenario)}
        write_json(out / "manifest.json", manifest(scenario, store.secret, DryRun.of(scenario)) | contents)
        table = ResultTable(store.root)
        estimates = EstimateRun(experiments, store, table, tasks, progress, on_result)
        trials = TrialRun(deque(experiments), store, tasks, progress, estimates.add, on_result, table.marks)
        work_off(tasks, estimates.start, trials.start)
        for index, experiment in enumerate(left_out):
            table.add((len(scenario.sensing), index), *infeasible_row(experiment))
        frame = table.write()
        store.remove_errors("trials", trials.refusals)
        store.remove_errors("estimates", {*frame["key"]})
        write_json(out / "manifest.json", manifest(scenario, store.secret) | contents)
        yield frame, tasks


@contextmanager
def _without_partial_files(folder: Path) -> Iterator[None]:
    """Remove the partial files of killed workers where a run is stopped."""
    try:
        yield
    except BaseException:
        Store(folder).remove_leftovers()
        raise


def _secret_of(folder: Path) -> str:
    """Secret in the manifest of a results folder; empty where there is none, or the manifest is damaged."""
    return (unless_damaged(lambda: read_manifest(folder), "written again") or {}).get("secret", "")


def _contents(scenario: Scenario) -> dict[str, str]:
    """Content key of each object that a scenario names, since its file may change later."""
    objects = map(load_object, scenario.objects)
    return {each.name: key_of(object_request(each)) for each in objects}


def check_nothing_lost(
    folder: Path, scenario: Scenario, secret: str | None = None, fields: set[str] | None = None
) -> None:
    """Check that a run into a folder continues the results there, or adds to them.

    Args:
        folder: results folder.
        scenario: scenario of the run.
        secret: text that seeds all draws; default: that of the folder.
        fields: fields of the scenario that determine the run; default: all.

    Raises:
        InvalidValueError: the folder holds results of other objects, methods, seeds, draws or settings, or of objects
            whose files have changed; or the secret is blank.
    """
    if secret is not None and not secret.strip():
        raise InvalidValueError("--secret", secret, "a text that is not blank")
    found = unless_damaged(lambda: read_manifest(folder), "written again") or {}
    held = found.get("scenario")
    if held is None or not (folder / "results.parquet").is_file():
        return
    asked = json.loads(json.dumps(scenario.model_dump(include=fields)))
    other = [field for field in held if field not in asked or not _includes(field, held[field], asked[field])]
    if "methods" in asked and "methods" not in held:
        other.append("methods")
    kept = found.get("secret", "")
    if not kept or secret not in (None, kept):
        other.append("secret" if kept else "measured trials, or draws without a secret by heft 0.1.0")
    if contents := found.get("contents"):
        now = _contents(scenario)
        other += [f"{name}, whose file has changed" for name, key in contents.items() if now.get(name, key) != key]
    if other:
        allowed = f"a new folder, as {folder}-2; this one holds results of another run ({', '.join(other)})"
        raise InvalidValueError("--out", str(folder), allowed)


def _includes(field: str, held: Any, asked: Any) -> bool:
    """True if a field includes all that the results hold: objects, methods, seeds and points may be added."""
    if field == "seeds":
        return held <= asked
    if field == "objects":  # the same files lie elsewhere in another checkout
        held, asked = ([Path(name).name for name in names] for names in (held, asked))
    if field == "random":  # a field that is not given may be newer than the results
        held, asked = ([{k: v for k, v in each.items() if v is not None} for each in them] for them in (held, asked))
    if field == "methods":
        return all(asked.get(label) == settings for label, settings in held.items())
    if field == "sweep":
        points = Sweep.model_construct(**asked).points()
        return held == asked or all(point in points for point in Sweep.model_construct(**held).points())
    return held == asked or (isinstance(held, list) and all(item in asked for item in held))


def manifest(scenario: Scenario, secret: str = "", expected: DryRun | None = None) -> dict[str, Any]:
    """Manifest of a results folder: scenario, secret of its draws, package versions, and expected size until it ends.

    Measured trials have no draws and no secret.
    """
    packages = {name: version(name) for name in ("heft-testbed", "mujoco", "torch", "numpy", "scipy")}
    facts = {"scenario": scenario.model_dump(), "python": platform.python_version(), "packages": packages}
    facts |= {"secret": secret} if secret else {}
    if expected is None:
        return facts | {"finished": True}
    return facts | {"finished": False, "expected": {"trials": expected.trials, "estimates": expected.estimates}}


def command_words(*words: str, **options: Any) -> list[str]:
    """Words of a command line: the given words, then each option by its name, except those of None and False."""
    found = list(words)
    for name, value in options.items():
        if value is not None and value is not False:
            values = [] if value is True else value if isinstance(value, tuple) else [str(value)]
            found += [f"--{name.replace('_', '-')}", *values]
    return found


@dataclass(frozen=True)
class EstimateRequest:
    """Objects and methods of `heft estimate`."""

    objects: tuple[str, ...] | None = None
    methods: tuple[str, ...] | None = None
    scenario: str = DEFAULT_SCENARIO
    held_out: int = 0
    workers: int | None = None
    allow_code: bool = False

    def chosen(self) -> Scenario:
        """Scenario with the requested methods: by default those of `blocks`, after the one that tests the support.

        Raises:
            InvalidValueError: no such method or scenario, or a scenario with other particles than the trials hold.
        """
        scenario = load_scenario(self.scenario)[1]
        by_default = ("support_aware", *scenario.methods) if self.scenario == DEFAULT_SCENARIO else None
        if (particles := scenario.grid.particles) != (recorded := Grid().particles):
            allowed = f"{recorded}: measured trials hold their object with so many particles along a block's side"
            raise InvalidValueError("grid.particles", particles, allowed)
        return scenario.changed(methods=self.methods or by_default)

    def command(self, folder: Path) -> str:
        """Command line that runs this again."""
        options = {
            "objects": self.objects or None,
            "methods": self.methods or None,
            "scenario": None if self.scenario == DEFAULT_SCENARIO else self.scenario,
            "held_out": self.held_out or None,
            "allow_code": self.allow_code,
        }
        return shlex.join(command_words("heft", "estimate", str(folder), **options))


@dataclass(frozen=True, eq=False)
class MeasuredEstimates:
    """Estimates from measured trials."""

    scenario: Scenario
    """Scenario of these trials: their objects and supports, one draw, no sweep."""
    rows: list[dict[str, Any]]
    """Results, a row per estimate."""
    left_out: list[str]
    """A line for each unusable trial."""


@contextmanager
def estimate_measured(folder: Path, request: EstimateRequest, progress: Progress) -> Iterator[MeasuredEstimates]:
    """Run the methods on the measured trials of a folder, write results and manifest, and lock it during the context.

    Raises:
        InvalidValueError: no measured trials, no weighing, no such object, or as `EstimateRequest.chosen`.
    """
    methods = request.chosen()
    check_code(methods)
    begin = time.monotonic()
    found, left_out = measured_trials(folder, request.objects, request.held_out)
    scenario = _scenario_of(found, methods)
    experiments = [_experiment_of(trials, scenario) for trials in found]
    store = Store(folder.absolute())
    with exclusive(folder), open_executor("local", request.workers, preload=(__name__,)) as tasks:
        store.remove_leftovers()
        table = ResultTable(store.root)
        estimates = EstimateRun(experiments, store, table, tasks, progress)
        for experiment in experiments:
            estimates.add(experiment)
        work_off(tasks, estimates.start)
        rows = rows_of(table.write())
        store.remove_errors("estimates", {row["key"] for row in rows})
        holds = scenario.model_dump(include={"objects", "support", "sensing", "methods"})
        facts = {
            "name": folder.resolve().name,
            "command": request.command(folder),
            "wall_s": round(time.monotonic() - begin, 1),
        }
        write_json(folder / "manifest.json", manifest(scenario) | {"scenario": holds} | facts)
        yield MeasuredEstimates(scenario, rows, left_out)


def _scenario_of(found: Sequence[MeasuredTrials], methods: Scenario) -> Scenario:
    """Scenario of measured trials, with one estimate per method and no draws of sensor errors."""
    stiffness = [trials.support.stiffness for trials in found]
    supports = [k if 0 < k < float("inf") else trials.support.name for k, trials in zip(stiffness, found, strict=True)]
    changes: dict[str, Any] = {
        "objects": list(dict.fromkeys(trials.object.name for trials in found)),
        "random": [],
        "support": list(dict.fromkeys(supports)),
        "sensing": [SENSING],
        "seeds": 1,
        "sweep": Sweep(),
    }
    return methods.model_copy(update=changes)


def _experiment_of(trials: MeasuredTrials, scenario: Scenario) -> Experiment:
    """Experiment whose trials are complete, so that its policy chooses nothing."""
    obj, keys, held_out = trials.object, [trials.weighing, *trials.moved], list(trials.held_out)
    policy = scenario.policy.build((), obj.shape, scenario.simulation.build())
    return Experiment(scenario, {}, obj, obj, trials.support, (), policy, (), keys=keys, held_out_keys=held_out)
