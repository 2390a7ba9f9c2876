"""Turns whose angular acceleration steps through several values."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np

from testbed.actions.base import ActionWords, TableAction
from testbed.actions.path import Steady
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive_fields, frozen_array


@dataclass(frozen=True)
class Accelerate(TableAction, kind="accelerate"):
    """A turn about the grasp point whose angular acceleration steps through several values of both signs.

    The paper's "apply various torque": the slope of torque against acceleration is I_j (Eq. dvp).
    """

    turns: ClassVar[bool] = True
    accelerated: ClassVar[bool] = True

    accelerations: tuple[float, ...] = (1.0, -1.0, 1.5, -1.5, 0.5, -0.5, 1.5, -1.5)
    """Angular accelerations [rad/s^2], held one after the other."""
    hold: float = 0.6
    """Time at each acceleration [s]."""
    start_speed: float = 0.15
    """Angular speed before the first acceleration [rad/s]; its sign is that of the whole turn, which never reverses."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive_fields(self, "hold")
        self._check_nonzero("start_speed")
        values = tuple(frozen_array("Accelerate.accelerations", self.accelerations, (None,)).tolist())
        if not (any(a > 0 for a in values) and any(a < 0 for a in values)):
            raise InvalidValueError(
                "Accelerate.accelerations", self.accelerations, "finite numbers of both signs, rad/s^2"
            )
        object.__setattr__(self, "accelerations", values)
        speeds = self.start_speed + np.concatenate([[0.0], np.cumsum(values) * self.hold])
        if (speeds * np.sign(self.start_speed) <= 0).any():
            raise InvalidValueError(
                "Accelerate.accelerations",
                self.accelerations,
                "a sequence that never stops or reverses the turn: friction would flip",
            )

    @property
    def steady(self) -> tuple[Steady, ...]:
        """A stretch for each acceleration."""
        found = [Steady(self.start_speed, self.accelerations[0], self.hold)]
        for acceleration in self.accelerations[1:]:
            found.append(Steady(found[-1].end_speed, acceleration, self.hold))
        return tuple(found)

    def reversed(self) -> Self:
        """The turn in the other direction."""
        return replace(self, accelerations=tuple(-a for a in self.accelerations), start_speed=-self.start_speed)

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        return ActionWords("accelerate", manner="left" if self.start_speed > 0 else "right")
