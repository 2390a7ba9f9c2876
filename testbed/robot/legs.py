"""Legs: stretches of the tool's path that are followed by twists."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float

from testbed.frames import perpendicular
from testbed.profile import Profile
from testbed.tool_path import ToolPath


@dataclass(frozen=True, eq=False)
class Target:
    """Where the tool should be and how it should move, base frame."""

    position: Float[np.ndarray, "3"]
    """Of the TCP, m."""
    yaw: float
    """Of the closing direction, rad."""
    velocity: Float[np.ndarray, "3"]
    """m/s."""
    yaw_rate: float
    """rad/s."""


class Leg(Protocol):
    """A stretch of the path, followed by twists."""

    @property
    def duration(self) -> float:
        """s."""
        ...

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        ...


@dataclass(frozen=True, eq=False)
class Line:
    """Straight, from rest to rest with least jerk, the yaw kept."""

    start: Float[np.ndarray, "3"]
    """m."""
    end: Float[np.ndarray, "3"]
    """m."""
    yaw: float
    """rad."""
    duration: float
    """s."""

    @classmethod
    def at_most(cls, start: np.ndarray, end: np.ndarray, yaw: float, speed: float) -> Self:
        """The line whose greatest speed is `speed`, m/s."""
        return cls(start, end, yaw, max(1.875 * float(np.linalg.norm(end - start)) / speed, 0.1))

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        x = min(max(time / self.duration, 0.0), 1.0)
        done, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / self.duration
        way = self.end - self.start
        return Target(self.start + done * way, self.yaw, rate * way, 0.0)


@dataclass(frozen=True, eq=False)
class Along:
    """The action itself: along its path at the height of the grip."""

    path: ToolPath
    profile: Profile
    height: float
    """Of the TCP in the base frame, m."""

    @property
    def duration(self) -> float:
        """s."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        distance, rate = self.profile.at(time)
        length = self.profile.length
        x, y, yaw = self.path.tool_pose(np.array([distance / length - 0.5]))[0]
        yaw_rate = rate / length * self.path.turn
        velocity = rate / length * self.path.slide + yaw_rate * perpendicular(np.array([x, y]) - self.path.centre)
        return Target(np.array([x, y, self.height]), yaw, np.append(velocity, 0.0), yaw_rate)


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"]]:
    """Positions, m, and twists, m/s and rad/s, all along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, [0.0, 0.0, t.yaw_rate]) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists)
