"""A scenario run: every object and support is tried as the policy asks, then every method answers."""

from __future__ import annotations

import platform
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pandas as pd

from scenarios.estimates import run_estimates
from scenarios.execution import workers
from scenarios.schema import Scenario
from scenarios.store import Store, write_json
from scenarios.trials import Progress, cells_of, run_trials


def run_scenario(scenario: Scenario, out: Path, worker_count: int, progress: Progress) -> pd.DataFrame:
    """Run or resume a scenario; a row an estimate.

    Raises:
        HeftError: something in the scenario cannot be done; nothing has been written.
    """
    settings = scenario.simulation.build()
    cells = cells_of(scenario, settings)
    store = Store(out)
    write_json(out / "manifest.json", manifest(scenario))
    with workers(worker_count) as submit:
        run_trials(cells, settings, store, submit, progress, scenario.policy.expected_trials * len(cells))
        rows = run_estimates(cells, scenario, store, submit, progress)
    return store.put_table(rows)


def manifest(scenario: Scenario) -> dict[str, Any]:
    """What was run, with what."""
    packages = {name: version(name) for name in ("heft", "mujoco", "torch", "numpy", "scipy")}
    return {"scenario": scenario.model_dump(), "python": platform.python_version(), "packages": packages}
