"""Simulated trials: clean records, computed once per process, and trials in a results folder, as a run leaves them."""

from functools import cache
from pathlib import Path

from scenarios.results.store import Store
from scenarios.study.trials import simulate
from testbed import OWN_WEIGHT, Action, SimulationRunner, SimulationSettings, Support, Trajectory, Trial, load_object


@cache
def clean(name: str, action: Action) -> Trajectory:
    """Record of an object's trial by a perfect sensor; `name` is of the library, or a path."""
    return SimulationRunner().run_clean(Trial(load_object(name), action))


def put_trial(
    root: Path, name: str, action: Action, support: Support = OWN_WEIGHT, settings: SimulationSettings | None = None
) -> str:
    """Simulate a trial, store it, and return its key."""
    return simulate(Trial(load_object(name), action, support), settings or SimulationSettings(), Store(root))
