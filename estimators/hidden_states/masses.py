"""Last line of Algorithm 1: mass and friction from the hidden states, by weighted non-negative least squares.

With nu = 1 / mu every hidden state is linear in (m, nu): s_h nu_k = g m_h, sum m = M, and the inertia about every
pivot, I_j = sum m_i |p_i - p_j|^2, which contains c and I_cm also where they are confounded.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.optimize import nnls

from estimators.particles.load_groups import weight_per_mass
from estimators.posterior.scale import Weighing
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape

ROUNDS = 8
"""Reweighting rounds: the error of s nu depends on nu."""
NEGLIGIBLE_LOAD = 1e-9
"""Drag below which a friction group is frictionless, N."""
SMALLEST_PART = 1e-3
"""Least ratio of two frictions."""
RANK_TOLERANCE = 1e-9
"""Singular value, relative to the largest, below which a direction is not observed."""

Pairs = tuple[tuple[int, int], ...]
"""Mass group and friction group of each s."""


@dataclass(frozen=True, eq=False)
class PivotInertia:
    """Moments of inertia I_j about the pivots j in S."""

    pivot: Float[np.ndarray, "J 2"]
    """p_j, m, object frame."""
    inertia: Float[np.ndarray, "J"]
    """I_j, kg m^2."""
    variance: Float[np.ndarray, "J"]
    """Variance of each, (kg m^2)^2."""
    common_error: float = 0.0
    """Relative error that all I_j share."""

    @property
    def covariance(self) -> Float[np.ndarray, "J J"]:
        """Covariance of I_j, (kg m^2)^2."""
        return np.diag(self.variance) + self.common_error**2 * np.outer(self.inertia, self.inertia)


def inertia_map(shape: ObjectShape, points: Float[np.ndarray, "J 2"]) -> Float[np.ndarray, "J n_m"]:
    """Map from particle masses to the inertia about each point, m^2, with solid cells."""
    squares = np.sum((shape.particles[None] - points[:, None]) ** 2, axis=2) + shape.cell**2 / 6
    return shape.per_group(squares)


@dataclass(frozen=True, eq=False)
class MassSolution:
    """Mass and friction, and the rank of the system that determines them."""

    distribution: MassDistribution
    rank: int
    """Rank of the system, out of `unknowns`."""
    unknowns: int
    """n_m and the number of friction groups with friction."""


def solve_masses(
    shape: ObjectShape,
    weight: float,
    weighing: Weighing,
    pairs: Pairs,
    loads: Float[np.ndarray, "n_s"],
    load_covariance: Float[np.ndarray, "n_s n_s"],
    pivots: PivotInertia | None,
) -> MassSolution:
    """Split s into mass and friction.

    Args:
        shape: geometry and groups.
        weight: M, kg.
        weighing: derivatives and error of its reading.
        pairs: mass and friction group of each s.
        loads: s of one particle in each group pair, N.
        load_covariance: covariance of s, N^2.
        pivots: I_j, if any accelerated turn was given.
    """
    n_m = shape.n_m
    rough = _rough_groups(shape, pairs, loads, load_covariance)
    kept = np.array([f in rough for _, f in pairs])
    nu_of = np.array([rough.index(f) for _, f in pairs if f in rough], dtype=int)
    unknowns = n_m + len(rough)
    mass_of = np.array([m for m, f in pairs if f in rough], dtype=int)

    s_rows = np.zeros((len(nu_of), unknowns))
    s_rows[np.arange(len(nu_of)), mass_of] = weight_per_mass(shape, pairs)[kept]
    s_rows[np.arange(len(nu_of)), n_m + nu_of] = -loads[kept]
    fixed, values = fixed_rows(shape, weight, weighing, pivots, unknowns)
    target = np.concatenate([np.zeros(len(nu_of)), values])
    lower = np.linalg.cholesky(load_covariance[np.ix_(kept, kept)] + 1e-18 * np.eye(len(nu_of)))

    nu = np.full(len(rough), weight * GRAVITY / max(loads @ feet_of(shape, pairs), NEGLIGIBLE_LOAD))
    unknown, system = np.zeros(unknowns), fixed
    for _ in range(ROUNDS):
        nu = np.maximum(nu, SMALLEST_PART * nu.max(initial=1.0))
        system = np.vstack([np.linalg.solve(lower, s_rows / nu[nu_of, None]), fixed])
        unknown, _ = nnls(system, target)
        nu = unknown[n_m:]
    friction = np.zeros(shape.n_mu)
    friction[rough] = 1 / np.maximum(nu, SMALLEST_PART * nu.max(initial=1.0))
    scaled = system / np.maximum(np.linalg.norm(system, axis=0), 1e-300)
    strength = np.linalg.svd(scaled, compute_uv=False)
    return MassSolution(
        MassDistribution(unknown[:n_m], friction), int((strength >= RANK_TOLERANCE * strength[0]).sum()), unknowns
    )


def _rough_groups(shape: ObjectShape, pairs: Pairs, loads: np.ndarray, covariance: np.ndarray) -> list[int]:
    """Friction groups whose drag exceeds three standard errors; s of the others shows no mass."""
    feet = feet_of(shape, pairs)
    rough = []
    for group in range(shape.n_mu):
        part = feet * np.array([f == group for _, f in pairs])
        if part @ loads > max(NEGLIGIBLE_LOAD, 3 * np.sqrt(part @ covariance @ part)):
            rough.append(group)
    return rough


def one_friction_masses(
    shape: ObjectShape, weight: float, pairs: Pairs, loads: Float[np.ndarray, "n_s"]
) -> MassDistribution:
    """Masses that explain s with one friction for all groups."""
    on_group = np.bincount([m for m, _ in pairs], feet_of(shape, pairs) * loads, shape.n_m)
    drag = max(float(on_group.sum()), NEGLIGIBLE_LOAD)
    mass = weight * on_group / drag / shape.particles_per_group
    return MassDistribution(mass, np.full(shape.n_mu, drag / (weight * GRAVITY)))


def friction_loads(shape: ObjectShape, pairs: Pairs, at: MassDistribution) -> Float[np.ndarray, "n_s"]:
    """s = mu m g of one particle of each pair under given masses and frictions, N."""
    return load_jacobian(shape, pairs, at)[:, : shape.n_m] @ at.mass


def load_jacobian(shape: ObjectShape, pairs: Pairs, at: MassDistribution) -> Float[np.ndarray, "n_s unknowns"]:
    """Derivatives of every s in particle masses, N/kg, and frictions, N."""
    slopes, rows = np.zeros((len(pairs), shape.n_m + shape.n_mu)), np.arange(len(pairs))
    mass_of, friction_of = np.array(pairs, dtype=int).reshape(-1, 2).T
    per_mass = weight_per_mass(shape, pairs)
    slopes[rows, mass_of] = at.friction[friction_of] * per_mass
    slopes[rows, shape.n_m + friction_of] = at.mass[mass_of] * per_mass
    return slopes


def fixed_rows(
    shape: ObjectShape, weight: float, weighing: Weighing, pivots: PivotInertia | None, unknowns: int
) -> tuple[np.ndarray, np.ndarray]:
    """Rows of the weight and of the inertia about every pivot, and their values, in units of their errors."""
    rows, values = weighing.row(shape.n_m)[None], np.array([weight / weighing.error])
    if pivots is not None:
        whiten = np.linalg.inv(np.linalg.cholesky(pivots.covariance))
        rows = np.vstack([rows, whiten @ inertia_map(shape, pivots.pivot)])
        values = np.append(values, whiten @ pivots.inertia)
    return np.hstack([rows, np.zeros((len(rows), unknowns - shape.n_m))]), values


def feet_of(shape: ObjectShape, pairs: Pairs) -> Float[np.ndarray, "n_s"]:
    """Number of particles in contact in each pair of groups."""
    both = list(zip(shape.mass_group.tolist(), shape.friction_group.tolist(), strict=True))
    return np.array([both.count(pair) for pair in pairs])
