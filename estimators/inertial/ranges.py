"""Ranges of the masses of parts of any density: least and most that the motion allows."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int
from scipy import sparse
from scipy.optimize import nnls
from scipy.stats import chi2

from estimators.inertial.body import InertialParameters
from estimators.inertial.equations import InertialEquations
from estimators.inertial.semidefinite import CONES, least
from testbed.objects.model import ObjectShape

LEVELS = 3
"""Heights at which the mass of a cell may lie, from the object's bottom to its top."""


def part_ranges(
    equations: InertialEquations, places: Float[np.ndarray, "P 3"], part: Int[np.ndarray, "P"], level: float = 0.9
) -> Float[np.ndarray, "n 2"]:
    """Least and most mass of each part, kg, whatever its density, by its profile likelihood (a cone program).

    Where the motion shows a part's mass, this is its interval of probability `level`; else all that no motion excludes.

    Args:
        equations: equations of the whole body.
        places: places where mass may lie, m, in the axes of the equations.
        part: part of each place, counted from 0.
        level: probability.

    Raises:
        HeftError: the solver finds no solution.
    """
    unit = np.column_stack([InertialParameters.of_points(p[None], np.ones(1)).vector for p in places])
    rows = equations.rows @ unit
    size = float(np.linalg.norm(rows, axis=0).mean())
    best, left = nnls(rows / size, equations.values)
    scale = float(best.sum())  # masses as parts of the whole
    spread = max(equations.misfit, left**2 / max(equations.freedom, 1), 1.0)
    radius = float(np.sqrt(left**2 + spread * chi2.ppf(level, 1)))
    count = len(places)
    matrix = np.vstack([-np.eye(count), np.zeros((1, count)), -rows / size * scale / radius])
    bound = np.concatenate([np.zeros(count), [1.0], -equations.values / radius])
    cones = [CONES.NonnegativeConeT(count), CONES.SecondOrderConeT(1 + len(rows))]
    quadratic, constraints = sparse.csc_matrix((count, count)), sparse.csc_matrix(matrix)
    found = np.zeros((int(part.max()) + 1, 2))
    for index in range(len(found)):
        for end, sign in enumerate((1.0, -1.0)):
            program = quadratic, sign * (part == index), constraints, bound, cones
            found[index, end] = scale / size * float(least("part_ranges: the cone program", *program) @ (part == index))
    return found


def places_of(shape: ObjectShape) -> tuple[Float[np.ndarray, "P 3"], Int[np.ndarray, "P"]]:
    """Places where an object may hold mass, m, object frame, and the mass group of each: the corners of its cells."""
    inside = shape.fill > 0
    half = shape.cell / 2
    corners = np.array([[x, y] for x in (-half, half) for y in (-half, half)])
    flat = np.round((shape.particles[inside, None] + corners).reshape(-1, 2), 9)
    keys = np.unique(np.column_stack([flat, np.repeat(shape.mass_group[inside], len(corners))]), axis=0)
    heights = np.repeat(np.linspace(0.0, shape.height, LEVELS), len(keys))
    flat, group = np.tile(keys[:, :2], (LEVELS, 1)), np.tile(keys[:, 2].astype(int), LEVELS)
    return np.column_stack([flat, heights]), group
