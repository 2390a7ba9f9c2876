"""Reading of a scale."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import SetupErrors


@dataclass(frozen=True, eq=False)
class Weighing:
    """Reading of a scale: the masses of all particles together."""

    count: Float[np.ndarray, "n_m"]
    """Particles of each mass group, by the material in their cells: derivative of the reading in a particle's mass."""
    error: float
    """Standard deviation, kg."""

    @staticmethod
    def of(shape: ObjectShape, error: float, setup: SetupErrors) -> Weighing:
        """Weighing of an object on a scale with an error of its own, kg, beside that of the setup."""
        return Weighing(shape.particles_per_group.astype(float), math.hypot(error, setup.scale))

    def row(self, unknowns: int) -> Float[np.ndarray, "unknowns"]:
        """Derivative of the reading in particle masses and what follows them, in units of its error."""
        return np.append(self.count / self.error, np.zeros(unknowns - len(self.count)))
