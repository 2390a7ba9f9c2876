"""How long the robot takes over actions, regrasping and travel included."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from testbed.actions.base import Accelerate, Action, Lift, Rotate, Weigh
from testbed.actions.lift import LiftProfile
from testbed.actions.path import PAUSE, RAMP_TIME
from testbed.objects.model import ObjectShape


@dataclass(frozen=True)
class RobotTime:
    """Seconds of one trial and of the way to the next.

    A simulated record runs from the tare to the release: tare, down, pause, close, null, pause, the action, pause,
    open. What it does not hold is the way to the next grasp, which is as long as the real bench is asked to take.
    """

    around: float = 4.79
    """Of a simulated record beside the action itself, s; held against records by a test."""
    weighing: float = 1.99
    """Of a simulated weighing, s."""
    rise: float = 0.8
    """Up from the object, as long as down to it, s."""
    speed: float = 0.1
    """Between places over the table, m/s: the real bench's travel speed."""
    turn_rate: float = 0.5
    """Of the hand on the way, rad/s, where that takes longer."""

    def of(self, action: Action) -> float:
        """Of one trial, as its record has it, s."""
        if isinstance(action, Weigh):
            return self.weighing
        if isinstance(action, Accelerate):
            return self.around + 2 * RAMP_TIME + PAUSE + len(action.accelerations) * action.hold
        if isinstance(action, Lift):
            return self.around + _in_the_air(action)
        ways = 2 if isinstance(action, Rotate) and action.back else 1
        return self.around + ways * (2 * RAMP_TIME + action.duration)

    def between(self, shape: ObjectShape, last: Action | None, action: Action) -> float:
        """From where one action ends to where the next begins, up and over the object, s."""
        if last is None or isinstance(last, Weigh) or isinstance(action, Weigh):
            return self.rise
        old, new = shape.grasps[last.grasp], shape.grasps[action.grasp]
        distance = float(np.linalg.norm(new.position - old.position))
        apart = (new.angle - old.angle + np.pi / 2) % np.pi - np.pi / 2  # the pads may close from either side
        return self.rise + max(distance / self.speed, abs(apart) / self.turn_rate)

    def total(self, shape: ObjectShape, actions: Sequence[Action]) -> float:
        """Of actions one after the other, s."""
        lasts = [None, *actions]
        return sum(self.of(a) + self.between(shape, last, a) for last, a in zip(lasts, actions, strict=False))


@lru_cache(maxsize=1024)
def _in_the_air(action: Lift) -> float:
    """Up, held, rocked and down, s."""
    return LiftProfile.of(action, 0.01).duration
