"""Moments of inertia I_j about pivots, Eq. dvp; center of mass and inertia from them, Eq. problem_com_inertia."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float
from torch.nn.functional import one_hot

from estimators.hidden_states.equations import FrictionEquations
from estimators.hidden_states.masses import PivotInertia
from estimators.particles.windows import Observations
from estimators.wrench.model import Inertia

RANK_TOLERANCE = 1e-3
"""Smaller spread of the pivots, relative to the larger, below which they count as a straight row."""


class ComInertia(NamedTuple):
    """c and I_cm by the pivots, NaN where they are not observed."""

    center_of_mass: Float[np.ndarray, "2"]
    """Center of mass, m; NaN in a component that is not observed."""
    inertia_cm: float
    """Moment of inertia about it, kg m^2; NaN where not observed."""
    unobserved: str
    """Message that names the confounded quantities; empty where there are none."""


def com_and_inertia(pivots: PivotInertia | None, mass: float) -> ComInertia:
    """Solve Eq. problem_com_inertia: I_j - M |p_j|^2 = (I_cm + M |c|^2) - 2 M p_j . c is linear in c and the bracket.

    Pivots in a straight row leave the component of c across the row confounded with I_cm; both are then NaN.
    """
    if pivots is None or len(pivots.inertia) < 2:
        why = "c and I_cm: fewer than two pivots were turned about with acceleration"
        return ComInertia(np.full(2, np.nan), np.nan, why)
    center = pivots.pivot.mean(axis=0)
    offsets = pivots.pivot - center
    _, spread, axes = np.linalg.svd(offsets, full_matrices=True)
    spread = np.append(spread, [0.0, 0.0])[:2]
    observed = spread > RANK_TOLERANCE * spread[0]
    along = axes[observed]
    design = np.column_stack([np.ones(len(offsets)), -2 * mass * offsets @ along.T])
    target = pivots.inertia - mass * np.sum(offsets**2, axis=1)
    weight = 1 / np.sqrt(pivots.variance)
    solution, *_ = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)
    shift = solution[1:]
    rest = float(solution[0] - mass * shift @ shift)
    if observed.all():
        return ComInertia(center + shift @ along, rest, "")
    row = axes[0]
    com = np.where(np.abs(axes[1]) > 1e-9, np.nan, center + shift @ along)
    why = (
        f"the pivots lie in a straight row along ({row[0]:.2f}, {row[1]:.2f}): the center of mass across it is "
        f"confounded with I_cm; only I_cm + M (c_across - {float(center @ axes[1]):.4f})^2 = {rest:.6f} kg m^2 is "
        "known. Turn about a point off the row"
    )
    return ComInertia(com, np.nan, why)


def pivot_inertias(
    equations: FrictionEquations,
    windows: Observations,
    s: Float[np.ndarray, "n_s"],
    guess: Inertia,
    relative_error: float,
) -> PivotInertia:
    """I_j by the slope of torque less friction over angular acceleration, pivot by pivot, Eq. dvp.

    Every trial has an unknown constant torque, so that only the change of friction and bias between windows matters.

    Args:
        equations: friction equations of the windows, with the effects of an unknown center of mass.
        windows: all windows, some of them accelerated.
        s: friction loads, N.
        guess: inertia whose wrench the equations have subtracted.
        relative_error: relative error of I_j in addition to the scatter: one of each I_j, and one of all together.
    """
    places, torque = torch.nonzero(windows.accelerated).flatten(), torch.zeros_like(equations.b)
    torque[:, 5] = windows.spin_up(guess)
    missing = equations.b + torque - equations.q @ torch.tensor(s)
    pivots, index = np.unique(windows.grasp[places].numpy().round(9), axis=0, return_inverse=True)
    values, variances = np.empty(len(pivots)), np.empty(len(pivots))
    for j in range(len(pivots)):
        own = places[torch.tensor(index.ravel() == j)]
        turned = equations.where(own)
        of_trial = one_hot(torch.unique(windows.trial[own], return_inverse=True)[1]).double()
        rows = torch.zeros(*turned.b.shape, 2 + of_trial.shape[1], dtype=torch.float64)
        rows[:, 5, 0], rows[:, 5, 1:-1], rows[..., -1] = windows.acceleration[own, 2], of_trial, missing[own]
        root = torch.linalg.cholesky(turned.covariance_with("center"))
        white = torch.linalg.solve_triangular(root, rows.flatten(0, 1), upper=False).numpy()
        design, measured = white[:, :-1], white[:, -1]
        solution, *_ = np.linalg.lstsq(design, measured, rcond=None)
        residual, freedom = measured - design @ solution, max(len(white) - design.shape[1], 1)
        variance = np.linalg.inv(design.T @ design)[0, 0] * max(1.0, residual @ residual / freedom)
        values[j], variances[j] = solution[0], variance + (relative_error * solution[0]) ** 2
    return PivotInertia(pivots, values, variances, relative_error)
