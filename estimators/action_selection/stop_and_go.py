"""Stop-and-go lifts as a policy: alone, or after the actions of another one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.action_selection.random import untried
from estimators.action_selection.rank import allowed_grasps
from estimators.base import ActionPolicy
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer


@dataclass(frozen=True)
class StopAndGo:
    """A stop-and-go lift of each of the grasps nearest the middle, as in the literature on held bodies."""

    lifts: int = 2
    """Lifts that end well, at most one per grasp."""
    grasps: tuple[int, ...] | None = None
    """Allowed grasps; None is all."""
    before: ActionPolicy | None = None
    """Policy whose actions come first."""
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """Actions that the bench refused, and why; grows as trials are made."""

    def __post_init__(self) -> None:
        check_integer("StopAndGo.lifts", self.lifts, 0)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action; None when done."""
        lifts = [t for t in trajectories if t.action.in_air]
        if self.before is not None:
            others = [t for t in trajectories if not t.action.in_air]
            if not lifts and (action := self.before.next(shape, others)) is not None:
                return action
        if sum(t.ok for t in lifts) >= self.lifts:
            return None
        grasps = allowed_grasps(shape, self.grasps)
        inner = sorted(grasps, key=lambda g: float(np.linalg.norm(shape.grasps[g].position)))
        return untried([Lift.stop_and_go(g) for g in inner], self.refused, lifts)
