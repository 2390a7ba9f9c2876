"""Messages between heft and the process that speaks Kortex. Imports nothing, so that any Python can read it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Configuration:
    """Connection to the arm."""

    address: str
    port: int = 10000
    username: str = "admin"
    password: str = "admin"
    silence: float = 0.1
    """Time without a request, or without feedback, after which a moving arm is stopped [s]; the arm itself is told to
    stop after as long a silence of the connection."""


@dataclass
class Feedback:
    """State of the arm by its own feedback."""

    time_s: float
    """Arrival [s], `time.monotonic`."""
    joint_position: list[float]
    """Joint angles [rad]."""
    joint_velocity: list[float]
    """Joint speeds [rad/s]."""
    tool_position: list[float]
    """Position of the TCP [m]."""
    tool_angles: list[float]
    """Turns of the tool about the fixed x, y and z axes, in this order [rad]."""
    tool_twist: list[float]
    """Linear and angular velocity of the tool [m/s, rad/s]."""
    gripper: float
    """Closed part of the stroke, 0 to 1; -1 without a gripper."""
    faulted: bool
    message: str
