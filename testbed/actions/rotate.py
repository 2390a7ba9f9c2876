"""Grasp-and-rotate at constant speed."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar

import numpy as np
from jaxtyping import Float

from testbed.actions.base import ActionWords, TableAction
from testbed.actions.path import Steady
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive_fields, frozen_array

FARTHEST = 10.0
"""Largest coordinate of the center of a turn [m]."""


@dataclass(frozen=True)
class Rotate(TableAction, kind="rotate"):
    """Grasp-and-rotate at constant speed: one turn of the paper, 10 deg/s for 18 s; or there and back."""

    turns: ClassVar[bool] = True

    speed: float = math.radians(10)
    """Angular speed [rad/s]; positive turns counter-clockwise seen from above."""
    duration: float = 18.0
    """Time at constant speed [s]."""
    pivot: tuple[float, float] | None = None
    """Center of the turn [m], object frame; None is the grasp point."""
    back: bool = False
    """Turn back again in the same grasp, after one tare: friction changes sign, the bias left by the tare does not."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self._check_nonzero("speed")
        check_positive_fields(self, "duration")
        if not isinstance(self.back, bool):
            raise InvalidValueError("Rotate.back", self.back, "true or false")
        if self.pivot is not None:
            place = frozen_array("Rotate.pivot", self.pivot, (2,))
            if np.abs(place).max() > FARTHEST:
                raise InvalidValueError("Rotate.pivot", self.pivot, f"within {FARTHEST:g} m of the object's origin")
            object.__setattr__(self, "pivot", tuple(place.tolist()))

    @property
    def steady(self) -> tuple[Steady, ...]:
        """The turn, and the turn back."""
        there, back = (Steady(speed, 0.0, self.duration) for speed in (self.speed, -self.speed))
        return (there, back) if self.back else (there,)

    def center(self, shape: ObjectShape) -> Float[np.ndarray, "2"]:
        """Center of the turn [m], object frame."""
        return super().center(shape) if self.pivot is None else np.array(self.pivot)

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        x, y = self.center(shape)
        way = f"{'left' if self.speed > 0 else 'right'}{' and back' if self.back else ''}"
        return ActionWords(
            "turn", f"({1e3 * x:.0f}, {1e3 * y:.0f})", f"{way}, {math.degrees(abs(self.speed)):.0f} deg/s"
        )
