"""Moments of inertia from accelerated turns: I_j by slope (Eq. dvp), then c and I_cm (Eq. problem_com_inertia)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimators.particles.windows import Observations

RANK_TOLERANCE = 1e-6
"""Directions of the pivots' spread below this part of the largest count as a straight row."""


@dataclass(frozen=True, eq=False)
class PivotInertia:
    """I_j for each pivot j in S."""

    pivot: Float[np.ndarray, "J 2"]
    """p_j, m, object frame."""
    inertia: Float[np.ndarray, "J"]
    """I_j, kg m^2."""
    variance: Float[np.ndarray, "J"]
    """Of each, (kg m^2)^2."""
    common_error: float = 0.0
    """One error of all together, as a part of I_j."""

    @property
    def covariance(self) -> Float[np.ndarray, "J J"]:
        """(kg m^2)^2."""
        return np.diag(self.variance) + self.common_error**2 * np.outer(self.inertia, self.inertia)


@dataclass(frozen=True, eq=False)
class ComInertia:
    """What the pivots' inertias say of c and I_cm."""

    center_of_mass: Float[np.ndarray, "2"]
    """m; NaN in a component that is not observed."""
    inertia_cm: float
    """kg m^2; NaN where not observed."""
    unobserved: str
    """What is confounded, in words; empty where nothing is."""


def pivot_inertias(
    observations: Observations,
    friction_torque: Float[np.ndarray, "K"],
    inertial_torque: Float[np.ndarray, "K"],
    relative_error: float,
    covariance: Float[np.ndarray, "K K"] | None = None,
) -> PivotInertia | None:
    """I_j by the slope of torque against angular acceleration, pivot by pivot.

    Every trial has a constant of its own, so neither friction nor bias enters: only their change from window to window
    does, and that is what the two corrections take away.

    Args:
        observations: accelerated windows.
        friction_torque: torque that friction takes in each window, up to a constant a trial, N m, (K,).
        inertial_torque: torque of the grasp point's own acceleration, N m, (K,).
        relative_error: of I_j, beyond what the scatter shows: once of each, and once of all together.
        covariance: of the torques less their corrections, (N m)^2; of the torques alone where it is not given.
    """
    if len(observations) == 0:
        return None
    torque = observations.wrench[:, 2].numpy() - friction_torque - inertial_torque
    pivots, designs = _whitened_designs(observations, covariance)
    values, variances = np.empty(len(pivots)), np.empty(len(pivots))
    for j, (rows, whiten, design) in enumerate(designs):
        felt = whiten @ torque[rows]
        solution, *_ = np.linalg.lstsq(design, felt, rcond=None)
        residual = felt - design @ solution
        freedom = max(len(rows) - design.shape[1], 1)
        inverse = np.linalg.inv(design.T @ design)
        values[j] = solution[0]
        variances[j] = inverse[0, 0] * max(1.0, residual @ residual / freedom) + (relative_error * solution[0]) ** 2
    return PivotInertia(pivots, values, variances, relative_error)


def slope_variance(
    observations: Observations, covariance: Float[np.ndarray, "K K"] | None = None
) -> tuple[Float[np.ndarray, "J 2"], Float[np.ndarray, "J"]]:
    """The pivots, m, and the variance of I_j by slope, (kg m^2)^2, that noise and drift of the sensor alone give it."""
    pivots, designs = _whitened_designs(observations, covariance)
    return pivots, np.array([np.linalg.inv(design.T @ design)[0, 0] for _, _, design in designs])


def _whitened_designs(
    observations: Observations, covariance: np.ndarray | None
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """For every pivot: its windows, what takes their torques to unit variance, and the design of slope and constants.

    What the tare left is in the constant of the trial; noise and drift are not.
    """
    alpha = observations.acceleration[:, 2].numpy()
    if covariance is None:
        covariance = (
            np.diag(observations.covariance[:, 2, 2].numpy()) + observations.walk_covariance()[:, 2, :, 2].numpy()
        )
    covariance = covariance + 1e-12 * np.eye(len(alpha))
    pivots, index = np.unique(observations.grasp.numpy().round(9), axis=0, return_inverse=True)
    designs = []
    for j in range(len(pivots)):
        rows = np.flatnonzero(index.ravel() == j)
        trials, trial = np.unique(observations.trial[rows].numpy(), return_inverse=True)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(rows, rows)]))
        designs.append((rows, whiten, whiten @ np.column_stack([alpha[rows], np.eye(len(trials))[trial]])))
    return pivots, designs


def com_and_inertia(pivots: PivotInertia | None, mass: float) -> ComInertia:
    """Solve Eq. problem_com_inertia: I_j - M |p_j|^2 = (I_cm + M |c|^2) - 2 M p_j . c is linear in c and the bracket.

    Pivots in a straight row leave the component of c across the row confounded with I_cm; it is named, not guessed.
    """
    if pivots is None or len(pivots.inertia) < 2:
        return ComInertia(
            np.full(2, np.nan), np.nan, "c and I_cm: fewer than two pivots were turned about with acceleration"
        )
    centre = pivots.pivot.mean(axis=0)
    offsets = pivots.pivot - centre
    _, spread, axes = np.linalg.svd(offsets, full_matrices=True)
    spread = np.append(spread, [0.0, 0.0])[:2]
    seen = spread > RANK_TOLERANCE**0.5 * spread[0]
    along = axes[seen]
    design = np.column_stack([np.ones(len(offsets)), -2 * mass * offsets @ along.T])
    target = pivots.inertia - mass * np.sum(offsets**2, axis=1)
    weight = 1 / np.sqrt(pivots.variance)
    solution, *_ = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)
    shift = solution[1:]
    if seen.all():
        return ComInertia(centre + shift @ along, float(solution[0] - mass * shift @ shift), "")
    row = axes[0]
    com = np.where(np.abs(axes[1]) > 1e-9, np.nan, centre + shift @ along)
    return ComInertia(
        com,
        np.nan,
        f"the pivots lie in a straight row along ({row[0]:.2f}, {row[1]:.2f}): the centre of mass across it is "
        f"confounded with I_cm; only I_cm + M (c_across - {float(centre @ axes[1]):.4f})^2 = "
        f"{solution[0] - mass * shift @ shift:.6f} kg m^2 is known. Turn about a point off the row",
    )
