"""Actions planned before anything is felt."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Literal, get_args

import numpy as np

from estimators.candidate_actions import ActionFamily
from estimators.design import Criterion, Design, Guess, before_trials
from estimators.robot_time import RobotTime
from estimators.touch_plan import Asked, Feasible, Goal, Plan, anything, batch_plan, greedy_plan, random_plan
from testbed.actions import Action
from testbed.errors import InvalidValueError
from testbed.objects import ObjectShape
from testbed.trajectory import Trajectory

Kind = Literal["random", "greedy", "batch"]
LOOKED_AT = 20
"""Actions that `random` may draw for each that it does."""


@dataclass(frozen=True)
class PlannedTouches:
    """Actions planned before anything is felt, from uniform masses. A trial that goes wrong is planned around."""

    guess: Guess
    """M, the sensor, and who may carry the weight."""
    kind: Kind = "greedy"
    """greedy: each the best of its moment; batch: the whole exchanged until nothing is better; random: any."""
    criterion: Criterion = "I"
    """What is made small."""
    goal: Goal = field(default_factory=Goal)
    """When to stop."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Which actions are thought of."""
    candidates: int = 4000
    """How many actions are thought of."""
    grasps: tuple[int, ...] | None = None
    """Grasps that may be used; None is all."""
    seed: int = 0
    """Of the draw of candidates, and of `random`'s order."""
    feasible: Feasible = anything
    """What the bench says of an action: empty, or why it cannot be done."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InvalidValueError("PlannedTouches.kind", self.kind, f"one of {', '.join(get_args(Kind))}")
        if self.candidates < 1:
            raise InvalidValueError("PlannedTouches.candidates", self.candidates, "an integer >= 1")

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """The first action of the plan that was not tried; where trials failed, of a plan that does without them.

        So it is where the bench has come to refuse an action that it was asked of before. The goal's trials and time
        hold for all that is done.
        """
        failed = tuple(t.action for t in trajectories if not t.ok)
        tried = [t.action for t in trajectories]
        if len(tried) >= self.goal.most:
            return None
        while True:
            action = next((a for a in self.plan(shape, failed).actions if a not in tried), None)
            if action is None or not self.feasible(action):
                break
            failed = (*failed, action)
        if action is None or (failed and self.goal.left(RobotTime().total(shape, [*tried, action])) < 0):
            return None
        return action

    def plan(self, shape: ObjectShape, without: tuple[Action, ...] = ()) -> Plan:
        """What to do, without actions that have come to nothing, and what it is expected to teach."""
        return _planned(self, shape, without)

    def sampled(self, shape: ObjectShape) -> tuple[Action, ...]:
        """The candidates."""
        grasps = range(len(shape.grasps)) if self.grasps is None else self.grasps
        return self.family.sample(shape, grasps, self.candidates, self.seed)


@lru_cache(maxsize=8)
def _planned(policy: PlannedTouches, shape: ObjectShape, failed: tuple[Action, ...]) -> Plan:
    candidates = tuple(action for action in policy.sampled(shape) if action not in failed)
    if policy.kind == "random":  # those that it will look at
        order = np.random.default_rng(policy.seed).permutation(len(candidates))
        candidates = tuple(candidates[i] for i in order[: LOOKED_AT * policy.goal.most])
    design = Design.of(shape, candidates, policy.guess, policy.criterion)
    return _SEARCHES[policy.kind](design, before_trials(shape, policy.guess), policy.goal, Asked(policy.feasible))


_SEARCHES = {"random": random_plan, "greedy": greedy_plan, "batch": batch_plan}
