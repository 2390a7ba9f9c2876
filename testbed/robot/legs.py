"""Legs of a trial's path: pose and velocity of the tool over the time since each began."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.lift import LiftProfile
from testbed.actions.path import Profile, ToolPath, minimum_jerk
from testbed.frames import perpendicular

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
    def aside(self) -> float:
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
class Along:
    """Leg of the action itself, at the height of the grip."""

    path: ToolPath
    profile: Profile
    height: float
    """Height of the TCP [m], base frame."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        distance, rate = self.profile.at(time)
        length = self.profile.length
        x, y, yaw = self.path.tool_pose(np.array([distance / length - 0.5]))[0]
        yaw_rate = rate / length * self.path.turn
        velocity = rate / length * self.path.slide + yaw_rate * perpendicular(np.array([x, y]) - self.path.centre)
        return Target(np.array([x, y, self.height]), yaw, np.append(velocity, 0.0), yaw_rate)


@dataclass(frozen=True, eq=False)
class AgainstFace:
    """Leg of a push: the fingertip's path, at constant yaw."""

    way: Float[np.ndarray, "N 2"]
    """Places of the TCP at even distances along it [m], base frame."""
    heading: Float[np.ndarray, "N"]
    """Direction of travel at each [rad]."""
    profile: Profile
    height: float
    """Height of the TCP [m], base frame."""
    yaw: float
    """Yaw of the closing direction [rad]."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        distance, rate = self.profile.at(time)
        along = np.linspace(0.0, self.profile.length, len(self.way))
        x, y, heading = (float(np.interp(distance, along, each)) for each in (*self.way.T, self.heading))
        velocity = rate * np.array([math.cos(heading), math.sin(heading), 0.0])
        return Target(np.array([x, y, self.height]), self.yaw, velocity, 0.0)


@dataclass(frozen=True, eq=False)
class InAir:
    """Leg of a lift: up from where it was gripped, tilts about the TCP, and down again."""

    hold: Float[np.ndarray, "3"]
    """Position of the TCP on the table [m], base frame."""
    yaw: float
    """Yaw of the closing direction while level [rad]."""
    axes: Float[np.ndarray, "3 3"]
    """The object's axes while level, rows, base frame."""
    profile: LiftProfile

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        height, rise, angle, rate = self.profile.at(time)
        return Target(self.hold + height * _UP, self.yaw, rise * _UP, 0.0, angle @ self.axes, rate @ self.axes)


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"], Float[np.ndarray, "N"]]:
    """Positions [m], twists [m/s, rad/s] and tilts from straight down [rad] along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, t.angular_velocity) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists), np.array([t.aside for t in targets])
