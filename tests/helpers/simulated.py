"""Clean simulated trials, each computed once in a process."""

from functools import cache

from testbed import Action, SimulationRunner, Trajectory, Trial, load_object


@cache
def clean(name: str, action: Action) -> Trajectory:
    """Record of an object's trial by a perfect sensor; `name` is in the library, or a path."""
    return SimulationRunner().run_clean(Trial(load_object(name), action))
