"""Legs of a trial's path: pose and velocity of the tool over the time since each began."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.path import ToolPath, minimum_jerk

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class Target:
    """Desired pose and velocity of the tool, base frame."""

    position: Float[np.ndarray, "3"]
    """Position of the TCP [m]."""
    yaw: float
    """Yaw of the closing direction [rad]."""
    velocity: Float[np.ndarray, "3"]
    """Velocity of the TCP [m/s]."""
    yaw_rate: float
    """Rate of the yaw [rad/s]."""
    tilt: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Rotation vector that turns the tool from straight down at that yaw [rad], base axes."""
    tilt_rate: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Rate of `tilt`, whose direction is constant [rad/s]."""

    @property
    def angular_velocity(self) -> Float[np.ndarray, "3"]:
        """Angular velocity of the tool [rad/s]."""
        return np.array([0.0, 0.0, self.yaw_rate]) + self.tilt_rate

    @property
    def tilt_angle(self) -> float:
        """Angle of the approach axis from straight down [rad]."""
        return math.acos(float(np.clip(Rotation.from_rotvec(self.tilt).as_matrix()[2, 2], -1.0, 1.0)))


class Leg(Protocol):
    """A stretch of the path."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        ...

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        ...


@dataclass(frozen=True, eq=False)
class Line:
    """Straight leg from rest to rest with least jerk, at constant yaw."""

    start: Float[np.ndarray, "3"]
    """First position [m]."""
    end: Float[np.ndarray, "3"]
    """Last position [m]."""
    yaw: float
    """Yaw of the closing direction [rad]."""
    duration: float
    """Duration [s]."""

    @classmethod
    def at_most(cls, start: np.ndarray, end: np.ndarray, yaw: float, speed: float) -> Self:
        """Line of greatest speed `speed` [m/s]."""
        return cls(start, end, yaw, max(1.875 * float(np.linalg.norm(end - start)) / speed, 0.1))

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        x = min(max(time / self.duration, 0.0), 1.0)
        (done, rate), way = minimum_jerk(x), self.end - self.start
        return Target(self.start + done * way, self.yaw, rate / self.duration * way, 0.0)


@dataclass(frozen=True, eq=False)
class Acting:
    """Leg of the action itself."""

    path: ToolPath
    height: float
    """Height of the TCP where the grip holds [m], base frame."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.path.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        pose, rate = self.path.at(time)
        return Target(pose[:3] + self.height * _UP, float(pose[3]), rate[:3], float(rate[3]), pose[4:], rate[4:])


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"], Float[np.ndarray, "N"]]:
    """Positions [m], twists [m/s, rad/s] and tilts from straight down [rad] along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, t.angular_velocity) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists), np.array([t.tilt_angle for t in targets])
