"""Reading of a scale as a measurement of all unknowns."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.posterior.solver import Linearized
from estimators.posterior.unknowns import Unknowns
from estimators.wrench.weighing import Weighing


@dataclass(frozen=True, eq=False)
class Scale:
    """Mass of the whole object as read."""

    reading: float
    """M, kg."""
    weighing: Weighing
    """Masses that the scale adds up, and its error."""

    @property
    def parts(self) -> list[tuple[str, int, None]]:
        """The reading alone."""
        return [("the weighing", 1, None)]

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and variance."""
        first = torch.zeros(1, dtype=torch.int64)
        count = torch.tensor(self.weighing.count)
        blocks = [(first[None], torch.tensor([[[self.weighing.error**2]]], dtype=torch.float64))]

        def elsewhere(z: Tensor) -> Tensor:
            return (count @ unknowns.values(z)["mass"] - self.reading)[None]

        slopes = unknowns.columns({"mass": count[None, None]}, first, z)[0]
        return Linearized(elsewhere(z), slopes, blocks, elsewhere)
