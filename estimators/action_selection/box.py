"""Family of actions as a box of numbers, for policies that choose an action by its parameters."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np
from jaxtyping import Float

from estimators.action_selection.candidates import (
    HALF,
    SLIDE_DURATION,
    ActionFamily,
    clear_of_particles,
    stays_on_table,
    sweep_in_reach,
)
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.path import RAMP_TIME, outline, overhang_of
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape

SIZE = 6
"""Number of parameters of an action: kind, grasp, x and y of a turn's center, motion, time."""
ROUNDING = 1e-4
"""Tolerance of the distance from the grasp to a center [m], so that a rounded center at the limit is kept."""


@dataclass(frozen=True, eq=False)
class ActionBox:
    """Turns, accelerated turns and slides of a family as points of [-1, 1]^6; every point is an action.

    Kind and grasp divide their interval into equal parts. The center of a turn is in units of `reach`, object frame;
    a center farther from the grasp than the family's arm is moved to that distance. Motion is the signed speed of a
    turn, the direction of a slide over pi, or the sign of an accelerated turn; time is the duration on a logarithmic
    scale, or whole and half of an accelerated turn. Values are rounded, so that a point in 32-bit numbers gives the
    same action again.
    """

    shape: ObjectShape
    """Geometry and grasps."""
    grasps: tuple[int, ...]
    """Allowed grasps, at least one."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Ranges of the parameters."""

    def __post_init__(self) -> None:
        if not self.grasps:
            raise InvalidValueError("ActionBox.grasps", self.grasps, "one grasp or more")
        if self.family.lifts or self.family.pushes or self.shape.chain is not None:
            allowed = "a family without lifts and pushes, of an object without hinges"
            raise InvalidValueError("ActionBox.family", self.family, allowed)

    @cached_property
    def kinds(self) -> tuple[type[Action], ...]:
        """Classes of the actions, in the order of their parts of the interval."""
        allowed = {Rotate: True, Accelerate: self.family.accelerated, Slide: self.family.slides}
        return tuple(kind for kind, included in allowed.items() if included)

    @cached_property
    def reach(self) -> float:
        """Distance of the farthest center of a turn from the object's origin [m], the unit of lengths."""
        return float(np.linalg.norm(self.shape.particles, axis=1).max()) + self.family.arm

    def action(self, point: Float[np.ndarray, "6"]) -> Action:
        """Action at a point; numbers beyond [-1, 1] are clipped.

        Raises:
            InvalidValueError: not six finite numbers.
        """
        values = np.asarray(point, dtype=float)
        if values.shape != (SIZE,) or not np.isfinite(values).all():
            raise InvalidValueError("action", values.tolist(), f"{SIZE} finite numbers from -1 to 1")
        kind, grasp, x, y, motion, time = np.clip(values, -1.0, 1.0).tolist()
        action_type, index = self.kinds[_part(kind, len(self.kinds))], self.grasps[_part(grasp, len(self.grasps))]
        sign = -1.0 if motion < 0 else 1.0
        if action_type is Accelerate:
            steps = Accelerate(index).accelerations[: None if time >= 0 else HALF]
            whole = Accelerate(index, steps)
            return whole if sign > 0 else whole.reversed()
        if action_type is Slide:
            return Slide(index, round(math.pi * motion, 4), duration=round(_between(time, SLIDE_DURATION), 1))
        position = self.shape.grasps[index].position
        center = self.reach * np.array([x, y])
        if np.linalg.norm(center.round(4) - position) > self.family.arm + ROUNDING:
            center = position + (center - position) * (self.family.arm / np.linalg.norm(center - position))
        pivot = center.round(4)
        slow, fast = np.radians(self.family.speed_deg_s)
        speed = float(round(sign * (slow + abs(motion) * (fast - slow)), 4))
        duration = round(_between(time, self.family.duration), 1)
        return Rotate(index, speed, duration, (float(pivot[0]), float(pivot[1])), not self.family.one_way)

    def point(self, action: Action) -> Float[np.ndarray, "6"]:
        """Point of an action, or of the nearest action with rounded values.

        Raises:
            InvalidValueError: not a kind or a grasp of the box.
        """
        if type(action) not in self.kinds or action.grasp not in self.grasps:
            kinds = " or ".join(kind.__name__ for kind in self.kinds)
            raise InvalidValueError("action", action, f"{kinds} by one of the grasps {self.grasps}")
        found = np.zeros(SIZE)
        found[0] = _middle(self.kinds.index(type(action)), len(self.kinds))
        found[1] = _middle(self.grasps.index(action.grasp), len(self.grasps))
        if isinstance(action, Accelerate):
            whole = len(Accelerate(action.grasp).accelerations)
            found[4:] = math.copysign(1.0, action.start_speed), 1.0 if len(action.accelerations) == whole else -1.0
        elif isinstance(action, Slide):
            found[4:] = math.remainder(action.direction, math.tau) / math.pi, _inverse(action.duration, SLIDE_DURATION)
        elif isinstance(action, Rotate):
            slow, fast = np.radians(self.family.speed_deg_s)
            part = (abs(action.speed) - slow) / (fast - slow) if fast > slow else 1.0
            found[2:4] = action.center(self.shape) / self.reach
            # a turn at the least speed keeps its sign
            found[4:] = math.copysign(max(part, 1e-6), action.speed), _inverse(action.duration, self.family.duration)
        return np.clip(found, -1.0, 1.0)

    def refusal(self, action: Action) -> str:
        """Reason why an action is outside the limits of the family's candidates; empty if it is inside."""
        shape, place = self.shape, self.shape.grasps[action.grasp or 0]
        at, angle = place.position[None], np.array([place.angle])
        if isinstance(action, Accelerate):
            path = action.centered_path(shape, action.profile(0.01).length)
            return "off the table" if (overhang_of(shape, path) > 0).any() else ""
        if isinstance(action, Slide):
            along = action.speed * (action.duration + RAMP_TIME) * action.heading[None]
            return "" if stays_on_table(outline(shape), at, angle, at, np.zeros(1), along)[0] else "off the table"
        if not isinstance(action, Rotate):
            raise InvalidValueError("action", action, "an action of the box")
        pivot, turn = action.center(shape)[None], np.array([action.speed * (action.duration + RAMP_TIME)])
        if not clear_of_particles(shape, pivot)[0]:
            return "center at a particle"
        if not sweep_in_reach(at, angle, pivot, turn)[0]:
            return "out of the arm's reach"
        return "" if stays_on_table(outline(shape), at, angle, pivot, turn)[0] else "off the table"


def _part(value: float, count: int) -> int:
    """Index of the part of [-1, 1] that holds a value."""
    return min(int((value + 1) / 2 * count), count - 1)


def _middle(index: int, count: int) -> float:
    """Middle of a part of [-1, 1]."""
    return (2 * index + 1) / count - 1


def _between(value: float, ends: tuple[float, float]) -> float:
    """Value in a range at a number from -1 to 1, on a logarithmic scale."""
    return ends[0] * (ends[1] / ends[0]) ** ((value + 1) / 2)


def _inverse(value: float, ends: tuple[float, float]) -> float:
    """Inverse of `_between`; 1 for a range of one value."""
    whole = math.log(ends[1] / ends[0])
    return 2 * math.log(value / ends[0]) / whole - 1 if whole else 1.0
