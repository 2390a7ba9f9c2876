"""Reading of a scale as a measurement of all unknowns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.posterior.solver import Blocks, Linearized
from estimators.posterior.unknowns import Unknowns
from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import SetupErrors


@dataclass(frozen=True, eq=False)
class Scale:
    """Mass of the whole object as read."""

    reading: float
    """M, kg."""
    count: Float[Tensor, "n_m"]
    """Particles of each mass group, by the material in their cells."""
    error: float
    """Standard deviation, kg."""

    @staticmethod
    def of(shape: ObjectShape, reading: float, error: float, setup: SetupErrors) -> Scale:
        """Reading of a scale with an error of its own, kg, beside that of the setup."""
        return Scale(reading, torch.tensor(shape.particles_per_group).double(), math.hypot(error, setup.scale))

    @property
    def parts(self) -> list[tuple[str, int, None]]:
        """The reading alone."""
        return [("the weighing", 1, None)]

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and variance."""
        first = torch.zeros(1, dtype=torch.int64)
        blocks = [(first, torch.tensor([[self.error**2]], dtype=torch.float64))]

        def elsewhere(z: Tensor) -> tuple[Tensor, Blocks]:
            return (self.count @ unknowns.values(z)["mass"] - self.reading)[None], blocks

        slopes = unknowns.columns({"mass": self.count[None, None]}, first, z)[0]
        return Linearized(elsewhere(z)[0], slopes, blocks, elsewhere)
