"""Non-negative masses that agree with M, c and I_cm: their ranges, mean and covariance.

Under one rigid body friction shows M and c, and acceleration I_cm: four numbers for n_m masses. The masses that agree
with them form a polytope, blurred by the errors of the numbers.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float
from scipy.linalg import null_space
from scipy.optimize import linprog
from scipy.special import ndtr, ndtri

CHAINS, STEPS, SETTLING = 256, 240, 60
"""Number of hit-and-run chains, least steps of each, and least steps before the first draw."""
FEW = 6
"""Number of masses up to which the least steps suffice; of more, steps grow with its square. Ours."""
SMALLEST, FAR = 1e-300, 1e300
"""Smallest divisor and largest distance along a direction."""


@dataclass(frozen=True, eq=False)
class MassPolytope:
    """Masses m >= 0, kg, with rows m = values, every row an independent measurement of unit error."""

    rows: Float[np.ndarray, "r n_m"]
    values: Float[np.ndarray, "r"]

    @cached_property
    def inside(self) -> tuple[Float[np.ndarray, "n_m"], float]:
        """Interior mass map, kg, as far from every bound as possible, and its largest residual, standard errors.

        The residual exceeds a few standard errors only where no mass map agrees with the measurements.
        """
        count, n = self.rows.shape
        norms = np.linalg.norm(self.rows, axis=0)
        # unknowns: masses, the least mass in units of what one row's error allows, and the miss
        size = max(float(np.abs(self.values).max() / norms.max()), SMALLEST)
        above = np.hstack([self.rows * size, np.zeros((count, 1)), -np.ones((count, 1))])
        below = np.hstack([-self.rows * size, np.zeros((count, 1)), -np.ones((count, 1))])
        deep = np.hstack([-np.eye(n), np.ones((n, 1)), np.zeros((n, 1))])
        cost = np.append(np.zeros(n), [-1.0, 1.0])
        limits, most = np.vstack([above, below, deep]), np.concatenate([self.values, -self.values, np.zeros(n)])
        found = linprog(cost, limits, most, bounds=(0, None), method="highs")
        return found.x[:n] * size, float(found.x[-1])

    def ranges(self, confidence: float) -> tuple[Float[np.ndarray, "n_m"], Float[np.ndarray, "n_m"]]:
        """Least and greatest mass of each group over all maps within the measurements' joint errors, kg.

        All rows are within the same number of standard errors, with the joint probability `confidence`; where no map
        is, within the least number that any map needs.
        """
        count, n = self.rows.shape
        reach = float(ndtri((1 + confidence ** (1 / count)) / 2))
        reach = max(reach, self.inside[1] * (1 + 1e-6) + 1e-9)
        scale = np.linalg.norm(self.rows, axis=1)[:, None]
        limits = np.vstack([self.rows, -self.rows]) / np.vstack([scale, scale])
        most = np.concatenate([self.values + reach, reach - self.values]) / np.concatenate([scale, scale])[:, 0]
        ends = np.empty((2, n))
        for group, direction in enumerate(np.eye(n)):
            for side, sign in enumerate((1.0, -1.0)):
                found = linprog(sign * direction, limits, most, bounds=(0, None), method="highs")
                ends[side, group] = found.x[group] if found.status == 0 else self.inside[0][group]
        return ends[0], ends[1]

    def posterior(self, seed: int) -> tuple[Float[np.ndarray, "n_m"], Float[np.ndarray, "n_m n_m"]]:
        """Mean and covariance of the masses given the measurements, with a flat prior over masses >= 0.

        The mean has the least expected squared error, and agrees with the measurements, since the set is convex.
        """
        start, _ = self.inside
        total, square, taken = np.zeros(len(start)), np.zeros((len(start), len(start))), 0
        for masses in self._walked(CHAINS, seed):
            off = masses - start  # so that chains without freedom have a variance of exactly 0
            total += off.sum(axis=0)
            square += off.T @ off
            taken += CHAINS
        mean = total / taken
        return start + mean, square / taken - np.outer(mean, mean)

    def draws(self, count: int, seed: int) -> Float[np.ndarray, "count n_m"]:
        """Independent draws of the masses given the measurements, with a flat prior over masses >= 0."""
        *_, last = self._walked(count, seed)
        return last

    def _walked(self, chains: int, seed: int) -> Iterator[Float[np.ndarray, "chains n_m"]]:
        """States of parallel hit-and-run chains from the interior mass map, once it is forgotten."""
        rng = np.random.default_rng(seed)
        start, _ = self.inside
        unobserved = null_space(self.rows, rcond=1e-9) * max(float(start.sum()), SMALLEST)
        observed = np.linalg.pinv(self.rows)
        masses = np.tile(start, (chains, 1))
        longer = max(len(start) / FEW, 1.0) ** 2
        for step in range(round(longer * STEPS)):
            bases = (unobserved, observed) if unobserved.shape[1] else (observed,)
            basis = bases[step % len(bases)]
            direction = rng.standard_normal((chains, basis.shape[1])) @ basis.T
            masses = np.maximum(masses + self._along(masses, direction, rng)[:, None] * direction, 0.0)
            if step >= longer * SETTLING:
                yield masses

    def _along(self, masses: np.ndarray, direction: np.ndarray, rng: np.random.Generator) -> np.ndarray:
        """Step of each chain along its direction: a draw from the density on the line, within the bounds."""
        with np.errstate(divide="ignore", invalid="ignore"):
            to_zero = -masses / direction
        low = np.where(direction > 0, to_zero, -FAR).max(axis=1)
        high = np.where(direction < 0, to_zero, FAR).min(axis=1)
        slope = direction @ self.rows.T
        precision = np.maximum((slope**2).sum(axis=1), SMALLEST)
        middle = (slope * (self.values - masses @ self.rows.T)).sum(axis=1) / precision
        error = 1 / np.sqrt(precision)
        even = error > 1e3 * (high - low)  # no measurement changes along the direction
        a, b = (low - middle) / error, (high - middle) / error
        turned = a > 0  # in the upper tail the distribution function is 1 to rounding
        a, b = np.where(turned, -b, a), np.where(turned, -a, b)
        part = rng.random(len(masses))
        drawn = ndtri(np.clip(ndtr(a) + part * (ndtr(b) - ndtr(a)), SMALLEST, 1 - 1e-16))
        drawn = np.clip(drawn, a, b)
        drawn = middle + error * np.where(turned, -drawn, drawn)
        drawn[even] = (low + part * (high - low))[even]
        return np.clip(drawn, low, high)
