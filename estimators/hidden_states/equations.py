"""The linear system Q s = b of the friction loads s = mu m g, Eq. dvs, with its errors and its rank.

Rows are those of the joint posterior about a guess of masses, frictions and errors: all six components that the sensor
shows, and the torques about hinges. The gripper's load and every stated error are marginalized in their covariance.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.hidden_states.masses import friction_loads
from estimators.particles.links import HINGE_PRIOR
from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.particles.misfit import Misfit
from estimators.posterior.on_table import OnTable
from estimators.posterior.priors import priors
from estimators.posterior.unknowns import Unknowns
from estimators.wrench.jacobian import Theta
from estimators.wrench.model import ModelErrors
from testbed.objects.model import MassDistribution

LARGEST_ERROR = 3.0
"""Largest error about which rows are linearized, standard deviations: no model explains what takes more. Ours."""


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Q s = b, whitened: every row has unit variance."""

    q: Float[Tensor, "R n_s"]
    b: Float[Tensor, "R"]
    whiten: Float[Tensor, "R R"]
    """Inverse root of the rows' covariance."""
    idle: int = 0
    """Number of rows that fit whatever the friction loads are."""

    @property
    def rank(self) -> int:
        """rank(Q)."""
        return rank_of(self.q.numpy())

    def loss(self, s: Float[np.ndarray, "n_s"]) -> float:
        """Mean squared residual, Eq. problem_si in units of the errors."""
        return float((self.q @ torch.tensor(s) - self.b).square().mean())

    def misfit(self, s: Float[np.ndarray, "n_s"]) -> Misfit:
        """Misfit of fitted friction loads, N."""
        freedom = len(self.b) - self.idle - len(s)
        return Misfit(self.loss(s) * len(self.b) / max(freedom, 1), freedom)


@dataclass(frozen=True, eq=False)
class FrictionEquations:
    """Q s = b in N and N m, r = 6 + H rows per window, with its errors."""

    q: Float[Tensor, "K r n_s"]
    b: Float[Tensor, "K r"]
    covariance: Float[Tensor, "K r K r"]
    """Covariance of the rows without the errors of `wide`."""
    wide: dict[str, Float[Tensor, "K r n"]]
    """Effects of one standard deviation of errors with wide priors: `hinge_friction`, `center` and `inertia`."""
    unknowns: Unknowns
    """Every stated error; masses and frictions are known."""
    slopes: Float[Tensor, "K r n"]
    """Effects of one standard deviation of each."""
    drag_rows: Float[Tensor, "K r P"]
    """Derivatives of the rows in the friction of each particle."""
    idle: Int[Tensor, "K"]
    """Number of rows of each window that fit whatever the friction loads are."""
    missing: Float[Tensor, "K r"]
    """Measured rows less those of the guessed masses and frictions, linearized about the likely errors, N and N m."""

    @staticmethod
    def about(
        on_table: OnTable, weight: float, at: MassDistribution, errors: ModelErrors, off: Theta | None = None
    ) -> FrictionEquations:
        """Equations about a guess of masses and frictions, with which errors and the gripper's load scale.

        Args:
            on_table: windows of constant speed or acceleration.
            weight: M, kg.
            at: the guess; its inertial wrench is subtracted from the rows.
            errors: errors of the model.
            off: guess of the stated errors, each in its own unit; none if left out.
        """
        shape, groups = on_table.shape, LoadGroups.of(on_table.table.model)
        unknowns = priors(shape, on_table.windows.setup, errors, weight, on_table.trials)
        unknowns = unknowns.given(mass=torch.tensor(at.mass), friction=torch.tensor(at.friction))
        z = unknowns.start(**(off or {}))
        found, drag_rows = on_table.linear_in_drag(unknowns, z)
        q, rows, wide = groups.gather(drag_rows), drag_rows.shape[:2], {}
        every = slopes = found.slopes.unflatten(0, rows)
        if (hinges := unknowns.at.get("hinge_friction")) is not None:
            wide["hinge_friction"] = slopes[..., hinges]
            slopes = torch.cat([slopes[..., : hinges.start], slopes[..., hinges.stop :]], -1)
        covariance = slopes.flatten(0, 1) @ slopes.flatten(0, 1).T
        for places, blocks in found.blocks:
            covariance[places[:, :, None], places[:, None]] += blocks
        missing = every @ z - found.residual.unflatten(0, rows)
        b = q @ torch.tensor(friction_loads(shape, groups.pairs, at)) + missing
        covariance = covariance.unflatten(0, rows).unflatten(-1, rows)
        return FrictionEquations(q, b, covariance, wide, unknowns, every, drag_rows, on_table.idle, missing)

    def likely_errors(self, s: Float[np.ndarray, "n_s"]) -> Theta:
        """Most likely stated errors at some friction loads, N, each in its own unit, clipped to `LARGEST_ERROR`."""
        missing = (self.b - self.q @ torch.tensor(s)).flatten()
        weighed = torch.linalg.solve(self.covariance_with(*self.wide), missing)
        z = (self.slopes.flatten(0, 1).T @ weighed).clamp(-LARGEST_ERROR, LARGEST_ERROR)
        return {name: value for name, value in self.unknowns.values(z).items() if name not in ("mass", "friction")}

    def covariance_with(self, *names: str) -> Float[Tensor, "R R"]:
        """Covariance of all rows with the named errors of `wide`."""
        wide = torch.cat([self.q[..., :0], *(self.wide[name] for name in names)], -1).flatten(0, 1)
        return self.covariance.flatten(0, 1).flatten(1) + wide @ wide.T

    def where(self, keep: Tensor) -> FrictionEquations:
        """Equations of the windows that `keep` selects, a mask (K,) or indices."""
        wide = {name: effects[keep] for name, effects in self.wide.items()}
        return replace(
            self,
            q=self.q[keep],
            b=self.b[keep],
            covariance=self.covariance[keep][:, :, keep],
            wide=wide,
            slopes=self.slopes[keep],
            drag_rows=self.drag_rows[keep],
            idle=self.idle[keep],
            missing=self.missing[keep],
        )

    def whitened(self) -> LinearSystem:
        """System in units of its errors, those of `wide` marginalized."""
        whiten = torch.linalg.inv(torch.linalg.cholesky(self.covariance_with()))
        # in units of the other errors first, since these are larger by orders of magnitude
        wide = torch.cat([self.q[..., :0], *self.wide.values()], -1).flatten(0, 1)
        axes, size, _ = torch.linalg.svd(whiten @ wide, full_matrices=False)
        whiten = whiten - (axes * (1 - (1 + size.square()).rsqrt())) @ (axes.T @ whiten)
        q, b = whiten @ self.q.flatten(0, 1), whiten @ self.b.flatten()
        return LinearSystem(q, b, whiten, int(self.idle.sum()))

    def hinge_friction(self) -> tuple[Float[np.ndarray, "H"], Float[np.ndarray, "H"]] | None:
        """Friction torque of every hinge, N m, and its standard deviation; None for a rigid object.

        Friction loads are fitted too; a torque that the trials do not show has the standard deviation `HINGE_PRIOR`.
        """
        if (hinges := self.wide.get("hinge_friction")) is None:
            return None
        count, rows = hinges.shape[-1], torch.cat([hinges, self.q, self.b[..., None]], -1).flatten(0, 1)
        root = torch.linalg.cholesky(self.covariance_with())
        white = torch.linalg.solve_triangular(root, rows, upper=False)
        design = white[:, :-1]
        prior = (torch.arange(design.shape[1]) < count).double().diag()
        spread = torch.linalg.pinv(design.T @ design + prior, hermitian=True)
        torque, variance = (spread @ (design.T @ white[:, -1]))[:count], spread.diagonal()[:count]
        return HINGE_PRIOR * torque.numpy(), HINGE_PRIOR * variance.sqrt().numpy()
