"""Identifiability of an object's masses: rank, standard errors, and open directions, named in its groups.

All quantities follow from one matrix: the derivatives of the measurements in the masses and frictions, over the errors
of the measurements. Its square is the Fisher information, so at the truth the errors are the Cramer-Rao bound.
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
"""Greatest number of sets of unknowns that the search for sparse open directions tries."""
LOOSE = 1 / 3
"""Error of a group's mass, as a part of the prior error, up to which it counts as known. Ours."""
PART = 1e-3
"""Part of an open direction below which a group does not belong to it."""


@dataclass(frozen=True, eq=False)
class Identifiability:
    """Rank and errors that a set of trials gives, and the directions that it leaves open."""

    group_names: tuple[str, ...]
    """Names of the mass groups."""
    covariance: Float[np.ndarray, "n_m n_m"]
    """Covariance of the mass groups [kg^2], infinite where they are in an open direction."""
    friction_error: Float[np.ndarray, "n_mu"]
    """Standard error of each friction coefficient, infinite where open."""
    rank: int
    """Number of observed directions, out of `unknowns`."""
    unknowns: int
    """n_m + n_mu."""
    condition: float
    """Ratio of the best to the worst observed direction, masses as parts of M, frictions as parts of themselves."""
    open_directions: Float[np.ndarray, "D unknowns"]
    """Changes of the masses [kg per group] and frictions that no measurement shows, sparse, one per row."""
    unobservable: tuple[str, ...]
    """Open directions in words."""
    hinge_error: tuple[float, ...] = ()
    """Standard error of the friction of each hinge of an object in links [N m]."""

    def __post_init__(self) -> None:
        n_m, n_mu = len(self.group_names), len(self.friction_error)
        for name, size in (("covariance", (n_m, n_m)), ("friction_error", (n_mu,))):
            checked = frozen_array(f"Identifiability.{name}", getattr(self, name), size, finite=False)
            object.__setattr__(self, name, checked)

    @property
    def ambiguity(self) -> str:
        """Open directions in a sentence; empty without any."""
        found = "; ".join(self.unobservable)
        return f"mass and friction cannot be told apart: {found}" if found else ""

    @property
    def standard_error(self) -> Float[np.ndarray, "n_m"]:
        """Standard error of each mass group [kg], infinite where open."""
        return np.sqrt(np.diagonal(self.covariance))

    @property
    def sentence(self) -> str:
        """Summary of the observed and the open directions."""
        text = f"all {self.unknowns} masses and frictions are observed"
        if self.rank < self.unknowns:
            open_ = "; ".join(self.unobservable)
            text = f"{self.rank} of {self.unknowns} masses and frictions are observed; open: {open_}"
        hinges = [f"{1e3 * error:.2g}" for error in self.hinge_error]
        more = [f"friction of hinges: standard error {', '.join(hinges)} mN m"] if hinges else []
        return "; ".join([text, *more])


def identifiability(
    shape: ObjectShape, distribution: MassDistribution, root: Float[np.ndarray, "R unknowns"]
) -> Identifiability:
    """Report of a whitened Jacobian in the particle masses [kg] and frictions, taken at a distribution.

    A direction is observed where its standard error is below the object's mass, or the size of a friction: the weighing
    alone gives that bound for masses >= 0.
    """
    count, n_m = shape.particles_per_group, shape.n_m
    whole = float(distribution.mass @ count)
    per_unit = np.concatenate([whole / count, np.maximum(distribution.friction, 1e-6)])
    _, values, directions = np.linalg.svd(root * per_unit, full_matrices=len(root) < len(per_unit))
    values = np.append(values, np.zeros(len(directions) - len(values)))
    observed = values > 1.0
    unit = np.concatenate([np.full(n_m, whole), per_unit[n_m:]])
    scaled = directions * unit
    covariance = (scaled[observed].T / values[observed] ** 2) @ scaled[observed]
    blind = (np.abs(directions[~observed]) > PART).any(axis=0)
    covariance[np.ix_(blind, blind)] = np.inf
    basis = _sparse(directions[~observed])
    return Identifiability(
        shape.group_names,
        covariance[:n_m, :n_m],
        np.sqrt(np.diagonal(covariance)[n_m:]),
        int(observed.sum()),
        len(unit),
        float(values[observed].max() / values[observed].min()) if observed.any() else np.inf,
        basis * unit,
        _in_words(basis, [*shape.group_names, *shape.friction_names]),
    )


def prior_masses(shape: ObjectShape, weight: float) -> Float[np.ndarray, "n_m n_m"]:
    """Covariance of particle masses before any trial, with all splits of M equally likely [kg^2].

    The shares have a Dirichlet distribution in proportion to the groups' sizes: for blocks of one size it is uniform
    over the simplex.
    """
    count = shape.particles_per_group
    part = count / count.sum()
    covariance = (np.diag(part) - np.outer(part, part)) / (shape.n_m + 1)
    return weight**2 * covariance / np.outer(count, count)


def hardly_known(shape: ObjectShape, mass: Float[np.ndarray, "n_m"], covariance: Float[np.ndarray, "n_m n_m"]) -> str:
    """Groups whose masses are consistent with 0 and are not known much better than before any trial, in words.

    Args:
        shape: geometry and groups.
        mass: particle masses, kg.
        covariance: their covariance, kg^2.
    """
    count, masses = shape.particles_per_group, mass * shape.particles_per_group
    errors, before = (np.sqrt(np.diag(each)) * count for each in (covariance, prior_masses(shape, masses.sum())))
    loose = [
        f"{name} {masses[g]:.3f} +- {errors[g]:.3f} kg"
        for g, name in enumerate(shape.group_names)
        if errors[g] > max(LOOSE * before[g], masses[g])
    ]
    return f"hardly known: {', '.join(loose)}" if loose else ""


def _sparse(rows: np.ndarray) -> np.ndarray:
    """Basis of the row space whose vectors have the fewest unknowns, by a search over small sets of them."""
    count, columns = rows.shape
    basis, tried = np.empty((0, columns)), 0
    for size in range(1, columns - count + 2):
        if len(basis) == count or tried + math.comb(columns, size) > MOST_SETS:
            break
        tried += math.comb(columns, size)
        inside = np.array(list(combinations(range(columns), size)))
        outside = np.ones((len(inside), columns), dtype=bool)
        np.put_along_axis(outside, inside, False, axis=1)
        # a vector of the space that is zero outside a set is a left null vector of the columns outside
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
    """Vector scaled to whole numbers where they are near, else to a largest entry of 1; its first entry is positive."""
    vector = np.where(np.abs(vector) < PART * np.abs(vector).max(), 0.0, vector)
    entries = vector[vector != 0]
    whole = entries / np.abs(entries).min()
    near = np.abs(whole - np.round(whole)).max() < 10 * PART
    scaled = vector * np.sign(entries[0]) / (np.abs(entries).min() if near else np.abs(entries).max())
    return np.round(scaled) if near else scaled


def _echelon(rows: np.ndarray) -> np.ndarray:
    """Reduced row echelon form of rows of full rank; entries below PART are zero."""
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
    """Words for each open direction; groups whose masses only change places are named together."""
    sets: list[set[int]] = []
    words = []
    for row in basis:
        part = np.flatnonzero(row)
        if len(part) == 1:
            words.append(f"{names[part[0]]} not at all")
        elif len(part) == 2 and abs(row[part].sum()) < 10 * PART:
            joined = [s for s in sets if s & set(part.tolist())]
            sets = [s for s in sets if s not in joined] + [set(part.tolist()).union(*joined)]
        else:
            terms = " ".join(f"{'-' if row[i] < 0 else '+'} {_times(abs(row[i]))}{names[i]}" for i in part)
            words.append(f"the combination {terms.removeprefix('+ ')}")
    together = [sorted(s) for s in sorted(sets, key=min)]
    sums = [f"{', '.join(names[i] for i in s[:-1])} and {names[s[-1]]} only as a sum" for s in together]
    return (*sums, *words)


def _times(factor: float) -> str:
    return "" if abs(factor - 1) < 10 * PART else f"{factor:.3g} "
