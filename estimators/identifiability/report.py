"""What can be known of an object's masses: rank, errors to expect, and what stays open, named in its groups.

All of it follows from one matrix: the derivatives of what is felt in the masses and the friction, in units of the
errors it is felt with. Its square is the Fisher information, so the errors are the Cramer-Rao bound where the matrix is
taken at the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from jaxtyping import Float

from testbed.objects.model import MassDistribution, ObjectShape
from testbed.validation import frozen_array

MOST_SETS = 4000
"""Of unknowns that are tried for a sparse open direction, before elimination has to do."""
PART = 1e-3
"""A group that has less than this part in an open direction is not touched by it."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """What a set of data shows, and what it leaves open."""

    group_names: tuple[str, ...]
    """Of the mass groups."""
    covariance: Float[np.ndarray, "n_m n_m"]
    """Of the mass groups, kg^2; infinite where they are in an open direction."""
    friction_error: Float[np.ndarray, "n_mu"]
    """Of each friction coefficient; infinite where open."""
    rank: int
    """Directions that are seen, out of `unknowns`."""
    unknowns: int
    """n_m + n_mu."""
    condition: float
    """Best over worst seen direction, masses as parts of M, friction as parts of itself."""
    open_directions: Float[np.ndarray, "D unknowns"]
    """What can be added to the masses (kg a group) and frictions unseen, one a row, touching as few as can be."""
    unobservable: tuple[str, ...]
    """The same in words."""
    bench: tuple[str, ...] = ()
    """What is seen of the bench's own unknowns, in words, where they were asked for."""

    def __post_init__(self) -> None:
        n_m, n_mu = len(self.group_names), len(self.friction_error)
        for name, size in (("covariance", (n_m, n_m)), ("friction_error", (n_mu,))):
            checked = frozen_array(f"Identifiability.{name}", getattr(self, name), size, finite=False)
            object.__setattr__(self, name, checked)

    @property
    def standard_error(self) -> Float[np.ndarray, "n_m"]:
        """Of each mass group, kg; infinite where open."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def sentence(self) -> str:
        """What is seen and what is not, in words."""
        told = f"all {self.unknowns} masses and frictions are seen"
        if self.rank < self.unknowns:
            told = f"{self.rank} of {self.unknowns} masses and frictions are seen; open: {'; '.join(self.unobservable)}"
        return "; ".join([told, *self.bench])


def identifiability(
    shape: ObjectShape, distribution: MassDistribution, root: Float[np.ndarray, "R unknowns"]
) -> Identifiability:
    """Read a whitened Jacobian.

    A direction counts as seen where its standard error is below the whole mass of the object, or below the whole of a
    friction: the weighing alone says that much of a mass that is not negative.

    Args:
        shape: geometry and groups.
        distribution: where the Jacobian was taken.
        root: derivatives of the data in the particle masses (kg) and frictions, over the data's errors.
    """
    count, n_m = shape.particles_per_group, shape.n_m
    whole = float(distribution.mass @ count)
    per_unit = np.concatenate([whole / count, np.maximum(distribution.friction, 1e-6)])
    _, values, directions = np.linalg.svd(root * per_unit, full_matrices=len(root) < len(per_unit))
    values = np.append(values, np.zeros(len(directions) - len(values)))
    seen = values > 1.0
    unit = np.concatenate([np.full(n_m, whole), per_unit[n_m:]])
    scaled = directions * unit
    covariance = (scaled[seen].T / values[seen] ** 2) @ scaled[seen]
    blind = (np.abs(directions[~seen]) > PART).any(axis=0)
    covariance[np.ix_(blind, blind)] = np.inf
    basis = _sparse(directions[~seen])
    return Identifiability(
        shape.group_names,
        covariance[:n_m, :n_m],
        np.sqrt(np.diagonal(covariance)[n_m:]),
        int(seen.sum()),
        len(unit),
        float(values[seen].max() / values[seen].min()) if seen.any() else np.inf,
        basis * unit,
        _in_words(basis, [*shape.group_names, *_friction_names(shape)]),
    )


def _friction_names(shape: ObjectShape) -> list[str]:
    return ["friction"] if shape.n_mu == 1 else [f"friction {k}" for k in range(shape.n_mu)]


def _sparse(rows: np.ndarray) -> np.ndarray:
    """The same space by the vectors that touch the fewest unknowns, found by trying small sets of them."""
    count, columns = rows.shape
    basis, tried = np.empty((0, columns)), 0
    for size in range(1, columns - count + 2):
        if len(basis) == count or tried + math.comb(columns, size) > MOST_SETS:
            break
        tried += math.comb(columns, size)
        inside = np.array(list(combinations(range(columns), size)))
        outside = np.ones((len(inside), columns), dtype=bool)
        np.put_along_axis(outside, inside, False, axis=1)
        # a vector of the space that is zero outside a set: a left null vector of what is outside
        without = rows.T[np.nonzero(outside)[1]].reshape(len(inside), columns - size, count)
        values, mixes = np.linalg.svd(without)[1:]
        least = values[:, count - 1] if columns - size >= count else np.zeros(len(inside))
        found = [_tidied(mixes[k, -1] @ rows) for k in np.flatnonzero(least < PART)]
        for vector in sorted(found, key=lambda v: (np.abs(v - np.round(v)).max() > 0, float(np.abs(v).sum()))):
            with_it = np.vstack([basis, vector])
            if np.linalg.matrix_rank(with_it, tol=10 * PART) > len(basis):
                basis = with_it
    return basis if len(basis) == count else _echelon(rows)


def _tidied(vector: np.ndarray) -> np.ndarray:
    """Scaled to whole numbers where that is near, else to a largest entry of 1; the first entry positive."""
    vector = np.where(np.abs(vector) < PART * np.abs(vector).max(), 0.0, vector)
    entries = vector[vector != 0]
    whole = entries / np.abs(entries).min()
    near = np.abs(whole - np.round(whole)).max() < 10 * PART
    scaled = vector * np.sign(entries[0]) / (np.abs(entries).min() if near else np.abs(entries).max())
    return np.round(scaled) if near else scaled


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Reduced row echelon form of rows of full rank; what is below PART is zero."""
    left = rows.copy()
    row = 0
    for column in range(left.shape[1]):
        if row == len(left):
            break
        pivot = row + int(np.abs(left[row:, column]).argmax())
        if abs(left[pivot, column]) < PART:
            continue
        left[[row, pivot]] = left[[pivot, row]]
        left[row] /= left[row, column]
        others = np.arange(len(left)) != row
        left[others] -= np.outer(left[others, column], left[row])
        row += 1
    return np.where(np.abs(left) < PART, 0.0, left)


def _in_words(basis: np.ndarray, names: list[str]) -> tuple[str, ...]:
    """Each open direction; what only changes places within a set of groups is told once for the set."""
    sets: list[set[int]] = []
    said = []
    for row in basis:
        part = np.flatnonzero(row)
        if len(part) == 1:
            said.append(f"{names[part[0]]} not at all")
        elif len(part) == 2 and abs(row[part].sum()) < 10 * PART:
            joined = [s for s in sets if s & set(part.tolist())]
            sets = [s for s in sets if s not in joined] + [set(part.tolist()).union(*joined)]
        else:
            terms = " ".join(f"{'-' if row[i] < 0 else '+'} {_times(abs(row[i]))}{names[i]}" for i in part)
            said.append(f"the combination {terms.removeprefix('+ ')}")
    together = [sorted(s) for s in sorted(sets, key=min)]
    sums = [f"{', '.join(names[i] for i in s[:-1])} and {names[s[-1]]} only as a sum" for s in together]
    return (*sums, *said)


def _times(factor: float) -> str:
    return "" if abs(factor - 1) < 10 * PART else f"{factor:.3g} "
