"""Settings of the simulation: contact, grip, servo. Each default was measured; see docs/simulation.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from testbed.errors import InvalidValueError
from testbed.validation import check_positive_fields

MARGIN = 0.8
"""Usable part of a grip limit, since the estimate before a trial is quasi-static."""


@dataclass(frozen=True)
class ContactSettings:
    """Contact of a foot with the table: a soft normal spring and Coulomb friction.

    MuJoCo's convex contact couples slip to lift: it accelerates a sliding foot upward by friction * friction_damping *
    speed, against the contact's stiffness. A small impedance makes that lift a negligible part of the weight; a large
    friction damping keeps the force opposite to the velocity while the velocity turns.
    """

    sag: float = 0.001
    """Depth by which the object sinks under its own weight [m]: compliance of the foundation, as of thin felt."""
    impedance: float = 1e-4
    """Constraint impedance of the normal direction, 0 to 1."""
    friction_damping: float = 50.0
    """Rate at which friction opposes slip [1/s]: friction opposes acceleration + rate * speed."""
    impratio: float = 1e4
    """Ratio of friction's stiffness to that of the normal direction, large so that sticking contacts do not creep."""
    foot_radius: float = 0.002
    """Radius of a foot's sphere [m]."""

    def __post_init__(self) -> None:
        check_positive_fields(self, "sag", "friction_damping", "impratio", "foot_radius")
        if not 1e-4 <= self.impedance < 1:
            raise InvalidValueError("ContactSettings.impedance", self.impedance, "a number from 1e-4 to below 1")


@dataclass(frozen=True)
class GripSettings:
    """Grip of the object."""

    mode: Literal["friction", "weld"] = "friction"
    """Friction between pads and faces, or a weld for studies without slip."""
    force: float = 120.0
    """Force of each finger [N]; the 2F-85 gives 20 to 235."""
    friction: float = 0.6
    """Friction of the pads: the lower of two published values."""
    pad_damping: float = 2.0
    """Damping ratio of the pads against a face."""
    friction_damping: float = 5000.0
    """Rate at which the pads' friction opposes slip [1/s], large so that a turned object does not creep in the grip."""
    tcp_height: float = 0.022
    """Height of the TCP over the table while holding [m]: the pads clear the table by 3 mm."""

    def __post_init__(self) -> None:
        if self.mode not in ("friction", "weld"):
            raise InvalidValueError("GripSettings.mode", self.mode, "friction or weld")
        check_positive_fields(self, "force", "friction", "pad_damping", "friction_damping", "tcp_height")


@dataclass(frozen=True)
class ServoSettings:
    """Outer loop of the arm, at the sensor's rate."""

    integral_gain: float = 5.0
    """Integral gain on a joint's position error [1/s]; 0 leaves the bare position loop."""
    null_gain: float = 1.0
    """Gain of nulling vertical load and tilt after the grip closes; 0 turns it off."""
    null_time: float = 1.5
    """Time for nulling [s]."""
    comply_gain: float = 0.0
    """Gain of nulling while the object moves; 0 turns it off."""


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of the simulation."""

    timestep: float = 0.005
    """Physics step [s]; a sample is a whole number of steps."""
    rate: float = 100.0
    """Rate of the record and of the outer loop [Hz]."""
    contact: ContactSettings = ContactSettings()
    """Contact between feet and table."""
    grip: GripSettings = GripSettings()
    """Grip between pads and object."""
    servo: ServoSettings = ServoSettings()
    """Outer loop of the arm."""

    def __post_init__(self) -> None:
        check_positive_fields(self, "rate", "timestep")
        if self.steps < 1 or abs(self.steps * self.timestep * self.rate - 1) > 1e-9:
            allowed = f"{1 / self.rate:g} s, the time between samples, or a whole part of it"
            raise InvalidValueError("SimulationSettings.timestep", self.timestep, allowed)

    @property
    def steps(self) -> int:
        """Physics steps per sample."""
        return round(1 / self.rate / self.timestep)
