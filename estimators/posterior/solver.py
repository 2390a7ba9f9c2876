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
"""Decrease of the cost, twice that of the negative log likelihood, by a step after which a solution has converged: that
of a third of a standard error, of which the step leaves little."""
LARGEST_DAMPING = 1e9
Blocks = Sequence[tuple[Int[Tensor, "C r"], Float[Tensor, "C r r"]]]
"""Rows whose errors are correlated, and their covariance: C sets of equally many rows in each entry."""


@dataclass(frozen=True, eq=False)
class Linearized:
    """Rows of a measurement at some unknowns, R of them."""

    residual: Float[Tensor, "R"]
    """Predicted less measured rows; zeros of a planned measurement."""
    slopes: Float[Tensor, "R n"]
    """Derivatives of the predicted rows in z."""
    blocks: Blocks
    """Covariance of their errors."""
    elsewhere: Callable[[Float[Tensor, "n"]], Float[Tensor, "R"]]
    """Residual at other z."""
    slopes_at: Callable[[Float[Tensor, "n"]], Float[Tensor, "R n"]]
    """Slopes at other z."""
    taken: Callable[[], float] = float
    """Number of rows that go into unknowns of the measurement's own, as the load of a gripper."""


class Measurement(Protocol):
    """Measured rows and their forward model."""

    @property
    def parts(self) -> Sequence[tuple[str, int, int | None]]:
        """Parts of the rows in their order: name, number of rows, and trial by its place among the trajectories."""
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
        """Rows over their errors."""
        roots = [(rows, torch.linalg.cholesky(covariance)) for rows, covariance in found.blocks]
        both = _over(roots, torch.cat([found.residual[:, None], found.slopes], 1))
        return Whitened(both[:, 0], both[:, 1:], roots)

    def over(self, values: Float[Tensor, "R m"]) -> Float[Tensor, "R m"]:
        """Other values over the same errors."""
        return _over(self.roots, values)


def joined(rows: Sequence[Whitened]) -> tuple[Float[Tensor, "R"], Float[Tensor, "R n"]]:
    """Residuals and slopes of all measurements together."""
    return torch.cat([each.residual for each in rows]), torch.cat([each.slopes for each in rows])


def _over(roots: Blocks, values: Float[Tensor, "R m"]) -> Float[Tensor, "R m"]:
    """Values over the roots of their covariance."""
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
    """Minimum of |residual|^2 + |z|^2 by Gauss-Newton steps, damped where one does not decrease it.

    Errors that depend on z are those at the start of each step: iteratively reweighted least squares.
    Steps are straight in the masses, of which the weighing knows the sum, not in their logarithms. Masses and loads
    multiply, so a whole step overshoots: the minimum of a parabola along it is tried as well.
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
                elsewhere = _residual(other, found, rows)
                if (less := float(elsewhere @ elsewhere + other @ other)) < least:
                    at, moved, least = other, elsewhere, less
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
    return torch.cat([white.over(each.elsewhere(z)[:, None])[:, 0] for each, white in zip(found, rows, strict=True)])
