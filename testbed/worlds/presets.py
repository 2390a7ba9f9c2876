"""Worlds by name: how far table, object, arm and sensor are from the model of them; docs/worlds.md has the sources."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from typing import Annotated, Any

from pydantic import BeforeValidator

from testbed.errors import InvalidValueError, nearest
from testbed.validation import is_number
from testbed.worlds.setup_errors import SetupErrors


@dataclass(frozen=True)
class World:
    """Errors of a world, SI units: standard deviations unless a field says otherwise; 0 is exact.

    Nobody is told what is drawn from them: methods and policies are given `stated`.
    """

    name: str = "ideal"
    """Name of the preset."""
    contact_points: int = 0
    """Points on which a mass group rests, this many or one fewer, or 8 in a ring; 0: one under each particle."""
    flatness: float = 0.0
    """Height of each contact point [m]."""
    group_friction: float = 0.0
    """Friction of a mass group, as a part of the mean of its friction group."""
    place_friction: float = 0.0
    """Friction from place to place of the table, a smooth field, as a part of its mean."""
    anisotropy: float = 0.0
    """Friction along x of the table, as a part of the mean; along y it is as much less."""
    speed_friction: float = 0.0
    """Change of friction with a tenfold speed, as a part of it."""
    table_tilt: float = 0.0
    """Tilt of the table about each of its axes [rad]."""
    particle_offset: float = 0.0
    """Place of a mass group's particles along each axis [m]."""
    grasp_offset: float = 0.0
    """Place of the object in the hand along each axis, anew in every trial [m]."""
    grasp_angle: float = 0.0
    """Yaw of the object in the hand, anew in every trial [rad]."""
    start_offset: float = 0.0
    """Place where a trial begins along each axis of the table, which is known [m]."""
    start_angle: float = 0.0
    """Yaw at which a trial begins, which is known [rad]."""
    tcp_offset: float = 0.0
    """Place of the TCP along each axis of the hand [m]."""
    tcp_angle: float = 0.0
    """Yaw of the TCP in the hand [rad]."""
    encoder_noise: float = 0.0
    """Noise of each joint angle, per sample [rad]."""
    delay: float = 0.0
    """Greatest time by which poses are later than wrenches, drawn evenly from 0 [s]."""
    gain: float = 0.0
    """Gain of each axis of the sensor, as a part of itself."""
    crosstalk: float = 0.0
    """Signal of an axis that shows in each other, as a part of it, both over their full scales."""
    mounting_angle: float = 0.0
    """Rotation of the sensor about each of its axes [rad]."""
    low_pass: float = 0.0
    """Time constant of the sensor's filter, the same in every draw [s]."""
    force_resolution: float = 0.0
    """Step of the sensor's force, the same in every draw [N]."""
    torque_resolution: float = 0.0
    """Step of the sensor's torque, the same in every draw [N m]."""
    zero_factor: float = 1.0
    """Greatest factor of the sensor's bias and drift over those stated, up or down, drawn evenly in its logarithm."""
    tool_mass: float = 0.0
    """Mass of the tool [kg]."""
    tool_com: float = 0.0
    """Center of mass of the tool along each axis [m]."""
    scale: float = 0.0
    """Reading of the scale, beside the sensing preset's own error [kg]."""

    def __post_init__(self) -> None:
        for name in QUANTITIES:
            least = 1.0 if name == "zero_factor" else 0.0
            value = getattr(self, name)
            if not (is_number(value) and value >= least):
                raise InvalidValueError(f"World.{name}", value, f"a finite number >= {least:g}")
        if self.contact_points != int(self.contact_points) or self.contact_points in (1, 2, 3):
            raise InvalidValueError("World.contact_points", self.contact_points, "0, or an integer >= 4")

    @property
    def is_ideal(self) -> bool:
        """True if nothing in it errs."""
        return replace(self, name="ideal") == World()

    @property
    def stated(self) -> SetupErrors:
        """Errors as a lab states them: what a method or a policy may reckon with."""
        common = {f.name: getattr(self, f.name) for f in fields(SetupErrors)}
        return SetupErrors(**common | {"delay": self.delay / math.sqrt(3)})  # the root mean square

    def only(self, source: str) -> World:
        """The world in which nothing but one source of error, or one quantity, errs.

        Raises:
            InvalidValueError: no such source or quantity.
        """
        kept = SOURCES.get(source, (source,))
        if unknown := set(kept) - set(QUANTITIES):
            allowed = f"one of {', '.join(SOURCES)}, or a quantity{nearest(source, [*SOURCES, *QUANTITIES])}"
            raise InvalidValueError("world.only", unknown.pop(), allowed)
        return World(f"{self.name}: {source}", **{name: getattr(self, name) for name in kept})


QUANTITIES: tuple[str, ...] = tuple(f.name for f in fields(World) if f.name != "name")
"""Quantities of a world, in order."""

SOURCES: dict[str, tuple[str, ...]] = {
    "contacts": ("contact_points", "flatness"),
    "friction of groups": ("group_friction",),
    "friction by place": ("place_friction",),
    "friction by direction": ("anisotropy",),
    "friction by speed": ("speed_friction",),
    "tilt of the table": ("table_tilt",),
    "places of groups": ("particle_offset",),
    "grasp": ("grasp_offset", "grasp_angle"),
    "start": ("start_offset", "start_angle"),
    "TCP": ("tcp_offset", "tcp_angle"),
    "encoders, delay": ("encoder_noise", "delay"),
    "gain": ("gain",),
    "cross-talk": ("crosstalk",),
    "mounting": ("mounting_angle",),
    "filter, steps, zero": ("low_pass", "force_resolution", "torque_resolution", "zero_factor"),
    "tool, scale": ("tool_mass", "tool_com", "scale"),
}
"""Quantities of each source of error, for a budget of them."""

_LAB = World(
    "lab",
    contact_points=4,
    flatness=1e-4,
    group_friction=0.03,
    place_friction=0.03,
    anisotropy=0.05,
    speed_friction=0.02,
    table_tilt=math.radians(0.35),
    particle_offset=0.0007,
    grasp_offset=0.0007,
    grasp_angle=math.radians(0.5),
    start_offset=0.015,
    start_angle=math.radians(10),
    tcp_offset=0.0007,
    tcp_angle=math.radians(0.3),
    encoder_noise=1e-4,
    delay=0.02,
    gain=0.01,
    crosstalk=0.01,
    mounting_angle=math.radians(0.6),
    low_pass=0.01,
    force_resolution=0.01,
    torque_resolution=0.001,
    zero_factor=2.0,
    tool_mass=0.01,
    tool_com=0.0012,
    scale=0.005,
)

WORLDS: dict[str, World] = {
    each.name: each
    for each in (
        World(),
        _LAB,
        replace(
            _LAB,
            name="rough",
            flatness=2e-4,
            group_friction=0.08,
            place_friction=0.06,
            anisotropy=0.10,
            speed_friction=0.05,
            grasp_offset=0.0014,
            grasp_angle=math.radians(1.0),
            start_offset=0.02,
            gain=0.02,
            crosstalk=0.02,
        ),
    )
}
"""Worlds by name: `ideal`, `lab`, `rough`."""


def stated_setup(table: Any) -> Any:
    """Setup of a [setup] table: the errors that a world of that `preset` states, any of them changed by name.

    Raises:
        InvalidValueError: no such world, or no such error.
    """
    if not isinstance(table, dict):
        return table
    given = dict(table)
    known = [f.name for f in fields(SetupErrors)]
    base = world(given.pop("preset", "ideal")).stated
    if unknown := [name for name in given if name not in known]:
        raise InvalidValueError("setup", unknown, f"preset, {', '.join(known)}{nearest(unknown[0], known)}")
    return replace(base, **given)


StatedSetup = Annotated[SetupErrors, BeforeValidator(stated_setup)]
"""A [setup] table of a mapping or of a robot file."""


def world(name: str) -> World:
    """World by name.

    Raises:
        InvalidValueError: no such world.
    """
    if name not in WORLDS:
        raise InvalidValueError("world", name, f"one of {', '.join(WORLDS)}{nearest(name, WORLDS)}")
    return WORLDS[name]
