"""Assignments of a few known materials to blocks, ranked by how well they fit the measurements.

Exact: every assignment is scored or has a negligible probability by a bound. The assignments of each half of the blocks
are listed, and only those pairs are scored whose sum is near the value of the most precise measurement.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce

import numpy as np
from jaxtyping import Float, Int
from scipy.special import chdtrc, logsumexp

from testbed.errors import InvalidValueError

MOST_BLOCKS = 20
"""Largest number of blocks: more take longer than seconds."""
MOST_PAIRS = 4e9
"""Largest number of assignments."""
LEFT_OUT = 1e-6
"""Upper bound of the share of probability that is not scored."""
KEPT = 20_000
"""Number of best assignments that are listed."""
CHUNK = 1 << 22
"""Number of pairs in a batch."""


@dataclass(frozen=True, eq=False)
class RankedAssignments:
    """The S best assignments, most probable first."""

    material: Int[np.ndarray, "S n_m"]
    """Index of each group's material."""
    probability: Float[np.ndarray, "S"]
    """Probability of each, given that one of all assignments is true, with equal priors."""
    misfit: float
    """Squared residual of the best, in units of the measurements' errors."""
    fits: float
    """p-value of that misfit: small where no assignment explains the measurements."""

    def holding(self, share: float) -> int | None:
        """Number of best assignments that hold a share of the probability; None if it exceeds those listed."""
        within = np.cumsum(self.probability)
        return int(np.searchsorted(within, share) + 1) if within[-1] >= share else None

    def covariance(self, options: Float[np.ndarray, "n_m k"]) -> Float[np.ndarray, "n_m n_m"]:
        """Covariance of the groups' masses over the listed assignments, kg^2."""
        masses = np.take_along_axis(options[None], self.material[:, :, None], 2)[..., 0]
        share = self.probability / self.probability.sum()
        apart = masses - share @ masses
        return apart.T @ (apart * share[:, None])


def rank_assignments(
    rows: Float[np.ndarray, "r n_m"], values: Float[np.ndarray, "r"], options: Float[np.ndarray, "n_m k"]
) -> RankedAssignments:
    """Rank all k^n_m assignments by how well they agree with measurements.

    Args:
        rows: measurements of the groups' masses, independent and of unit error, the most precise first.
        values: measured value of each row.
        options: mass of each group in each material, kg.

    Raises:
        InvalidValueError: more blocks or more assignments than can be ranked exactly.
    """
    n, k = options.shape
    if n > MOST_BLOCKS or float(k) ** n > MOST_PAIRS:
        allowed = f"at most {MOST_BLOCKS} mass groups and {MOST_PAIRS:.0e} assignments"
        raise InvalidValueError("materials", f"{k} materials for {n} mass groups", allowed)
    half = n // 2
    first = _sums(rows[:, :half], options[:half]) - values
    second = _sums(rows[:, half:], options[half:])
    # beyond this many standard errors of the first row, all together have less than LEFT_OUT of the best's probability
    best = _upper_bound(first, second)
    reach = np.sqrt(best + 2 * np.log(float(k) ** n / LEFT_OUT))
    up = np.argsort(second[:, 0], kind="stable")
    second = second[up]
    squares = (second**2).sum(axis=1)
    order = np.argsort(first[:, 0], kind="stable")
    step = max(CHUNK // len(second), 1)
    total = -np.inf
    scores, which = np.empty(0), np.empty((0, 2), dtype=np.int64)
    for begin in range(0, len(order), step):
        chosen = order[begin : begin + step]
        some = first[chosen]
        low, high = np.searchsorted(second[:, 0], [-some[-1, 0] - reach, -some[0, 0] + reach])
        if low == high:
            continue
        chi = (some**2).sum(axis=1)[:, None] + squares[low:high] + 2 * some @ second[low:high].T
        total = np.logaddexp(total, logsumexp(-chi / 2))
        near = np.flatnonzero(chi.ravel() <= (np.inf if len(scores) < KEPT else scores[-1]))
        if len(near) > KEPT:
            near = near[np.argpartition(chi.ravel()[near], KEPT)[:KEPT]]
        pairs = np.column_stack([chosen[near // (high - low)], up[low + near % (high - low)]])
        scores, which = np.append(scores, chi.ravel()[near]), np.vstack([which, pairs])
        kept = np.argsort(scores, kind="stable")[:KEPT]
        scores, which = scores[kept], which[kept]
    # the scores are differences of large squares: compute the listed ones again, exactly
    digits = np.hstack([_digits(which[:, 0], k, half), _digits(which[:, 1], k, n - half)])
    masses = np.take_along_axis(options[None], digits[:, :, None], 2)[..., 0]
    exact = ((masses @ rows.T - values) ** 2).sum(axis=1)
    kept = np.argsort(exact, kind="stable")
    listed = exact[kept]
    probability = np.exp(-listed / 2 - max(total, float(logsumexp(-listed / 2))))
    return RankedAssignments(digits[kept], probability, float(listed[0]), float(chdtrc(len(rows), listed[0])))


def _sums(rows: np.ndarray, options: np.ndarray) -> np.ndarray:
    """Value of each row for every assignment of some groups, (k^n, r); the last group's material varies fastest."""
    parts = [rows[:, g][None] * options[g][:, None] for g in range(len(options))]
    empty = np.zeros((1, len(rows)))
    return reduce(lambda sums, part: (sums[:, None] + part[None]).reshape(-1, len(rows)), parts, empty)


def _digits(index: np.ndarray, base: int, count: int) -> np.ndarray:
    """Materials of the assignments of some groups by index, (S, count)."""
    return index[:, None] // base ** np.arange(count - 1, -1, -1) % base


def _upper_bound(first: np.ndarray, second: np.ndarray) -> float:
    """Upper bound of the least squared residual, by descent over the two halves in turn."""
    at = 0
    best = np.inf
    for _ in range(10):
        place = int(((first[at] + second) ** 2).sum(axis=1).argmin())
        chi = ((first + second[place]) ** 2).sum(axis=1)
        at = int(chi.argmin())
        if chi[at] >= best:
            break
        best = float(chi[at])
    return best
