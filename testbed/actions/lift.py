"""Where a lift has the object at every moment: how high, and how far turned about which of its axes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int

from testbed.actions.base import Lift

RAISE_TIME = 1.5
"""Time of the way up, and of the way down, s."""
TILT_TIME = 0.8
"""Time to take up a tilt, and to give it up again, s."""


@dataclass(frozen=True, eq=False)
class LiftProfile:
    """Height and angles of a lift at N ticks; the first is one step after its start."""

    step: float
    """Time between ticks, s."""
    height: Float[np.ndarray, "N"]
    """Over the place where it lay, m."""
    height_rate: Float[np.ndarray, "N"]
    """m/s."""
    angle: Float[np.ndarray, "N 3"]
    """About the object's own x, y and z axis, rad: one at a time, the others at 0."""
    rate: Float[np.ndarray, "N 3"]
    """rad/s."""
    acceleration: Float[np.ndarray, "N 3"]
    """rad/s^2."""
    segment: Int[np.ndarray, "N"]
    """Stretch held still or at constant acceleration that a tick belongs to, from 0; -1 outside."""

    @classmethod
    def of(cls, action: Lift, step: float) -> Self:
        """The profile of a lift, sampled every `step` s."""
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
            done, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / (n * step)
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
        """s."""
        return len(self.height) * self.step


def swing_time(action: Lift) -> float:
    """Time of one stretch of constant acceleration, from the greatest speed one way to that the other way, s."""
    return 2 * math.sqrt(2 * action.tilt / action.acceleration)


def _swings(action: Lift, step: float) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Angle, rate and acceleration from rest at -tilt to rest at a tilt, a stretch of one sign each.

    Half a stretch speeds up, half a stretch slows down: those two are not steady.
    """
    if not action.swings:
        return []
    half = max(round(swing_time(action) / 2 / step), 1)
    slope = 2 * action.tilt / (half * step) ** 2  # the acceleration that fits whole ticks
    counts = [half, *[2 * half] * action.swings, half]
    angle, rate, found = -action.tilt, 0.0, []
    for i, count in enumerate(counts):
        sign = slope * (-1) ** i
        t = np.arange(1, count + 1) * step
        found.append((angle + rate * t + sign * t**2 / 2, rate + sign * t, sign, 0 < i <= action.swings))
        angle, rate = found[-1][0][-1], found[-1][1][-1]
    return found
