"""A scenario run: every object and support is tried as the policy asks, then every method answers."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from scenarios.config import Scenario
from scenarios.execution.executor import open_executor
from scenarios.results.lock import exclusive
from scenarios.results.store import Store, write_json
from scenarios.study.estimates import run_estimates
from scenarios.study.experiment import Made, Progress, cells_of
from scenarios.study.trials import run_trials


def run_scenario(
    scenario: Scenario,
    out: Path,
    worker_count: int,
    progress: Progress,
    executor: str = "local",
    made: Made | None = None,
) -> pd.DataFrame:
    """Run or resume a scenario; a row an estimate.

    Args:
        scenario: what to run.
        out: results folder; what is done there is not done again.
        worker_count: workers; 0 is this process.
        progress: told how far it is.
        executor: inline, local or ray.
        made: told of each "trial" and "estimate" that is made, by its key, when it is done.

    Raises:
        HeftError: something in the scenario cannot be done, or another run writes to `out`.
        OSError: `out` cannot be written to.
    """
    store = Store(out.absolute())
    with exclusive(out), open_executor(executor, worker_count) as tasks:
        store.remove_leftovers()
        cells, left_out = cells_of(scenario, store, progress)
        write_json(out / "manifest.json", manifest(scenario))
        run_trials(cells, store, tasks, progress, made)
        rows = run_estimates(cells, left_out, store, tasks, progress, made)
        return store.put_table(rows)


def manifest(scenario: Scenario) -> dict[str, Any]:
    """What was run, with what."""
    packages = {name: version(name) for name in ("heft", "mujoco", "torch", "numpy", "scipy")}
    return {"scenario": scenario.model_dump(), "python": platform.python_version(), "packages": packages}
