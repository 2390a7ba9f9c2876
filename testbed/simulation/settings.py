"""Settings of the simulated bench: contact, grip, servo. Each default was measured; see docs/simulation.md."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from testbed.errors import InvalidValueError
from testbed.validation import check_positive

MARGIN = 0.8
"""Part of a limit of grip that may be used: what is estimated beforehand is quasi-static."""


@dataclass(frozen=True)
class ContactSettings:
    """Contact of a foot with the table: a soft spring in the normal direction and Coulomb friction across it.

    MuJoCo's convex contact couples slip to lift: a sliding foot is pushed up by friction * friction_damping * speed
    (an acceleration), against the contact's own stiffness. A small impedance makes that lift a negligible part of the
    weight; a large friction damping keeps the force opposite to the velocity while the velocity turns. Both are wanted.
    """

    sag: float = 0.001
    """How far the object sinks into its pads under its own weight, m: the foundation's softness, as of thin felt."""
    impedance: float = 0.01
    """Constant constraint impedance of the normal direction, 0..1."""
    friction_damping: float = 100.0
    """Rate at which friction opposes slip, 1/s; its direction errs by turn rate / this, rad."""
    impratio: float = 1e4
    """Stiffness of friction against that of the normal direction: sticking feet and pads do not creep."""
    foot_radius: float = 0.002
    """Radius of a foot's sphere, m."""

    def __post_init__(self) -> None:
        for name in ("sag", "friction_damping", "impratio", "foot_radius"):
            check_positive(f"ContactSettings.{name}", getattr(self, name))
        if not 1e-4 <= self.impedance < 1:
            raise InvalidValueError("ContactSettings.impedance", self.impedance, "a number from 1e-4 to below 1")


@dataclass(frozen=True)
class GripSettings:
    """How the gripper holds the object."""

    mode: Literal["friction", "weld"] = "friction"
    """Friction between pads and faces, or a weld for studies without slip."""
    force: float = 120.0
    """Force at each finger, N; the 2F-85 gives 20 to 235."""
    friction: float = 0.6
    """Pad friction: the lower of the two published values."""
    pad_damping: float = 2.0
    """Damping ratio of the pads against a face. At 1 what is held swings at 80 to 120 Hz in some turns about a point by
    light blocks, faster at smaller steps: the arm's damping is explicit. From 1.5 up nothing does."""
    tcp_height: float = 0.022
    """Height of the TCP over the table while holding, m: the pads clear the table by 3 mm."""


@dataclass(frozen=True)
class ServoSettings:
    """The arm's outer loop, run at the sensor's rate."""

    integral_gain: float = 5.0
    """Rate at which a joint's position error is integrated away, 1/s; 0 leaves the bare position loop."""
    null_gain: float = 1.0
    """Gain of nulling vertical load and tilt after the grip closes; 0 leaves them."""
    null_time: float = 1.5
    """Time for nulling, s."""
    comply_gain: float = 0.0
    """As null_gain, while the object moves."""


@dataclass(frozen=True)
class SimulationSettings:
    """All settings of the simulated bench."""

    timestep: float = 0.001
    """Physics step, s."""
    rate: float = 100.0
    """Record rate of the sensor and of the outer loop, Hz."""
    contact: ContactSettings = ContactSettings()
    """Between feet and table."""
    grip: GripSettings = GripSettings()
    """Between pads and object."""
    servo: ServoSettings = ServoSettings()
    """Of the arm."""
