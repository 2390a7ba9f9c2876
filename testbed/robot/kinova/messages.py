"""What heft and the process beside it tell each other. Imports nothing, so that any Python can read it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Configuration:
    """How to reach the arm."""

    address: str
    port: int = 10000
    username: str = "admin"
    password: str = "admin"
    silence: float = 0.1
    """Time without a request, or without feedback, after which a moving arm is stopped; the arm itself is told to stop
    where nothing comes over the connection for as long, s."""


@dataclass
class Feedback:
    """What the arm says of itself."""

    time_s: float
    """`time.monotonic` when it arrived, s."""
    joint_position: list[float]
    """rad."""
    joint_velocity: list[float]
    """rad/s."""
    tool_position: list[float]
    """m."""
    tool_angles: list[float]
    """About the fixed x, y and z axes, in this order, rad."""
    tool_twist: list[float]
    """m/s and rad/s."""
    gripper: float
    """Part of the way closed, 0 to 1; -1 without a gripper."""
    faulted: bool
    message: str
