"""Center of mass and moment of inertia from the inertias I_j about several pivots, Eq. problem_com_inertia."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from estimators.particles.pivots import PivotInertia

RANK_TOLERANCE = 1e-6
"""Directions of the pivots' spread below this part of the largest count as a straight row."""


class ComInertia(NamedTuple):
    """c and I_cm as far as the pivots show them."""

    center_of_mass: Float[np.ndarray, "2"]
    """Center of mass, m; NaN in a component that is not observed."""
    inertia_cm: float
    """Moment of inertia about it, kg m^2; NaN where not observed."""
    unobserved: str
    """Confounded numbers in words; empty where there are none."""


def com_and_inertia(pivots: PivotInertia | None, mass: float) -> ComInertia:
    """Solve Eq. problem_com_inertia: I_j - M |p_j|^2 = (I_cm + M |c|^2) - 2 M p_j . c is linear in c and the bracket.

    Pivots in a straight row leave the component of c across the row confounded with I_cm; it is named, not guessed.
    """
    if pivots is None or len(pivots.inertia) < 2:
        why = "c and I_cm: fewer than two pivots were turned about with acceleration"
        return ComInertia(np.full(2, np.nan), np.nan, why)
    center = pivots.pivot.mean(axis=0)
    offsets = pivots.pivot - center
    _, spread, axes = np.linalg.svd(offsets, full_matrices=True)
    spread = np.append(spread, [0.0, 0.0])[:2]
    seen = spread > RANK_TOLERANCE**0.5 * spread[0]
    along = axes[seen]
    design = np.column_stack([np.ones(len(offsets)), -2 * mass * offsets @ along.T])
    target = pivots.inertia - mass * np.sum(offsets**2, axis=1)
    weight = 1 / np.sqrt(pivots.variance)
    solution, *_ = np.linalg.lstsq(design * weight[:, None], target * weight, rcond=None)
    shift = solution[1:]
    rest = float(solution[0] - mass * shift @ shift)
    if seen.all():
        return ComInertia(center + shift @ along, rest, "")
    row = axes[0]
    com = np.where(np.abs(axes[1]) > 1e-9, np.nan, center + shift @ along)
    why = (
        f"the pivots lie in a straight row along ({row[0]:.2f}, {row[1]:.2f}): the center of mass across it is "
        f"confounded with I_cm; only I_cm + M (c_across - {float(center @ axes[1]):.4f})^2 = {rest:.6f} kg m^2 is "
        "known. Turn about a point off the row"
    )
    return ComInertia(com, np.nan, why)
