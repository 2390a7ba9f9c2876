"""How far along its path an action is at every moment: ramps, stretches at constant speed or acceleration, pauses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int

from testbed.actions import Accelerate, Rotate, Slide

RAMP_TIME = 0.4
"""Time to reach constant speed and to stop, s."""
PAUSE = 0.3
"""Time at constant speed before accelerations begin, s."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Progress of an action at N ticks; the first is one step after its start."""

    step: float
    """Time between ticks, s."""
    distance: Float[np.ndarray, "N"]
    """Along the path since the start, rad (turns) or m (slides)."""
    rate: Float[np.ndarray, "N"]
    """rad/s or m/s."""
    segment: Int[np.ndarray, "N"]
    """Steady stretch that a tick belongs to, from 0; -1 outside."""

    @classmethod
    def of(cls, action: Rotate | Accelerate | Slide, step: float) -> Self:
        """The profile of an action, sampled every `step` s."""
        knots = [(0.0, 0.0)]
        spans: list[tuple[float, float]] = []

        def go(speed: float, seconds: float, *, steady: bool = False) -> None:
            begin, end = knots[-1][0], knots[-1][0] + seconds
            knots.append((end, speed))
            if steady:
                spans.append((begin, end))

        if isinstance(action, Accelerate):
            speed = abs(action.start_speed)
            go(speed, RAMP_TIME)
            go(speed, PAUSE)
            for acceleration in action.accelerations:
                speed += math.copysign(acceleration, acceleration * action.start_speed) * action.hold
                go(speed, action.hold, steady=True)
            go(0.0, RAMP_TIME)
        else:
            there = abs(action.speed)
            for speed in (there, -there) if isinstance(action, Rotate) and action.back else (there,):
                go(speed, RAMP_TIME)
                go(speed, action.duration, steady=True)
                go(0.0, RAMP_TIME)
        times, speeds = np.array(knots).T
        t = np.arange(1, round(times[-1] / step) + 1) * step
        rate = np.interp(t, times, speeds)
        fine = np.interp(np.arange(0, len(t) * 10 + 1) * step / 10, times, speeds)
        distance = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) / 2) * step / 10])[10::10]
        segment = np.full(len(t), -1)
        for i, (begin, end) in enumerate(spans):
            segment[(t > begin + step / 2) & (t < end + step / 2)] = i
        return cls(step, distance, rate, segment)

    @property
    def duration(self) -> float:
        """s."""
        return len(self.distance) * self.step

    @property
    def length(self) -> float:
        """Greatest distance from the start, rad or m."""
        return float(self.distance.max())

    def at(self, time: float) -> tuple[float, float]:
        """Distance and rate at a time since the start, s; at rest before it and after the end."""
        if not 0 < time < self.duration:
            return (0.0 if time <= 0 else float(self.distance[-1])), 0.0
        ticks = np.arange(len(self.distance) + 1) * self.step
        distance, rate = (np.concatenate([[0.0], values]) for values in (self.distance, self.rate))
        return float(np.interp(time, ticks, distance)), float(np.interp(time, ticks, rate))
