"""A scenario run: every object and support is tried as the policy asks, then every method answers."""

from __future__ import annotations

import hashlib
import math
import platform
import traceback
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from estimators.metrics import normalized_absolute_difference
from estimators.protocol import ActionPolicy
from scenarios.execution import Submit, finished, workers
from scenarios.schema import Scenario
from scenarios.store import Store, key_of, trial_request, write_json
from testbed.actions import Accelerate, Action, Rotate, Weigh
from testbed.errors import InfeasibleTrialError
from testbed.object_files import load_object
from testbed.objects import ObjectModel, ObjectShape
from testbed.reduction import weight_of
from testbed.sensing import draw_sensing, preset
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory, TrajectoryFileError
from testbed.trial import Support, Trial

Progress = Callable[[str, int, int], None]
"""Told the stage ("trials" or "estimates"), how many are done, and how many there are as far as is known."""


@dataclass(eq=False)
class Cell:
    """One object under one support: its trials are made one after the other, as the policy sees them."""

    model: ObjectModel
    """With the simulation's feet."""
    particles: ObjectModel
    """With the estimator's particles."""
    support: Support
    policy: ActionPolicy
    keys: list[str] = field(default_factory=list)
    """Trials made so far; the weighing first."""
    trajectories: list[Trajectory] = field(default_factory=list)
    """What the policy sees."""


def run_scenario(scenario: Scenario, out: Path, worker_count: int, progress: Progress) -> pd.DataFrame:
    """Run or resume a scenario; a row an estimate.

    Raises:
        HeftError: something in the scenario cannot be done; nothing has been written.
    """
    settings = scenario.simulation.build()
    cells = [cell for name in scenario.objects for cell in _cells(name, scenario, settings)]
    store = Store(out)
    write_json(out / "manifest.json", manifest(scenario))
    with workers(worker_count) as submit:
        _run_trials(cells, settings, store, submit, progress, scenario.policy.expected_trials * len(cells))
        rows = _run_estimates(cells, scenario, store, submit, progress)
    return store.put_table(rows)


def manifest(scenario: Scenario) -> dict[str, Any]:
    """What was run, with what."""
    packages = {name: version(name) for name in ("heft", "mujoco", "torch", "numpy", "scipy")}
    return {"scenario": scenario.model_dump(), "python": platform.python_version(), "packages": packages}


def _cells(name: str, scenario: Scenario, settings: SimulationSettings) -> list[Cell]:
    model = load_object(name, scenario.grid.feet)
    particles = load_object(name, scenario.grid.particles)
    policy = scenario.policy.build(feasible_grasps(model, settings))
    return [Cell(model, particles, support, policy) for support in scenario.supports()]


def feasible_grasps(model: ObjectModel, settings: SimulationSettings) -> tuple[int, ...]:
    """Grasps about which the bench can turn the object at constant and at changing speed.

    Raises:
        InfeasibleTrialError: there is none; the message gives the reason of each.
    """
    runner = SimulationRunner(settings)
    possible, reasons = [], []
    for index, grasp in enumerate(model.shape.grasps):
        try:
            for action in (Rotate(index), Accelerate(index)):
                runner.check(Trial(model, action))
            possible.append(index)
        except InfeasibleTrialError as error:
            reasons.append(f"{grasp.name}: {error}")
    if not possible:
        why = "\n  ".join(reasons) or "no block has two opposite free faces"
        raise InfeasibleTrialError(f"{model.name}: the bench cannot turn this object about any grasp\n  {why}")
    return tuple(possible)


def _run_trials(
    cells: list[Cell], settings: SimulationSettings, store: Store, submit: Submit, progress: Progress, expected: int
) -> None:
    """All cells side by side, each cell's trials in order."""
    running: dict[Future[Any], tuple[Cell, Action]] = {}
    done = 0

    def submit_trial(cell: Cell, action: Action) -> None:
        running[submit(simulate, Trial(cell.model, action, cell.support), settings, store)] = cell, action

    for cell in cells:
        submit_trial(cell, Weigh())
    while running:
        for future in finished(set(running)):
            cell, action = running.pop(future)
            key = future.result()
            try:
                trajectory = store.trajectory(key)
            except TrajectoryFileError:  # damaged since it was made: made again
                submit_trial(cell, action)
                continue
            cell.keys.append(key)
            if not isinstance(action, Weigh):
                cell.trajectories.append(trajectory)
            done += 1
            following = cell.policy.next(cell.particles.shape, cell.trajectories)
            if following is None:
                cell.trajectories.clear()
            else:
                submit_trial(cell, following)
        progress("trials", done, max(done + len(running), expected))
    progress("trials", done, done)


def simulate(trial: Trial, settings: SimulationSettings, store: Store) -> str:
    """Task: one physical trial, unless it is done; returns its key."""
    asked = trial_request(trial, settings)
    key = key_of(asked)
    if not store.has_trial(key):
        store.put_trial(key, asked, SimulationRunner(settings).run_clean(trial))
    return key


def _run_estimates(
    cells: list[Cell], scenario: Scenario, store: Store, submit: Submit, progress: Progress
) -> list[dict[str, Any]]:
    running: set[Future[Any]] = set()
    for cell in cells:
        for sensing in scenario.sensing:
            seeds = 1 if sensing == "ideal" else scenario.seeds
            for method in scenario.methods:
                running.add(
                    submit(
                        estimate, cell.particles, cell.support.name, cell.keys, sensing, seeds, method, scenario, store
                    )
                )
    rows, total = [], len(running)
    while running:
        for future in finished(running):
            rows += future.result()
        progress("estimates", total - len(running), total)
    order = {
        "support": [s.name for s in scenario.supports()],
        "sensing": scenario.sensing,
        "method": [*scenario.methods],
    }
    return sorted(
        rows, key=lambda row: (*(names.index(row[k]) for k, names in order.items()), row["object"], row["seed"])
    )


def estimate(
    truth: ObjectModel,
    support: str,
    keys: list[str],
    sensing: str,
    seeds: int,
    method: str,
    scenario: Scenario,
    store: Store,
) -> list[dict[str, Any]]:
    """Task: one method on one object's trials, every sensing draw; a row a draw."""
    rows, clean = [], None
    for seed in range(seeds):
        asked = {
            "trials": keys,
            "sensing": sensing,
            "seed": seed,
            "method": method,
            "settings": scenario.methods[method],
            "particles": scenario.grid.particles,
            "object": truth.name,
            "version": version("heft"),
        }
        key = key_of(asked)
        row = store.result(key)
        if row is None:
            clean = clean or [store.trajectory(k) for k in keys]
            drawn = [draw_sensing(t, preset(sensing), _draw_seed(seed, i, keys[i])) for i, t in enumerate(clean)]
            said = {"object": truth.name, "support": support, "sensing": sensing, "seed": seed, "method": method}
            try:
                row = said | judge(truth, scenario, method, drawn, seed)
            except Exception as error:  # a method that raises is a row; the run goes on
                store.put_error(key, traceback.format_exc())
                row = said | {"status": "failed", "message": f"{type(error).__name__}: {error}", "nad": math.nan}
            else:
                store.put_result(key, row)
        rows.append(row)
    return rows


def judge(truth: ObjectModel, scenario: Scenario, method: str, drawn: list[Trajectory], seed: int) -> dict[str, Any]:
    """Ask a method and hold its answer against the truth."""
    shape: ObjectShape = truth.shape
    weight = weight_of(drawn[0])
    answer = scenario.method(method).estimate(shape, weight, drawn[1:], seed)
    row: dict[str, Any] = {
        "status": answer.status,
        "message": answer.message,
        "nad": math.nan,
        "seconds": answer.seconds,
        "trials": len(drawn),
        "robot_s": float(sum(t.time_s[-1] for t in drawn)),
        "weight_kg": weight,
        "group_names": list(shape.group_names),
        "true_mass_kg": truth.group_mass.tolist(),
        "friction": None,
        "mass_kg": None,
        "com_error_m": math.nan,
        "inertia_error": math.nan,
        "unobserved": "",
    }
    if answer.distribution is not None:
        row["nad"] = normalized_absolute_difference(shape, answer.distribution, truth.truth)
        row["mass_kg"] = (answer.distribution.mass * shape.particles_per_group).tolist()
        row["friction"] = answer.distribution.friction.tolist()
    if answer.hidden is not None:
        row["com_error_m"] = float(np.linalg.norm(answer.hidden.center_of_mass - truth.center_of_mass))
        row["inertia_error"] = answer.hidden.inertia_cm / truth.inertia_cm - 1
        row["unobserved"] = answer.hidden.unobserved
    return row


def _draw_seed(seed: int, index: int, key: str) -> int:
    """A stream of its own for every trial of every draw, a repeated trial included."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{index}/{key}".encode()).digest()[:8], "big")
