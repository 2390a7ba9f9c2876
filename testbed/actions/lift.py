"""Lifts: hold the object still in the air and rock it; its height and angles at every moment."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np
from jaxtyping import Float, Int

from testbed.actions.base import Action, ActionWords
from testbed.actions.path import minimum_jerk
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_integer, check_positive_fields, is_number

STEEPEST = math.radians(30)
"""Greatest tilt in the air [rad]."""
RAISE_TIME = 1.5
"""Time of the way up, and of the way down [s]."""
TILT_TIME = 0.8
"""Time to take up a tilt, and to give it up again [s]."""


@dataclass(frozen=True)
class Lift(Action, kind="lift"):
    """Lift the object clear of the table, hold it still, and rock it there about its own x, y and z axis.

    At rest, the wrench is its weight at its center of mass, without friction; rocking adds the second moments. It
    rocks about the TCP between tilts of either sign, at one angular acceleration of alternating sign.
    """

    in_air: ClassVar[bool] = True

    grasp: int
    """Index into the shape's grasps."""
    tilt: float = math.radians(6)
    """Greatest tilt about x and y, and turn about z, either way [rad]; 0 only holds it still and level."""
    acceleration: float = 2.5
    """Angular acceleration while rocking [rad/s^2]."""
    swings: int = 6
    """Stretches of such acceleration about each axis; 0 holds still at every tilt and does not rock."""
    hold: float = 2.0
    """Time held still, level and at every tilt [s]."""
    height: float = 0.08
    """Height over the table [m]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_number(self.tilt) and 0 <= self.tilt <= STEEPEST):
            raise InvalidValueError("Lift.tilt", self.tilt, f"an angle from 0 to {STEEPEST:.2f}, rad")
        check_positive_fields(self, "acceleration", "hold", "height")
        check_integer("Lift.swings", self.swings, least=0)

    @property
    def seconds(self) -> float:
        """Duration of the motion, from rest to rest [s]."""
        return _seconds(self)

    def accelerates(self, segment: int) -> bool:
        """True if it rocks in a stretch; it holds still level first, then at either end of each rocking."""
        return segment > 0 and self.swings > 0 and (segment - 1) % (self.swings + 2) not in (0, self.swings + 1)

    def profile(self, step: float) -> LiftProfile:
        """Height and angles, sampled every `step` s."""
        return LiftProfile.of(self, step)

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        return ActionWords("lift", manner=f"{self.swings} swings, held {self.hold:g} s")


@lru_cache(maxsize=1024)
def _seconds(action: Lift) -> float:
    return action.profile(0.01).duration


@dataclass(frozen=True, eq=False)
class LiftProfile:
    """Height and angles of a lift at N ticks; the first is one step after its start."""

    step: float
    """Time between ticks [s]."""
    height: Float[np.ndarray, "N"]
    """Height over the place where it lay [m]."""
    height_rate: Float[np.ndarray, "N"]
    """Rate of `height` [m/s]."""
    angle: Float[np.ndarray, "N 3"]
    """Angle about the object's own x, y and z axis [rad]: one at a time, the others at 0."""
    rate: Float[np.ndarray, "N 3"]
    """Rate of `angle` [rad/s]."""
    acceleration: Float[np.ndarray, "N 3"]
    """Rate of `rate` [rad/s^2]."""
    segment: Int[np.ndarray, "N"]
    """Index of the stretch at rest or at constant acceleration that a tick belongs to; -1 outside."""

    @classmethod
    def of(cls, action: Lift, step: float) -> Self:
        """Profile of a lift, sampled every `step` s."""
        parts: list[tuple[np.ndarray, np.ndarray, bool]] = []
        level = np.zeros(3)

        def still(height: float, angle: np.ndarray) -> None:
            n = max(round(action.hold / step), 1)
            parts.append(
                (np.full((n, 2), [height, 0.0]), np.stack([np.tile(angle, (n, 1))] + [np.zeros((n, 3))] * 2), True)
            )

        def move(seconds: float, height: tuple[float, float], begin: np.ndarray, end: np.ndarray) -> None:
            n = max(round(seconds / step), 1)
            x = np.arange(1, n + 1) / n
            done, rate = minimum_jerk(x)
            rate /= n * step
            way = height[1] - height[0]
            turned = np.stack([begin + np.outer(done, end - begin), np.outer(rate, end - begin), np.zeros((n, 3))])
            parts.append((np.column_stack([height[0] + done * way, rate * way]), turned, False))

        up = action.height
        move(RAISE_TIME, (0.0, up), level, level)
        still(up, level)
        for axis in np.eye(3) if action.tilt > 0 else ():
            low = -action.tilt * axis
            move(TILT_TIME, (up, up), level, low)
            still(up, low)
            last = -action.tilt
            for angle, rate, slope, steady in _swings(action, step):
                zero = np.zeros(len(angle))
                turned = np.stack([np.outer(v, axis) for v in (angle, rate, np.full(len(angle), slope))])
                parts.append((np.column_stack([zero + up, zero]), turned, steady))
                last = angle[-1]
            if action.swings:
                still(up, last * axis)
            move(TILT_TIME, (up, up), last * axis, level)
        move(RAISE_TIME, (up, 0.0), level, level)

        numbers = np.cumsum([steady for _, _, steady in parts]) - 1
        segment = [
            np.full(len(h), number if steady else -1) for (h, _, steady), number in zip(parts, numbers, strict=True)
        ]
        heights, turns = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts], axis=1)
        return cls(step, heights[:, 0], heights[:, 1], turns[0], turns[1], turns[2], np.concatenate(segment))

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return len(self.height) * self.step


def _swings(action: Lift, step: float) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Angle, rate and acceleration from rest at -tilt to rest at a tilt, a stretch of one sign each.

    Half a stretch speeds up, half a stretch slows down: those two are not steady.
    """
    if not action.swings:
        return []
    half = max(round(math.sqrt(2 * action.tilt / action.acceleration) / step), 1)
    slope = 2 * action.tilt / (half * step) ** 2  # the acceleration that fits whole ticks
    counts = [half, *[2 * half] * action.swings, half]
    angle, rate, found = -action.tilt, 0.0, []
    for i, count in enumerate(counts):
        sign = slope * (-1) ** i
        t = np.arange(1, count + 1) * step
        found.append((angle + rate * t + sign * t**2 / 2, rate + sign * t, sign, 0 < i <= action.swings))
        angle, rate = found[-1][0][-1], found[-1][1][-1]
    return found
