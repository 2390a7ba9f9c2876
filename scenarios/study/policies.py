"""Policies of somebody else's: by name, with a scenario's settings, held to what the scenario lets them do."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from traceback import extract_tb
from typing import Any

from estimators.base import ActionPolicy
from estimators.registry import POLICY
from testbed.actions.base import Action
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.plugins import configured, find_class, source_hash
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class Told:
    """What a policy is told beside the shape: an argument of its class that has one of these names is filled in."""

    grasps: tuple[int, ...] = (0,)
    """Grasps that may be used."""
    weight_kg: float = 1.0
    """M as weighed."""
    feasible: Callable[[Action], str] = lambda action: ""
    """What the bench says of an action: empty, or why it cannot be done."""


@dataclass(frozen=True)
class OtherPolicy:
    """A policy of somebody else's, with an end to it, and held to actions that can be asked for."""

    name: str
    policy: ActionPolicy
    most: int
    """Actions at most."""
    grasps: tuple[int, ...]
    """Grasps that may be used."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """What it chooses; None when it is content, or after `most` trials.

        Raises:
            InvalidValueError: no action, or one of a grasp that may not be used.
            HeftError: it raised an error of its own.
        """
        if len(trajectories) >= self.most:
            return None
        field = f"{self.name}.next()"
        try:
            action = self.policy.next(shape, tuple(trajectories))
        except Exception as error:
            frame = extract_tb(error.__traceback__)[-1]
            place = f"{Path(frame.filename).name}, line {frame.lineno}"
            raise HeftError(f"{field} ends in {type(error).__name__}: {error} ({place})") from error
        if action is None:
            return None
        if not isinstance(action, Action) or not action.moves:
            raise InvalidValueError(field, action, "an action of testbed.actions on the table, or None when content")
        if action.grasp not in self.grasps:
            raise InvalidValueError(f"{field}.grasp", action.grasp, f"a grasp that may be used: {self.grasps}")
        return action


def build_policy(kind: str, settings: Mapping[str, Any], own: Sequence[str], most: int, told: Told) -> ActionPolicy:
    """A policy by "package:Class" or entry point.

    Args:
        kind: as the scenario has it.
        settings: arguments of its class.
        own: heft's own policies, for the error.
        most: actions at most.
        told: what it is told beside the shape.

    Raises:
        InvalidValueError: unknown policy or setting, or a value that the class refuses.
    """
    found = find_class(kind, POLICY, "kind", own)
    return OtherPolicy(kind, configured(found, settings, "settings", given=vars(told)), most, told.grasps)


def code_of(kind: str) -> dict[str, str]:
    """What decides the choices of somebody else's policy beyond its settings: its source."""
    return {"source": source_hash(find_class(kind, POLICY, "kind"))}
