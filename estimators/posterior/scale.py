"""Weighing of an object, and its reading as a measurement of all unknowns."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.posterior.solver import Linearized, Rows
from estimators.posterior.unknowns import Unknowns
from testbed.objects.model import ObjectShape
from testbed.worlds.setup_errors import SetupErrors


@dataclass(frozen=True, eq=False)
class Weighing:
    """Reading of a scale: the masses of all particles together."""

    count: Float[np.ndarray, "n_m"]
    """Particles of each mass group, weighted by fill: derivative of the reading in a particle's mass."""
    error: float
    """Standard deviation, kg."""

    @staticmethod
    def of(shape: ObjectShape, error: float, setup: SetupErrors) -> Weighing:
        """Weighing of an object by a scale of its own `error`, kg, and that of the setup."""
        return Weighing(shape.particles_per_group.astype(float), math.hypot(error, setup.scale))

    def row(self, unknowns: int) -> Float[np.ndarray, "unknowns"]:
        """Derivative of the reading in particle masses and further unknowns, in units of its error."""
        return np.append(self.count / self.error, np.zeros(unknowns - len(self.count)))


@dataclass(frozen=True, eq=False)
class Scale:
    """Reading of the whole object's mass."""

    reading: float
    """M, kg."""
    weighing: Weighing
    """Derivatives of the reading, and its error."""

    @property
    def parts(self) -> list[Rows]:
        """The reading alone."""
        return [Rows("the weighing", 1)]

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and variance."""
        first = torch.zeros(1, dtype=torch.int64)
        count = torch.tensor(self.weighing.count)
        blocks = [(first[None], torch.tensor([[[self.weighing.error**2]]], dtype=torch.float64))]

        def residual_at(z: Tensor) -> Tensor:
            return (count @ unknowns.values(z)["mass"] - self.reading)[None]

        def slopes_at(z: Tensor) -> Tensor:
            return unknowns.columns({"mass": count[None, None]}, first, z)[0]

        return Linearized(residual_at(z), slopes_at(z), blocks, residual_at, slopes_at)
