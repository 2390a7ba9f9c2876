"""Short simulated trials in a results folder, as a run leaves them."""

from pathlib import Path

from scenarios.results.store import Store
from scenarios.study.trials import simulate
from testbed import OWN_WEIGHT, Action, SimulationSettings, Support, Trial, load_object


def put_trial(
    root: Path, name: str, action: Action, support: Support = OWN_WEIGHT, settings: SimulationSettings | None = None
) -> str:
    """Simulate a trial, store it, and return its key."""
    return simulate(Trial(load_object(name), action, support), settings or SimulationSettings(), Store(root))
