"""Least squares on the ten inertial parameters (Atkeson, An, Hollerbach 1986), weighed by the sensor's errors."""

from __future__ import annotations

import numpy as np

from estimators.inertial.body import SIZE, InertialParameters
from estimators.inertial.equations import InertialEquations
from estimators.inertial.estimate import InertialEstimate, drawn_values

UNSEEN = 1e-6
"""Part of a parameter outside what the equations show above which it is not seen."""


def least_squares_inertia(equations: InertialEquations, seed: int = 0) -> InertialEstimate:
    """The parameters that fit best, physical or not; those that the motion does not show are NaN.

    Args:
        equations: equations of the body.
        seed: seed of the draws.
    """
    scale = equations.scale
    inverse = np.linalg.pinv(equations.rows / scale, rcond=1e-6)
    seen = np.linalg.norm(inverse @ (equations.rows / scale) - np.eye(SIZE), axis=1) < UNSEEN
    solutions = (inverse @ np.vstack([equations.values, drawn_values(equations, seed)]).T).T / scale
    solutions = np.where(seen, solutions, np.nan)
    best = InertialParameters.of_vector(solutions[0])
    said = []
    if not seen.all():
        said.append("the motion does not show all of the inertia: accelerate about three axes")
    elif not best.consistent:
        said.append("no body of positive density has these parameters")
    return InertialEstimate(best, solutions[1:], equations.misfit, "; ".join(said))
