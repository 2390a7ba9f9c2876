"""Masses of an object's parts: for one density each (HPS: Nadeau, Giamou, Kelly 2023), and ranges for any density."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.optimize import nnls
from scipy.special import chdtri

from estimators.inertial.body import InertialParameters
from estimators.inertial.equations import InertialEquations
from estimators.inertial.estimate import InertialEstimate, drawn_values
from estimators.inertial.semidefinite import CONES, minimizer
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape

MOST_PARTS = 4
"""Largest number of parts that still poses distinguish, which show M and M c."""
LEVELS = 3
"""Number of heights at which the mass of a cell may lie, from the object's bottom to its top."""


def homogeneous_parts(
    equations: InertialEquations, parts: Sequence[InertialParameters], seed: int = 0
) -> InertialEstimate:
    """Non-negative masses of parts of one density each, and the inertial parameters of the whole.

    The published method uses equations of still poses and at most four parts; equations of motions distinguish more.

    Args:
        equations: equations of the whole body.
        parts: parameters of each part in the axes of the equations, of any mass.
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
    shown = equations.directions
    left, free = shown.T @ (equations.values - rows @ best), shown.shape[1] - len(parts)
    # a residual of parts that are not homogeneous, not of noise
    of_parts = float(left @ left) / free if free > 0 else 0.0
    masses = np.array([nnls(rows / size, each)[0] / size for each in drawn_values(equations, seed, of_parts)])
    return InertialEstimate(
        InertialParameters.of_vector(unit @ best),
        masses @ unit.T,
        max(equations.misfit, of_parts),
        part_mass=best,
        part_draws=masses,
    )


def part_ranges(
    equations: InertialEquations, places: Float[np.ndarray, "P 3"], part: Int[np.ndarray, "P"], level: float = 0.9
) -> Float[np.ndarray, "n 2"]:
    """Least and greatest mass of each part, kg, for any density, by its profile likelihood (a cone program).

    An interval of probability `level` where the motion shows a part's mass; else all masses that it does not exclude.

    Args:
        equations: equations of the whole body.
        places: points at which mass may lie, m, in the axes of the equations.
        part: index of each point's part.
        level: probability.

    Raises:
        HeftError: the solver finds no solution.
    """
    unit = np.column_stack([InertialParameters.of_points(p[None], np.ones(1)).vector for p in places])
    rows = equations.rows @ unit
    size = float(np.linalg.norm(rows, axis=0).mean())
    best, left = nnls(rows / size, equations.values)
    scale, shown = float(best.sum()), equations.directions  # masses as parts of the whole
    off = shown.T @ (equations.values - rows @ best / size)
    spread = max(equations.misfit, float(off @ off) / shown.shape[1], 1.0)
    radius = float(np.sqrt(left**2 + spread * chdtri(1, 1 - level)))
    count = len(places)
    matrix = np.vstack([-np.eye(count), np.zeros((1, count)), -rows / size * scale / radius])
    bound = np.concatenate([np.zeros(count), [1.0], -equations.values / radius])
    cones = [CONES.NonnegativeConeT(count), CONES.SecondOrderConeT(1 + len(rows))]
    quadratic, constraints = sparse.csc_matrix((count, count)), sparse.csc_matrix(matrix)
    found = np.zeros((int(part.max()) + 1, 2))
    for index in range(len(found)):
        for end, sign in enumerate((1.0, -1.0)):
            program = quadratic, sign * (part == index), constraints, bound, cones
            found[index, end] = (
                scale / size * float(minimizer("part_ranges: the cone program", *program) @ (part == index))
            )
    return found


def places_of(shape: ObjectShape) -> tuple[Float[np.ndarray, "P 3"], Int[np.ndarray, "P"]]:
    """Points at which an object's mass may lie, the corners of its cells, m, object frame, and their mass groups."""
    inside = shape.fill > 0
    half = shape.cell / 2
    corners = np.array([[x, y] for x in (-half, half) for y in (-half, half)])
    flat = np.round((shape.particles[inside, None] + corners).reshape(-1, 2), 9)
    keys = np.unique(np.column_stack([flat, np.repeat(shape.mass_group[inside], len(corners))]), axis=0)
    heights = np.repeat(np.linspace(0.0, shape.height, LEVELS), len(keys))
    flat, group = np.tile(keys[:, :2], (LEVELS, 1)), np.tile(keys[:, 2].astype(int), LEVELS)
    return np.column_stack([flat, heights]), group
