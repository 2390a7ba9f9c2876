"""Worlds by name: errors of table, object, arm and sensor relative to their models; sources are in docs/worlds.md."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Annotated, Any

from pydantic import BeforeValidator

from testbed.errors import InvalidValueError, nearest
from testbed.worlds.parameters import parameter, parameters_of
from testbed.worlds.setup_errors import PARAMETERS, SetupErrors


@dataclass(frozen=True, kw_only=True)
class World(SetupErrors):
    """Errors of a world, SI units: standard deviations unless a field says otherwise; 0 is exact.

    Draws are hidden from every method and policy, which have `stated` only. `delay` is the greatest delay, drawn
    uniformly from 0. A group has `contact_points` points, one fewer, or a ring of 8.
    """

    name: str = "ideal"
    """Name of the preset."""
    flatness: float = parameter(source="contacts", unit="m", scope="object")
    """Height of each contact point [m]; that of known feet is in `foot_load`."""
    start_offset: float = parameter(source="start", unit="m", shape=(2,), scope="trial", most=10.0)
    """Place where a trial begins along each axis of the table, which is known [m]."""
    start_angle: float = parameter(source="start", unit="rad", scope="trial", most=math.pi)
    """Yaw at which a trial begins, which is known [rad]."""
    encoder_noise: float = parameter(source="encoders, delay", unit="rad", shape=(7,), scope="sample")
    """Noise of each joint angle, per sample [rad]."""
    low_pass: float = parameter(source="filter, steps, zero", unit="s")
    """Time constant of the sensor's filter, the same in every draw [s]."""
    force_resolution: float = parameter(source="filter, steps, zero", unit="N")
    """Step of the sensor's force, the same in every draw [N]."""
    torque_resolution: float = parameter(source="filter, steps, zero", unit="N m")
    """Step of the sensor's torque, the same in every draw [N m]."""
    zero_factor: float = parameter(1.0, source="filter, steps, zero", shape=(2,), most=100.0)
    """Greatest factor of the sensor's bias and drift over those stated, up or down, drawn evenly in its logarithm."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.contact_points != int(self.contact_points) or self.contact_points in (1, 2, 3):
            raise InvalidValueError("World.contact_points", self.contact_points, "0, or an integer >= 4")
        for name, described in PARAMETERS.items():
            if getattr(self, name) and not described.source:
                raise InvalidValueError(f"World.{name}", getattr(self, name), "0: no simulation draws it")

    @property
    def stated(self) -> SetupErrors:
        """Errors as a lab states them, which methods and policies may use."""
        common = {name: getattr(self, name) for name in PARAMETERS}
        return SetupErrors(**common | {"delay": self.delay / math.sqrt(3)})  # drawn evenly from 0 to `delay`

    def only(self, source: str) -> World:
        """World with the errors of a single source, or a single quantity.

        Raises:
            InvalidValueError: no such source or quantity.
        """
        kept = SOURCES.get(source, (source,))
        if unknown := set(kept) - set(QUANTITIES):
            allowed = f"one of {', '.join(SOURCES)}, or a quantity{nearest(source, [*SOURCES, *QUANTITIES])}"
            raise InvalidValueError("world.only", unknown.pop(), allowed)
        return World(name=f"{self.name}: {source}", **{name: getattr(self, name) for name in kept})


QUANTITIES = {name: each for name, each in parameters_of(World).items() if each.source}
"""Quantities of a world that a simulation draws, by name."""
SOURCES: dict[str, tuple[str, ...]] = {
    source: tuple(name for name, each in QUANTITIES.items() if each.source == source)
    for source in dict.fromkeys(each.source for each in QUANTITIES.values())
}
"""Quantities of each source of error, for an error budget."""

_LAB = World(
    name="lab",
    contact_points=4,
    foot_offset=0.0005,
    foot_load=0.2,
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
            foot_offset=0.001,
            foot_load=0.4,
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


UNSTATED = SetupErrors(
    contact_points=6,
    foot_offset=0.0003,
    foot_load=0.1,
    group_friction=0.02,
    place_friction=0.02,
    anisotropy=0.03,
    speed_friction=0.01,
    friction_law=0.1,
    table_tilt=math.radians(0.2),
    particle_offset=0.0005,
    grasp_offset=0.0005,
    grasp_angle=math.radians(0.3),
    tcp_offset=0.0005,
    tcp_angle=math.radians(0.2),
    gain=0.005,
    crosstalk=0.005,
    mounting_angle=math.radians(0.3),
    delay=0.005,
    tool_mass=0.005,
    tool_com=0.0006,
    scale=0.002,
)
"""Errors of a setup that states none, about half of those of a lab. Ours; with `preset = "ideal"` it is exact."""


def stated_setup(table: Any) -> Any:
    """Setup of a [setup] table: the errors that the world `preset` states, replaced by those given by name.

    Without a preset, errors that are not named have the sizes of `UNSTATED`.

    Raises:
        InvalidValueError: no such world, or no such error.
    """
    if not isinstance(table, dict):
        return table
    given = dict(table)
    known = list(PARAMETERS)
    base = world(given.pop("preset"), "preset").stated if "preset" in given else UNSTATED
    if unknown := [name for name in given if name not in known]:
        raise InvalidValueError("setup", unknown, f"preset, {', '.join(known)}{nearest(unknown[0], known)}")
    return replace(base, **given)


StatedSetup = Annotated[SetupErrors, BeforeValidator(stated_setup)]
"""A [setup] table of a mapping or of a robot file."""


def world(name: str, field: str = "world") -> World:
    """World by name; `field` names it in an error.

    Raises:
        InvalidValueError: no such world.
    """
    if not isinstance(name, str) or name not in WORLDS:
        raise InvalidValueError(field, name, f"one of {', '.join(WORLDS)}{nearest(str(name), WORLDS)}")
    return WORLDS[name]
