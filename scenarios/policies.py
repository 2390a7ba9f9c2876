"""Action policies of other packages: by name, with a scenario's settings, held to what the scenario allows."""

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
class PolicyContext:
    """Facts for a policy beside the shape: an argument of its class that has one of these names is filled in."""

    grasps: tuple[int, ...] = (0,)
    """Grasps that may be used."""
    weight_kg: float = 1.0
    """M as weighed [kg]."""
    feasible: Callable[[Action], str] = lambda action: ""
    """Reason why the robot cannot do an action; empty where it can."""


@dataclass(frozen=True)
class NamedPolicy:
    """A policy of another package, ended after `most` actions and held to the allowed grasps."""

    name: str
    policy: ActionPolicy
    most: int
    """Largest number of actions."""
    grasps: tuple[int, ...]
    """Grasps that may be used."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action; None when the policy asks for no more, or after `most` trials.

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


def build_policy(
    kind: str, settings: Mapping[str, Any], own: Sequence[str], most: int, context: PolicyContext
) -> ActionPolicy:
    """Build a policy by "package:Class" or entry point.

    Args:
        kind: name as the scenario has it.
        settings: arguments of its class.
        own: names of heft's own policies, for the error.
        most: largest number of actions.
        context: facts beside the shape.

    Raises:
        InvalidValueError: unknown policy or setting, or a value that the class refuses.
    """
    found = find_class(kind, POLICY, "kind", own)
    return NamedPolicy(kind, configured(found, settings, "settings", given=vars(context)), most, context.grasps)


def code_of(kind: str) -> dict[str, str]:
    """Source hash of another package's policy: it decides the choices beyond the settings."""
    return {"source": source_hash(find_class(kind, POLICY, "kind"))}
