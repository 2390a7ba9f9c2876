"""Errors of the rows of trials on the table: of the sensor, of the gripper's load, and of the forward model itself."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from estimators.particles.friction_system import SWING, model_errors
from estimators.particles.setup_effects import LinearRows
from estimators.particles.windows import Observations
from estimators.posterior.solver import Blocks
from estimators.wrench.model import ModelErrors
from estimators.wrench.sensor import walk
from estimators.wrench.table import Table
from testbed.worlds.setup_errors import SetupErrors

LEAST_VARIANCE = 1e-12
"""Least variance of a row, N^2 and (N m)^2: sensors without noise have weights too."""
ROUNDING = 1e-13
"""Part of the largest variance of a trial that is added to all: rounding may not make a covariance indefinite."""


@dataclass(frozen=True, eq=False)
class TableErrors:
    """Errors of the rows of K windows, r a window; those of the gripper's load scale with what it changes."""

    windows: Observations
    own: Float[Tensor, "K r r"]
    """Covariance of each window's own errors, of sensor and model."""
    late: Float[Tensor, "K r m"]
    """Effects of one standard deviation of each error of the model that the windows of a trial share."""

    @staticmethod
    def of(
        windows: Observations, table: Table, mass: Float[Tensor, "P"], drag: Float[Tensor, "K P"], errors: ModelErrors
    ) -> TableErrors:
        """Errors at some masses and friction.

        Args:
            windows: windows of constant speed or acceleration.
            table: their forward model with each particle on its middle: errors of the motion act on feet, each at one
                place, and would cancel in the mean over a cell.
            mass: mass of every particle, kg.
            drag: friction of every particle, N.
            errors: errors of the model.
        """
        in_windows = SetupErrors(friction_law=windows.setup.friction_law)
        linear = LinearRows.of(windows, table, mass, drag, 0.0, in_windows)
        planar, late = model_errors(windows, linear, errors)
        # an error of the inertia is once of each trial, and once of all: that is an unknown
        late = torch.cat([late, errors.inertia_error * linear.motion(mass)[..., None]], -1)
        swing, of_center = (SWING * windows.twist[:, 2]).square(), linear.slopes["twist"][..., :2]
        planar = planar + (swing * windows.accelerated)[:, None, None] * of_center @ of_center.mT
        # the moment of a planar force about the feet errs with it
        height, hinges = windows.load_map[:, 1, 0], windows.hinges
        to_rows = torch.zeros(len(height), 6 + hinges, 3 + hinges, dtype=torch.float64)
        to_rows[:, [0, 1, *range(5, 6 + hinges)], range(3 + hinges)] = 1.0
        to_rows[:, 4, 0], to_rows[:, 3, 1] = -height, height
        own = to_rows @ planar @ to_rows.mT + pad(windows.noise, (0, hinges, 0, hinges))
        return TableErrors(windows, own + LEAST_VARIANCE * torch.eye(6 + hinges, dtype=torch.float64), to_rows @ late)

    def blocks(self, carried: Float[Tensor, "K r 3"]) -> Blocks:
        """Rows of each trial, and the covariance of their errors.

        Args:
            carried: derivatives of the rows in the gripper's lift and moment.
        """
        windows, rows, found = self.windows, self.own.shape[1], []
        more = (0, windows.hinges, 0, windows.hinges)
        for inside in self.trials:
            each, late = torch.arange(inside.shape[1]), self.late[inside].flatten(1, 2)
            bias, drift = pad(windows.bias[inside[:, 0]], more), pad(windows.drift[inside[:, 0]], more)
            covariance = (
                self._of_load(carried, inside)
                + walk(windows.since_tare[inside])[:, :, None, :, None] * drift[:, None, :, None]
            )
            covariance += bias[:, None, :, None]
            covariance[:, each, :, each] += self.own[inside].transpose(0, 1)
            covariance = covariance.flatten(3).flatten(1, 2) + late @ late.mT
            variance = covariance.diagonal(dim1=1, dim2=2)
            variance.add_(ROUNDING * variance.amax(1, keepdim=True))
            found.append(((inside[..., None] * rows + torch.arange(rows)).flatten(1), covariance))
        return found

    def _of_load(self, carried: Float[Tensor, "K r 3"], inside: Int[Tensor, "C k"]) -> Float[Tensor, "C k r k r"]:
        """Covariance of the rows of some trials by the gripper's load."""
        return torch.einsum("ckia,ckla,clja->ckilj", carried[inside], self.load_covariance(inside), carried[inside])

    def taken(self, carried: Float[Tensor, "K r 3"], blocks: Blocks) -> float:
        """Number of rows that go into the gripper's load: the part of their covariance that is the load's."""
        taken = 0.0
        for inside, (_, covariance) in zip(self.trials, blocks, strict=True):
            of_load = self._of_load(carried, inside).flatten(3).flatten(1, 2)
            taken += float(torch.linalg.solve(covariance, of_load).diagonal(dim1=1, dim2=2).sum())
        return taken

    @cached_property
    def trials(self) -> list[Int[Tensor, "C k"]]:
        """Windows of each trial, of C trials of k windows in each entry."""
        _, trial, count = torch.unique(self.windows.trial, return_inverse=True, return_counts=True)
        order, begin = torch.argsort(trial, stable=True), count.cumsum(0) - count
        return [order[begin[count == k, None] + torch.arange(int(k))] for k in count.unique()]

    def load_covariance(self, inside: Int[Tensor, "C k"]) -> Float[Tensor, "C k k 3"]:
        """Prior covariance of the gripper's lift and moments in the windows of a trial, each component on its own."""
        windows = self.windows
        alpha, changed = (windows.acceleration[:, 2] * windows.accelerated)[inside], windows.load_change[inside]
        along = alpha / alpha.square().mean(1, keepdim=True).sqrt().clamp(min=1e-9)
        # an arm that swings carries load along its acceleration, beside what changes from window to window
        change = torch.eye(inside.shape[1], dtype=torch.float64) + along[:, :, None] * along[:, None]
        size = windows.load_size[inside]
        return change[..., None] * changed[:, :, None] * changed[:, None] + size[:, :, None] * size[:, None]

    def shrunken_load(
        self, residual: Float[Tensor, "K r"], carried: Float[Tensor, "K r 3"], blocks: Blocks
    ) -> Float[Tensor, "K 3"]:
        """Most likely lift and moments of the gripper, N and N m, given residuals without any."""
        found = torch.zeros(len(residual), 3, dtype=torch.float64)
        for inside, (rows, covariance) in zip(self.trials, blocks, strict=True):
            root = torch.linalg.cholesky(covariance)
            weighed = torch.cholesky_solve(residual.flatten()[rows][..., None], root).reshape(*inside.shape, -1)
            toward = torch.einsum("ckra,ckr->cka", carried[inside], weighed)
            found[inside] = -torch.einsum("ckla,cla->cka", self.load_covariance(inside), toward)
        return found
