"""Run of a scenario: the trials of every experiment, then the estimates of every method."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from scenarios.config import Scenario
from scenarios.execution.executor import open_executor
from scenarios.results.store import Store, exclusive, write_json
from scenarios.study.estimates import run_estimates
from scenarios.study.experiment import Progress, ResultCallback, experiments_of
from scenarios.study.trials import run_trials


def run_scenario(
    scenario: Scenario,
    out: Path,
    worker_count: int,
    progress: Progress,
    executor: str = "local",
    on_result: ResultCallback | None = None,
) -> pd.DataFrame:
    """Run or resume a scenario; a row an estimate.

    Args:
        scenario: what to run.
        out: results folder; what is done there is not done again.
        worker_count: workers; 0 is this process.
        progress: receives how far it is.
        executor: inline, local or ray.
        on_result: called for each "trial" and "estimate", with its key, when it is done.

    Raises:
        HeftError: something in the scenario cannot be done, or another run writes to `out`.
        OSError: `out` cannot be written to.
    """
    store = Store(out.absolute())
    with exclusive(out), open_executor(executor, worker_count, preload=(__name__,)) as tasks:
        store.remove_leftovers()
        experiments, left_out = experiments_of(scenario, store, progress)
        write_json(out / "manifest.json", manifest(scenario))
        run_trials(experiments, store, tasks, progress, on_result)
        rows = run_estimates(experiments, left_out, store, tasks, progress, on_result)
        return store.put_table(rows)


def manifest(scenario: Scenario) -> dict[str, Any]:
    """The manifest of a results folder: the scenario, and the versions that ran it."""
    packages = {name: version(name) for name in ("heft", "mujoco", "torch", "numpy", "scipy")}
    return {"scenario": scenario.model_dump(), "python": platform.python_version(), "packages": packages}
