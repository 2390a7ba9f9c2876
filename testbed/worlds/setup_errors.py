"""Errors of a setup that a lab states: table, grasp, arm and sensor, beside the sensor's data sheet."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from testbed.worlds.parameters import parameter, parameters_of


@dataclass(frozen=True, kw_only=True)
class SetupErrors:
    """Stated standard deviations of a setup, SI units; 0 is exact. The values drawn for a trial are not part of it.

    In an estimate, contact errors belong to an object, grasp errors to a trial, and all others to the whole setup.
    """

    contact_points: float = parameter(
        source="contacts",
        shape=("groups",),
        scope="object",
        most=1000,
        likely=3,
        cause="the object touches the table at few points: state `contact_points`",
        shown=(1.0, "of a pattern of 3 points"),
    )
    """Points, anywhere under it, on which each mass group rests; 0: on every particle, as the paper assumes.

    It does not apply to an object on feet of known places.
    """
    foot_offset: float = parameter(
        shows=("table",),
        source="contacts",
        unit="m",
        shape=("feet", 2),
        scope="object",
        likely=0.001,
        cause="the feet are not where the object file states: measure them",
    )
    """Place of each known foot along each axis [m]."""
    foot_load: float = parameter(
        source="contacts",
        shape=("feet",),
        scope="object",
        likely=0.3,
        cause="the feet of a group carry unequal loads: make them alike, or state `foot_load`",
    )
    """Load of each known foot, as a part of an even share of its group's load."""
    group_friction: float = parameter(
        shows=("table",),
        source="friction of groups",
        shape=("groups",),
        scope="object",
        cause="groups differ in friction: state `group_friction`",
    )
    """Friction of a mass group, as a part of the mean of its friction group."""
    place_friction: float = parameter(
        shows=("table",),
        shape=(196,),
        source="friction by place",
        likely=0.05,
        cause="friction differs over the table: clean it, or state `place_friction`",
    )
    """Friction from place to place of the table, as a part of its mean."""
    anisotropy: float = parameter(
        shows=("table",),
        source="friction by direction",
        shape=(2,),
        likely=0.05,
        cause="friction differs by direction: state `anisotropy`",
    )
    """Friction along one axis of the table over the mean, as a part of it; across it is as much less."""
    speed_friction: float = parameter(
        shows=("table",),
        source="friction by speed",
        likely=0.03,
        cause="friction changes with speed: turn at one speed, or state `speed_friction`",
    )
    """Change of friction with a tenfold speed, as a part of it."""
    friction_law: float = parameter(
        shows=("table",),
        shape=(3,),
        scope="trial",
        cause="friction departs from Coulomb's law: state `friction_law`",
    )
    """Departure of friction from Coulomb's law, anew in every trial and again in every window of it, as a part of it:
    of its force along itself, of its force across, and of its torque about the middle of the contact."""
    table_tilt: float = parameter(
        shows=("table", "air"),
        source="tilt of the table",
        unit="rad",
        shape=(2,),
        likely=0.006,
        cause="the table is tilted: level it",
    )
    """Tilt of the table about each of its axes [rad]."""
    particle_offset: float = parameter(
        shows=("table", "air"),
        source="places of groups",
        unit="m",
        shape=("groups", 2),
        scope="object",
        likely=0.001,
        cause="the groups are elsewhere than stated: measure the object",
    )
    """Place of a mass group's particles along each axis [m]."""
    grasp_offset: float = parameter(
        shows=("table", "air"),
        source="grasp",
        unit="m",
        shape=(2,),
        scope="trial",
        likely=0.001,
        cause="the object is held beside its grasp points: measure the grasps",
    )
    """Place of the object in the hand along each axis, anew in every trial [m]."""
    grasp_angle: float = parameter(
        shows=("table", "air"),
        source="grasp",
        unit="rad",
        scope="trial",
        likely=0.015,
        cause="the object is turned in the hand: measure the grasps",
    )
    """Yaw of the object in the hand, anew in every trial [rad]."""
    tcp_offset: float = parameter(
        shows=("table", "air"),
        source="TCP",
        unit="m",
        shape=(3,),
        likely=0.001,
        cause="the TCP is elsewhere than stated: measure it",
    )
    """Place of the TCP along each axis of the hand [m]."""
    tcp_angle: float = parameter(
        shows=("table", "air"),
        source="TCP",
        unit="rad",
        likely=0.01,
        cause="the hand closes along another direction than stated: check the hand's yaw",
    )
    """Yaw of the TCP in the hand [rad]."""
    gain: float = parameter(
        shows=("reading",), source="gain", shape=(6,), likely=0.015, cause="the sensor's gain is off: calibrate it"
    )
    """Gain error of each axis of the sensor, as a part of the gain."""
    crosstalk: float = parameter(
        shows=("reading",),
        source="cross-talk",
        shape=(6, 6),
        likely=0.01,
        cause="the sensor's axes feed into each other: calibrate it",
    )
    """Signal of each axis in the reading of another, as a part of it, both relative to their full scales."""
    mounting_angle: float = parameter(
        shows=("reading",),
        source="mounting",
        unit="rad",
        shape=(3,),
        likely=0.015,
        cause="the sensor is mounted at another angle than stated: check its rotation",
    )
    """Rotation of the sensor about each of its axes [rad]."""
    delay: float = parameter(
        shows=("air",), source="encoders, delay", unit="s", likely=0.02, cause="poses come late: align the clocks"
    )
    """Delay of poses behind wrenches [s]. On the table hand and object are late together, which shows nothing."""
    tool_mass: float = parameter(shows=("air",), source="tool, scale", unit="kg")
    """Mass of the tool, which affects the wrench when it is tilted [kg]."""
    tool_com: float = parameter(shows=("air",), source="tool, scale", unit="m", shape=(3,))
    """Center of mass of the tool along each axis, likewise [m]."""
    scale: float = parameter(source="tool, scale", unit="kg")
    """Reading of the scale, beside the sensor's own error [kg]."""

    def __post_init__(self) -> None:
        for name, described in parameters_of(type(self)).items():
            described.check(f"{type(self).__name__}.{name}", getattr(self, name))

    @staticmethod
    def largest(setups: Sequence[SetupErrors]) -> SetupErrors:
        """Setup with the largest error of each kind among `setups`; an exact one without any."""
        if len(set(setups)) < 2:
            return setups[0] if setups else EXACT_SETUP
        return SetupErrors(**{name: max(getattr(each, name) for each in setups) for name in PARAMETERS})

    def place_error(self, *, on_feet: bool) -> float:
        """Root mean square distance of a known point of contact from its stated place beside the center of a turn [m].

        Args:
            on_feet: True for feet of known places, which have an error of their own.
        """
        along = math.hypot(self.grasp_offset, self.tcp_offset, self.particle_offset, on_feet * self.foot_offset)
        return math.sqrt(2) * along

    @property
    def none(self) -> bool:
        """True for a setup without errors."""
        return all(getattr(self, name) == each.least for name, each in parameters_of(type(self)).items())


PARAMETERS = parameters_of(SetupErrors)
"""Parameters that a setup may state, by name."""
EXACT_SETUP = SetupErrors()
"""Setup without errors."""
LIKELY = SetupErrors(**{name: described.likely for name, described in PARAMETERS.items()})
"""Errors that a setup may have without stating them, for the comparison of causes of a misfit."""
