"""Moments of inertia I_j about the pivots of accelerated turns, Eq. dvp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.objects.model import ObjectShape


@dataclass(frozen=True, eq=False)
class PivotInertia:
    """Moments of inertia I_j about the pivots j in S."""

    pivot: Float[np.ndarray, "J 2"]
    """p_j, m, object frame."""
    inertia: Float[np.ndarray, "J"]
    """I_j, kg m^2."""
    variance: Float[np.ndarray, "J"]
    """Variance of each, (kg m^2)^2."""
    common_error: float = 0.0
    """One error of all together, as a part of I_j."""

    @property
    def covariance(self) -> Float[np.ndarray, "J J"]:
        """Covariance of I_j, (kg m^2)^2."""
        return np.diag(self.variance) + self.common_error**2 * np.outer(self.inertia, self.inertia)


def inertia_map(shape: ObjectShape, points: Float[np.ndarray, "J 2"]) -> Float[np.ndarray, "J n_m"]:
    """Map from particle masses to the inertia about each point, m^2; cells are solid."""
    squares = np.sum((shape.particles[None] - points[:, None]) ** 2, axis=2) + shape.cell**2 / 6
    return shape.per_group(squares)
