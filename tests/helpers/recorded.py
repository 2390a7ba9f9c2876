"""Short simulated trials in a results folder, as a run leaves them."""

from pathlib import Path

from scenarios.results.store import Store
from scenarios.study.trials import simulate
from testbed.actions.base import Action
from testbed.objects.files import load_object
from testbed.simulation.settings import SimulationSettings
from testbed.trial import OWN_WEIGHT, Support, Trial


def put_trial(
    root: Path, name: str, action: Action, support: Support = OWN_WEIGHT, settings: SimulationSettings | None = None
) -> str:
    """Simulate a trial, store it, and return its key."""
    return simulate(Trial(load_object(name), action, support), settings or SimulationSettings(), Store(root))
