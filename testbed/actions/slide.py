"""Grasp-and-slide along a straight line."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.actions.base import ActionWords, TableAction
from testbed.actions.path import Steady
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive_fields, is_number


@dataclass(frozen=True)
class Slide(TableAction, kind="slide"):
    """Grasp-and-slide along a straight line at constant speed: 5 cm/s for 4 s in the paper."""

    direction: float = 0.0
    """Direction of travel [rad], object frame."""
    speed: float = 0.05
    """Speed [m/s]."""
    duration: float = 4.0
    """Time at constant speed [s]."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive_fields(self, "speed", "duration")
        if not is_number(self.direction):
            raise InvalidValueError("Slide.direction", self.direction, "a finite angle, rad")

    @property
    def steady(self) -> tuple[Steady, ...]:
        """The stretch at constant speed."""
        return (Steady(self.speed, 0.0, self.duration),)

    @property
    def heading(self) -> Float[np.ndarray, "2"]:
        """Unit vector of the direction of travel, object frame."""
        return np.array([math.cos(self.direction), math.sin(self.direction)])

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        return ActionWords("slide", manner=f"towards {math.remainder(math.degrees(self.direction), 360.0):z.0f} deg")
