"""The paper's measures of how right an answer is: where truth and estimate meet, and nowhere else."""

from __future__ import annotations

import numpy as np

from testbed.errors import InvalidValueError
from testbed.objects import MassDistribution, ObjectShape


def normalized_absolute_difference(shape: ObjectShape, estimate: MassDistribution, truth: MassDistribution) -> float:
    """NAD, eta_1: sum over particles of |m - m_g| over the total mass; 0 is right, 2 is everything misplaced.

    Raises:
        InvalidValueError: masses that do not fit the shape.
    """
    for name, given in (("estimate.mass", estimate.mass), ("truth.mass", truth.mass)):
        if len(given) != shape.n_m:
            raise InvalidValueError(name, given.tolist(), f"{shape.n_m} numbers, one a mass group")
    count = shape.particles_per_group
    return float(count @ np.abs(estimate.mass - truth.mass) / (count @ truth.mass))
