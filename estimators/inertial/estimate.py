"""Estimate of a body's inertial parameters, with draws for intervals of any quantity; least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from estimators.inertial.body import SIZE, InertialParameters
from estimators.inertial.equations import InertialEquations
from testbed.validation import frozen_array

DRAWS = 400
"""Number of draws of an estimate."""
UNOBSERVED = 1e-6
"""Part of a parameter outside the row space of the equations above which it is not observed."""
OPEN = "the motion does not show all of the inertia: accelerate about three axes"
"""Message where parameters are not observed."""


@dataclass(frozen=True, eq=False)
class InertialEstimate:
    """Inertial parameters with draws from their posterior."""

    parameters: InertialParameters
    """Most likely parameters."""
    draws: Float[np.ndarray, "N 10"]
    """Draws of the parameters' vector; NaN in parameters that are not observed."""
    misfit: float
    """Squared residual over its variance, mean over degrees of freedom."""
    message: str = ""
    """Message about unobserved or unphysical parameters; empty where there are none."""
    part_mass: Float[np.ndarray, "n"] | None = None
    """Mass of each part, kg; None for methods without parts."""
    part_draws: Float[np.ndarray, "N n"] | None = None
    """Masses of the parts in every draw, kg."""

    def __post_init__(self) -> None:
        draws = frozen_array("InertialEstimate.draws", self.draws, (None, SIZE), finite=False)
        object.__setattr__(self, "draws", draws)

    def interval(
        self, quantity: Callable[[InertialParameters], np.ndarray | float], level: float = 0.9
    ) -> Float[np.ndarray, "2 ..."]:
        """Ends of the interval of a quantity, of probability `level`."""
        values = np.array([quantity(InertialParameters.of_vector(draw)) for draw in self.draws])
        return np.quantile(values, [(1 - level) / 2, (1 + level) / 2], axis=0)


def drawn_values(equations: InertialEquations, seed: int, widening: float = 1.0) -> Float[np.ndarray, "N 10"]:
    """Draws of the values of the equations, with their variance times the misfit if it is above 1.

    Args:
        equations: equations of the body.
        seed: seed of the draws.
        widening: least factor on the variance.
    """
    noise = np.random.default_rng(seed).standard_normal((DRAWS, len(equations.values)))
    return equations.values + np.sqrt(max(equations.misfit, widening, 1.0)) * noise


def is_observed(equations: InertialEquations) -> Bool[np.ndarray, "10"]:
    """True for the parameters that the equations determine."""
    return np.linalg.norm(equations.unseen, axis=1) < UNOBSERVED


def least_squares_inertia(equations: InertialEquations, seed: int = 0) -> InertialEstimate:
    """Least-squares parameters, physical or not, NaN where the motion does not show them.

    The fit of Atkeson, An and Hollerbach (1986), weighted by the sensor's errors.

    Args:
        equations: equations of the body.
        seed: seed of the draws.
    """
    scale = equations.scale
    inverse = np.linalg.pinv(equations.rows / scale, rcond=1e-6)
    observed = is_observed(equations)
    solutions = (inverse @ np.vstack([equations.values, drawn_values(equations, seed)]).T).T / scale
    solutions = np.where(observed, solutions, np.nan)
    best = InertialParameters.of_vector(solutions[0])
    message = ""
    if not observed.all():
        message = OPEN
    elif not best.consistent:
        message = "no body of positive density has these parameters"
    return InertialEstimate(best, solutions[1:], equations.misfit, message)
