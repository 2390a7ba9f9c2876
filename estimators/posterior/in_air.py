"""Lifts as measurements of all unknowns."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.lifts import LiftErrors, lift_covariance, upright_sizes
from estimators.posterior.solver import Linearized, Rows
from estimators.posterior.unknowns import Unknowns
from estimators.wrench.air import Air, nominal
from estimators.wrench.jacobian import Slopes, Theta
from estimators.wrench.setup import stated_sizes
from testbed.objects.model import ObjectShape
from testbed.sensing.lift_windows import LiftWindow
from testbed.worlds.setup_errors import PARAMETERS

SHARED = {name for name, each in PARAMETERS.items() if {"air", "reading"} & set(each.shows) and each.scope != "trial"}
"""Unknowns that these measurements share with other trials: errors of the setup, and the masses."""
SHARED |= {"mass"}


@dataclass(frozen=True, eq=False)
class InAir:
    """K windows of one lift."""

    shape: ObjectShape
    trial: int
    """Index of the lift among the trajectories."""
    windows: Sequence[LiftWindow]
    air: Air
    own: Theta
    """Standard deviations of the errors of this trial alone, by name."""
    errors: LiftErrors
    weight: float
    """M or a guess of it, kg; errors are proportional to it."""

    @staticmethod
    def of(shape: ObjectShape, trial: int, windows: Sequence[LiftWindow], weight: float) -> InAir:
        """Measurement of one lift by its index among the trajectories; `weight` is M or a guess of it, kg."""
        errors = LiftErrors()
        stated = stated_sizes(windows[0].setup, ("air", "reading"), shape.n_m)
        own = {name: size for name, size in stated.items() if PARAMETERS[name].scope == "trial"}
        own |= errors.sizes(errors.height * shape.height)
        if shape.is_uneven:
            own["upright"] = upright_sizes(shape, weight)
        return InAir(shape, trial, windows, Air.of_masses(shape, windows), own, errors, weight)

    @property
    def read(self) -> Float[Tensor, "R"]:
        """Measured wrenches about the TCP, N and N m."""
        return torch.tensor(np.concatenate([window.wrench for window in self.windows]))

    @property
    def parts(self) -> list[Rows]:
        """One part: all windows."""
        return [Rows("the wrenches in the air", 6 * len(self.windows), self.trial)]

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and covariance, which contains the errors of this trial alone."""
        theta = unknowns.of(SHARED, z)[0]
        rows, slopes = self.air.linearized(nominal(theta, self.own))
        covariance = lift_covariance(self.shape, self.windows, slopes, self.own, self.errors, self.weight)
        blocks = [(torch.arange(rows.numel())[None], torch.tensor(covariance)[None])]

        def columns(slopes: Slopes, z: Tensor) -> Tensor:
            shared = {name: slope for name, slope in slopes.items() if name in theta}
            return unknowns.columns(shared, torch.zeros(len(rows), dtype=torch.int64), z).flatten(0, 1)

        def residual_at(z: Tensor) -> Tensor:
            return self.air.wrenches(unknowns.of(SHARED, z)[0]).flatten() - self.read

        def slopes_at(z: Tensor) -> Tensor:
            return columns(self.air.linearized(unknowns.of(SHARED, z)[0])[1], z)

        return Linearized(rows.flatten() - self.read, columns(slopes, z), blocks, residual_at, slopes_at)
