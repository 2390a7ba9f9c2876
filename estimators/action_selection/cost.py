"""Robot time of actions and trials, regrasping and travel included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from estimators.base import robot_seconds
from testbed.actions.base import Action
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class RobotTime:
    """Robot time of one trial and of the way to the next.

    A simulated record runs from the tare to the release: tare, down, pause, close, null, pause, the action, pause,
    open. It lacks the way to the next grasp, which takes as long as on the real robot.
    """

    around: float = 4.79
    """Time of a simulated record without the action itself [s]; a test compares it with records."""
    around_push: float = 1.59
    """Time of a push's record without the action itself [s]: the hand stays closed."""
    weighing: float = 1.99
    """Time of a simulated weighing [s]."""
    rise: float = 0.8
    """Time up from the object, as long as down to it [s]."""
    speed: float = 0.1
    """Travel speed over the table [m/s], as on the real robot."""
    turn_rate: float = 0.5
    """Turn rate of the hand on the way [rad/s], where that takes longer."""

    def of(self, action: Action) -> float:
        """Time of one trial, as in its record [s]."""
        if action.pushes:
            return self.around_push + action.seconds
        return self.around + action.seconds if action.moves else self.weighing

    def between(self, shape: ObjectShape, last: Action | None, action: Action) -> float:
        """Time from the end of one action to the start of the next, up and over the object [s]."""
        if last is None or not (last.moves and action.moves):
            return self.rise
        (old, old_angle), (new, angle) = last.hand(shape), action.hand(shape)
        distance = float(np.linalg.norm(new - old))
        apart = (angle - old_angle + np.pi / 2) % np.pi - np.pi / 2  # the pads may close from either side
        return self.rise + max(distance / self.speed, abs(apart) / self.turn_rate)

    def total(self, shape: ObjectShape, actions: Sequence[Action]) -> float:
        """Time of actions one after the other [s]."""
        lasts = [None, *actions]
        return sum(self.of(a) + self.between(shape, last, a) for last, a in zip(lasts, actions, strict=False))


def spent_seconds(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> float:
    """Robot time of trials that were made, the ways between grasps included [s]."""
    time, actions = RobotTime(), [None, *(t.action for t in trajectories)]
    ways = sum(time.between(shape, a, b) for a, b in pairwise(actions) if b is not None)
    return robot_seconds(trajectories) + ways
