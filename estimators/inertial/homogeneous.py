"""Masses of homogeneous parts from still poses, and so all inertial parameters (HPS: Nadeau, Giamou, Kelly 2023)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.optimize import nnls

from estimators.inertial.body import InertialParameters
from estimators.inertial.equations import InertialEquations
from estimators.inertial.estimate import InertialEstimate, drawn_values
from testbed.errors import InvalidValueError

MOST_PARTS = 4
"""Parts that still poses distinguish: they show M and M c."""


def homogeneous_parts(
    equations: InertialEquations, parts: Sequence[InertialParameters], seed: int = 0
) -> InertialEstimate:
    """Masses of parts of one density each, none negative, and the inertial parameters that they make.

    The published method takes the equations of still poses alone and at most four parts; those of motions show more.

    Args:
        equations: equations of the whole body.
        parts: parameters of each part, its mass not counting, in the axes of the equations.
        seed: seed of the draws.

    Raises:
        InvalidValueError: no part, or more than the equations can distinguish.
    """
    unit = np.column_stack([part.vector / part.mass for part in parts]) if parts else np.zeros((10, 0))
    rows = equations.rows @ unit
    size = np.linalg.norm(rows, axis=0)
    if not len(parts) or np.linalg.matrix_rank(rows / np.where(size > 0, size, 1.0), rtol=1e-6) < len(parts):
        allowed = f"one or more that the motion distinguishes: at most {MOST_PARTS}, not in one plane, if it is still"
        raise InvalidValueError("parts", len(parts), allowed)
    best = nnls(rows / size, equations.values)[0] / size
    left = equations.values - rows @ best
    of_parts = float(left @ left) / max(
        equations.rank - len(parts), 1
    )  # no draw of the noise, but parts that are not so
    masses = np.array([nnls(rows / size, each)[0] / size for each in drawn_values(equations, seed, of_parts)])
    return InertialEstimate(
        InertialParameters.of_vector(unit @ best),
        masses @ unit.T,
        max(equations.misfit, of_parts),
        part_mass=best,
        part_draws=masses,
    )
