"""Moments of inertia I_j about the pivots of accelerated turns, by the slope of torque over acceleration, Eq. dvp."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from torch import Tensor

from estimators.particles.friction_system import LEAST_VARIANCE, torque_covariance
from estimators.particles.setup_effects import LinearRows
from estimators.particles.windows import Observations
from estimators.wrench.model import inertia_of
from testbed.objects.model import ObjectShape


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
    """One error of all together, as a part of I_j."""

    @property
    def covariance(self) -> Float[np.ndarray, "J J"]:
        """Covariance of I_j, (kg m^2)^2."""
        return np.diag(self.variance) + self.common_error**2 * np.outer(self.inertia, self.inertia)


def corrected_inertias(
    windows: Observations,
    linear: LinearRows,
    mass: Float[Tensor, "P"],
    drag: Float[Tensor, "K P"],
    response: Float[Tensor, "K 3 3"],
    relative_error: float,
) -> PivotInertia | None:
    """I_j of torques less those of friction and of the grasp point's own acceleration; None without windows.

    Args:
        windows: accelerated windows.
        linear: their rows.
        mass: masses of the particles, kg.
        drag: friction of each, N.
        response: change of the rows with lift and tilt, N/N and N m/N m.
        relative_error: as in `pivot_inertias`.
    """
    friction = (linear.by_particle @ drag[..., None])[:, 2, 0]
    inertial = linear.motion(mass)[:, 2] - windows.spin_up(inertia_of(linear.model, mass))
    covariance = torque_covariance(windows, linear, response)
    return pivot_inertias(windows, friction.numpy(), inertial.numpy(), relative_error, covariance)


def pivot_inertias(
    observations: Observations,
    friction_torque: Float[np.ndarray, "K"],
    inertial_torque: Float[np.ndarray, "K"],
    relative_error: float,
    covariance: Float[np.ndarray, "K K"] | None = None,
) -> PivotInertia | None:
    """I_j by the slope of torque against angular acceleration, pivot by pivot.

    Every trial has a constant of its own, so neither friction nor bias enters: only their change from window to window
    does, and the two corrections take it away.

    Args:
        observations: accelerated windows.
        friction_torque: torque of friction in each window, up to a constant a trial, N m, (K,).
        inertial_torque: torque of the grasp point's own acceleration, N m, (K,).
        relative_error: error of I_j beyond the scatter: once of each, and once of all together.
        covariance: covariance of the torques less their corrections, (N m)^2; without it, that of the torques alone.
    """
    if len(observations) == 0:
        return None
    torque = observations.wrench[:, 2].numpy() - friction_torque - inertial_torque
    pivots, designs = _whitened_designs(observations, covariance)
    values, variances = np.empty(len(pivots)), np.empty(len(pivots))
    for j, (rows, whiten, design) in enumerate(designs):
        measured = whiten @ torque[rows]
        solution, *_ = np.linalg.lstsq(design, measured, rcond=None)
        residual = measured - design @ solution
        freedom = max(len(rows) - design.shape[1], 1)
        inverse = np.linalg.inv(design.T @ design)
        values[j] = solution[0]
        variances[j] = inverse[0, 0] * max(1.0, residual @ residual / freedom) + (relative_error * solution[0]) ** 2
    return PivotInertia(pivots, values, variances, relative_error)


def _whitened_designs(
    observations: Observations, covariance: np.ndarray | None
) -> tuple[np.ndarray, list[tuple[np.ndarray, np.ndarray, np.ndarray]]]:
    """Windows of every pivot, the whitening of their torques, and the design of slope and constants.

    The tare's bias is in the constant of the trial; noise and drift are not.
    """
    alpha = observations.acceleration[:, 2].numpy()
    if covariance is None:
        noise = np.diag(observations.covariance[:, 2, 2].numpy() + LEAST_VARIANCE)
        covariance = noise + observations.walk_covariance()[:, 2, :, 2].numpy()
    pivots, index = np.unique(observations.grasp.numpy().round(9), axis=0, return_inverse=True)
    designs = []
    for j in range(len(pivots)):
        rows = np.flatnonzero(index.ravel() == j)
        trials, trial = np.unique(observations.trial[rows].numpy(), return_inverse=True)
        whiten = np.linalg.inv(np.linalg.cholesky(covariance[np.ix_(rows, rows)]))
        designs.append((rows, whiten, whiten @ np.column_stack([alpha[rows], np.eye(len(trials))[trial]])))
    return pivots, designs


def inertia_map(shape: ObjectShape, points: Float[np.ndarray, "J 2"]) -> Float[np.ndarray, "J n_m"]:
    """Map from particle masses to the inertia about each point, m^2; cells are solid."""
    squares = np.sum((shape.particles[None] - points[:, None]) ** 2, axis=2) + shape.cell**2 / 6
    return shape.per_group(squares)
