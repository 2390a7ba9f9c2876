"""Time and memory of a large sweep beside its trials and estimates: python bench/sweep.py [--trials N] [--estimates N].

Trials are records of a hand at rest and answers are even masses, which take no time: what is left is heft's own part,
files and tables. The run begins in an empty folder, then again where all is done, each in a process of its own.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from typing import Any, Self

import numpy as np
from shared import head_table, parser_of, show

from estimators.base import Estimate
from estimators.testing.analytic_world import record
from scenarios import run_scenario
from scenarios.config import Scenario
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.trial import Trial

OBJECTS = ["I1", "I2", "L1", "L2", "F1", "F2", "hammer", "wrench"]
TURNS, METHODS = 4, 3
"""Trials of an experiment beside the weighing, and methods."""
SIMULATED = {"runner": "simulation"}


@dataclass(frozen=True)
class Still:
    """Runner whose hand does not move."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def run(self, trial: Trial) -> Trajectory:
        """A record of 4 s, or of a scale."""
        if trial.action.moves:
            return record(action=trial.action, provenance=SIMULATED)
        time_s = np.arange(50) / 100
        return Trajectory.of_scale(np.full(50, trial.object.total_mass * GRAVITY), time_s, SIMULATED)


@dataclass(frozen=True)
class Even:
    """Method that answers the same mass everywhere."""

    friction: float

    def estimate(self, shape: ObjectShape, weight: float, trajectories: list[Trajectory], seed: int) -> Estimate:
        """Even masses."""
        del trajectories, seed
        even = MassDistribution(np.full(shape.n_m, weight / len(shape.particles)), np.full(shape.n_mu, self.friction))
        return Estimate(even, "ok", diagnostics={"misfit": 1.0, "misfit_freedom": 10.0})


def scenario_of(trials: int, estimates: int) -> Scenario:
    """Sweep of about that many trials and estimates."""
    points = max(round(trials / len(OBJECTS) / (1 + TURNS)), 1)
    friction = np.linspace(0.2, 0.8, points).round(6).tolist()
    return Scenario.model_validate(
        {
            "objects": OBJECTS,
            "sensing": ["ft300s"],
            "seeds": max(round(estimates / points / len(OBJECTS) / METHODS), 1),
            "policy": {"pivots": TURNS - 1, "accelerated": 1, "held_out": 0},
            "simulation": {"runner": "sweep:Still"},
            "sweep": {"axes": {"truth.friction": friction}},
            "methods": {f"even_{k}": {"method": "sweep:Even", "friction": 0.1 * (k + 1)} for k in range(METHODS)},
        }
    )


def run(folder: str, trials: int, estimates: int, workers: int) -> dict[str, Any]:
    """Seconds of a run, and memory [MiB] of this process at a tenth of the estimates and at most, and of a worker."""
    begin, memory = time.perf_counter(), [peak(resource.RUSAGE_SELF)]

    def progress(stage: str, done: int, total: int, failed: int = 0) -> None:
        del failed
        if stage == "estimates" and done <= total / 10:
            memory[0] = peak(resource.RUSAGE_SELF)

    rows = len(run_scenario(scenario_of(trials, estimates), folder, workers, progress, secret="sweep"))
    seconds = time.perf_counter() - begin
    most, of_worker = peak(resource.RUSAGE_SELF), peak(resource.RUSAGE_CHILDREN)
    return {"estimates": rows, "s": seconds, "tenth": memory[0], "most": most, "worker": of_worker}


def peak(who: int) -> float:
    """Largest memory so far [MiB]."""
    return resource.getrusage(who).ru_maxrss / 1024


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__, trials=1000, estimates=12_000, workers=2)
    parser.add_argument("--into", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.into:
        print(json.dumps(run(given.into, given.trials, given.estimates, given.workers)))
        return
    columns = ("run", "estimates", "s", "MiB at a tenth", "MiB at most", "MiB of a worker")
    table = head_table(*columns, left=("run",))
    with tempfile.TemporaryDirectory() as folder:
        for name in ("first", "again"):
            command = [sys.executable, __file__, "--into", folder, *sys.argv[1:]]
            done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
            found = json.loads(done.stdout.splitlines()[-1])
            table.add_row(name, *(f"{found[key]:.4g}" for key in ("estimates", "s", "tenth", "most", "worker")))
    show(table, width=100)


if __name__ == "__main__":
    main()
