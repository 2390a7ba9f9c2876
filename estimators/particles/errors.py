"""Errors of the particle model, stated once: every method weighs its data by them, and its error bars hold them."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.validation import check_positive, is_number


@dataclass(frozen=True)
class ModelErrors:
    """Standard deviations of the particle model, measured with a perfect sensor and known masses."""

    pivot_error: float = 5e-5
    """Center of a turn, m."""
    force_error: float = 0.0001
    """Force, as a part of the total drag."""
    torque_error: float = 0.00055
    """Torque, as a part of itself."""
    height_error: float = 0.0009
    """Height of the TCP over the feet, m."""
    lift_error: float = 0.06
    """Vertical force of a nulled gripper that the sensor cannot tell, N."""
    tilt_error: float = 0.0005
    """Moment of a nulled gripper that the sensor cannot tell, N m."""
    inertia_error: float = 0.007
    """I_j, as a part of itself: once of each, and once of all together."""
    weight_error: float = 1e-3
    """Weighing, kg."""

    def __post_init__(self) -> None:
        for field in fields(ModelErrors):
            value = getattr(self, field.name)
            if not (is_number(value) and value >= 0):
                raise InvalidValueError(f"{type(self).__name__}.{field.name}", value, "a finite number >= 0")
        check_positive(f"{type(self).__name__}.weight_error", self.weight_error)

    @property
    def nulled(self) -> Float[np.ndarray, "3"]:
        """Mean lift and moments of a nulled gripper over a trial, N and N m."""
        return np.array([self.lift_error, self.tilt_error, self.tilt_error])


EXACT = ModelErrors(
    pivot_error=0.0,
    force_error=0.0,
    torque_error=0.0,
    height_error=0.0,
    lift_error=0.0,
    tilt_error=0.0,
    inertia_error=0.0,
)
"""Errors of a perfect model: the weighing's alone."""
RIGID = ModelErrors(force_error=0.0025, torque_error=0.003, lift_error=0.8, tilt_error=0.07, inertia_error=0.06)
"""Errors under one rigid body: its loads are not quite affine over the feet, and a gripper that is nulled before the
motion carries far more of a body that cannot give way to it than of blocks that slide apart."""
