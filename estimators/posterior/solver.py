"""Most likely unknowns of a set of measurements: Gauss-Newton on whitened residuals and priors."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.posterior.unknowns import Unknowns

ROUNDS = 30
"""Greatest number of linearizations."""
TOLERANCE = 0.1
"""Decrease of the cost, twice the negative log likelihood, below which a step ends the search: that of a third of a
standard error."""
LARGEST_DAMPING = 1e9
"""Damping above which a search has no descent."""
Blocks = Sequence[tuple[Int[Tensor, "C r"], Float[Tensor, "C r r"]]]
"""Indices of rows with correlated errors and their covariance: in each entry C sets of r rows."""


@dataclass(frozen=True, eq=False)
class Linearized:
    """Rows of a measurement at some unknowns, R of them."""

    residual: Float[Tensor, "R"]
    """Predicted less measured rows; zeros of a planned measurement."""
    slopes: Float[Tensor, "R n"]
    """Derivatives of the predicted rows in z."""
    blocks: Blocks
    """Covariance of their errors."""
    residual_at: Callable[[Float[Tensor, "n"]], Float[Tensor, "R"]]
    """Residual at other z."""
    slopes_at: Callable[[Float[Tensor, "n"]], Float[Tensor, "R n"]]
    """Slopes at other z."""
    absorbed: Callable[[], float] = float
    """Number of rows absorbed by unknowns of the measurement itself, such as the gripper's load."""


@dataclass(frozen=True)
class Rows:
    """Consecutive rows of a measurement."""

    name: str
    count: int
    trial: int | None = None
    """Index of their trial among the trajectories."""
    idle: int = 0
    """Number of them that unknowns of the measurement itself fit, whatever they are."""

    @property
    def counted(self) -> int:
        """Number of rows that count for the misfit."""
        return self.count - self.idle


class Measurement(Protocol):
    """Measured rows and their forward model."""

    @property
    def parts(self) -> Sequence[Rows]:
        """Parts of the rows in order."""
        ...

    def linearized(self, unknowns: Unknowns, z: Float[Tensor, "n"]) -> Linearized:
        """Residual, derivatives and covariance at some unknowns."""
        ...


@dataclass(frozen=True, eq=False)
class Whitened:
    """Rows of unit variance."""

    residual: Float[Tensor, "R"]
    slopes: Float[Tensor, "R n"]
    roots: Blocks
    """Cholesky roots of the covariance."""

    @staticmethod
    def of(found: Linearized) -> Whitened:
        """Rows in units of their errors."""
        roots = [(rows, torch.linalg.cholesky(covariance)) for rows, covariance in found.blocks]
        both = _whiten(roots, torch.cat([found.residual[:, None], found.slopes], 1))
        return Whitened(both[:, 0], both[:, 1:], roots)

    def over(self, values: Float[Tensor, "R m"]) -> Float[Tensor, "R m"]:
        """Other values in units of the same errors."""
        return _whiten(self.roots, values)


def joined(rows: Sequence[Whitened]) -> tuple[Float[Tensor, "R"], Float[Tensor, "R n"]]:
    """Residuals and slopes of all measurements together."""
    return torch.cat([each.residual for each in rows]), torch.cat([each.slopes for each in rows])


def _whiten(roots: Blocks, values: Float[Tensor, "R m"]) -> Float[Tensor, "R m"]:
    """Values in units of their errors: L^-1 values, with the roots L of their covariance."""
    found = torch.empty_like(values)
    for rows, root in roots:
        found[rows] = torch.linalg.solve_triangular(root, values[rows], upper=False)
    return found


@dataclass(frozen=True, eq=False)
class Optimum:
    """Most likely z."""

    z: Float[Tensor, "n"]
    residual: Float[Tensor, "R"]
    """Whitened residuals of all measurements there."""
    rounds: int
    converged: bool


def solve(
    measurements: Sequence[Measurement], unknowns: Unknowns, start: Float[Tensor, "n"], most: int = ROUNDS
) -> Optimum:
    """Minimize |residual|^2 + |z|^2 by Gauss-Newton steps, damped where one does not decrease the cost.

    Errors that depend on z are those at the start of each step: iteratively reweighted least squares.
    Steps are linear in the masses, whose sum is weighed, not in their logarithms. Rows are products of masses and
    loads, so a full step overshoots: the minimum of a parabola along it is tried as well.
    """
    z, damping, eye = start, 0.0, torch.eye(len(unknowns), dtype=torch.float64)
    converged, rounds, residual = False, 0, torch.zeros(0, dtype=torch.float64)
    while not converged and rounds < most:
        rounds += 1
        found = [each.linearized(unknowns, z) for each in measurements]
        rows = [Whitened.of(each) for each in found]
        residual, slopes = joined(rows)
        now = float(residual @ residual + z @ z)
        inner, gradient = slopes.T @ slopes, slopes.T @ residual + z

        while True:
            root = torch.linalg.cholesky(inner + (1 + damping) * eye)
            step = -torch.cholesky_solve(gradient[:, None], root)[:, 0]
            downhill, at = -float(gradient @ step), unknowns.stepped(z, step)
            moved = _residual(at, found, rows)
            least = float(moved @ moved + at @ at)
            bend = least - now + 2 * downhill
            part = min(max(downhill / bend, 0.1), 2.0) if bend > 0 else 1.0
            if abs(part - 1) > 0.1:
                other = unknowns.stepped(z, part * step)
                there = _residual(other, found, rows)
                if (less := float(there @ there + other @ other)) < least:
                    at, moved, least = other, there, less
            if least < now or downhill < TOLERANCE:
                damping = damping / 10 if damping > 1e-3 else 0.0
                break
            if damping > LARGEST_DAMPING:
                return Optimum(z, residual, rounds, converged=False)
            damping = max(10 * damping, 0.1)
        converged = now - least < TOLERANCE
        z, residual = (at, moved) if least < now else (z, residual)
    return Optimum(z, residual, rounds, converged)


def _residual(z: Float[Tensor, "n"], found: Sequence[Linearized], rows: Sequence[Whitened]) -> Float[Tensor, "R"]:
    """Whitened residuals at other z."""
    return torch.cat([white.over(each.residual_at(z)[:, None])[:, 0] for each, white in zip(found, rows, strict=True)])
