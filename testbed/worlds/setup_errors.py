"""Stated errors of a setup: what a lab says of its table, grasp, arm and sensor, beside the sensor's data sheet."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields

from testbed.errors import InvalidValueError
from testbed.validation import is_number


@dataclass(frozen=True)
class SetupErrors:
    """Standard deviations of a setup as stated, SI units; 0 is exact. What was drawn for a trial is never in it.

    Of an estimate, a contact error belongs to an object, a grasp error to a trial, and all others to the whole setup.
    """

    contact_points: float = 0.0
    """Points, anywhere under it, on which each mass group rests; 0: on every particle, as the paper assumes."""
    group_friction: float = 0.0
    """Friction of a mass group, as a part of the mean of its friction group."""
    place_friction: float = 0.0
    """Friction from place to place of the table, as a part of its mean."""
    anisotropy: float = 0.0
    """Friction in a direction of the table, as a part of the mean over all directions."""
    speed_friction: float = 0.0
    """Change of friction with a tenfold speed, as a part of itself."""
    table_tilt: float = 0.0
    """Tilt of the table about each of its axes [rad]."""
    particle_offset: float = 0.0
    """Place of a mass group's particles along each axis [m]."""
    grasp_offset: float = 0.0
    """Place of the object in the hand along each axis, anew in every trial [m]."""
    grasp_angle: float = 0.0
    """Yaw of the object in the hand, anew in every trial [rad]."""
    tcp_offset: float = 0.0
    """Place of the TCP along each axis of the hand [m]."""
    tcp_angle: float = 0.0
    """Yaw of the TCP in the hand [rad]."""
    gain: float = 0.0
    """Gain of each axis of the sensor, as a part of itself."""
    crosstalk: float = 0.0
    """Signal of an axis that shows in each other, as a part of it."""
    mounting_angle: float = 0.0
    """Rotation of the sensor about each of its axes [rad]."""
    delay: float = 0.0
    """Time by which poses are later than wrenches [s]."""
    tool_mass: float = 0.0
    """Mass of the tool, which shows where it is tilted [kg]."""
    tool_com: float = 0.0
    """Center of mass of the tool along each axis, which shows there too [m]."""
    scale: float = 0.0
    """Reading of the scale, beside the sensor's own error [kg]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (is_number(value) and value >= 0):
                raise InvalidValueError(f"SetupErrors.{name}", value, "a finite number >= 0")

    @staticmethod
    def largest(setups: Sequence[SetupErrors]) -> SetupErrors:
        """The largest error of each kind among some setups."""
        if len(set(setups)) == 1:
            return setups[0]
        return SetupErrors(**{f.name: max(getattr(each, f.name) for each in setups) for f in fields(SetupErrors)})

    @property
    def none(self) -> bool:
        """True if the setup is exact."""
        return not any(getattr(self, field.name) for field in fields(self))


EXACT_SETUP = SetupErrors()
"""Setup without errors."""
