"""Clean simulated trials, each computed once in a process."""

from functools import cache

from testbed.actions.base import Action
from testbed.objects.files import load_object
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import Trial


@cache
def clean(name: str, action: Action) -> Trajectory:
    """Record of an object's trial by a perfect sensor; `name` is in the library, or a path."""
    return SimulationRunner().run_clean(Trial(load_object(name), action))
