"""Trials of one kind, reduced: what can be used of many records."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TypeVar

from testbed.actions import Weigh
from testbed.errors import InvalidValueError
from testbed.objects import ObjectShape
from testbed.trajectory import Trajectory

Window = TypeVar("Window")


def reduced_trials(
    shape: ObjectShape,
    trajectories: Sequence[Trajectory],
    kinds: tuple[type, ...],
    reduce: Callable[[Trajectory], list[Window]],
) -> dict[int, list[Window]]:
    """The windows of every trial of some kinds of action, by its place among all.

    Trials that did not end well, and those with a stretch too short to trim, are left out.

    Args:
        shape: the object's.
        trajectories: of one object.
        kinds: of actions, all with a grasp.
        reduce: from a record to its windows; it raises InvalidValueError where a stretch is too short.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    found = {}
    for index, trajectory in enumerate(trajectories):
        action = trajectory.action
        if not trajectory.ok or isinstance(action, Weigh) or not isinstance(action, kinds):
            continue
        if action.grasp >= len(shape.grasps):
            allowed = f"one of the shape's {len(shape.grasps)} grasps, counted from 0: another object's trial?"
            raise InvalidValueError(f"trajectories[{index}].action.grasp", action.grasp, allowed)
        try:
            found[index] = reduce(trajectory)
        except InvalidValueError:  # too short
            continue
    return found
