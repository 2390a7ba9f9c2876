"""Estimate of a body's inertial parameters, with draws by which any quantity has an interval; and by least squares."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from estimators.inertial.body import SIZE, InertialParameters
from estimators.inertial.equations import InertialEquations
from testbed.validation import frozen_array

DRAWS = 400
"""Draws of an estimate."""
UNSEEN = 1e-6
"""Part of a parameter outside what the equations show above which it is not seen."""


@dataclass(frozen=True, eq=False)
class InertialEstimate:
    """Inertial parameters, and draws of what else the data allow."""

    parameters: InertialParameters
    """The best."""
    draws: Float[np.ndarray, "N 10"]
    """Vectors of parameters, as likely as the data make them; NaN in what is not seen."""
    misfit: float
    """Squared residual over its variance, mean over degrees of freedom."""
    message: str = ""
    """Unobserved or unphysical parts of the answer."""
    part_mass: Float[np.ndarray, "n"] | None = None
    """Mass of each part, kg; None by methods that know no parts."""
    part_draws: Float[np.ndarray, "N n"] | None = None
    """The same of every draw."""

    def __post_init__(self) -> None:
        draws = frozen_array("InertialEstimate.draws", self.draws, (None, SIZE), finite=False)
        object.__setattr__(self, "draws", draws)

    def interval(
        self, quantity: Callable[[InertialParameters], np.ndarray | float], level: float = 0.9
    ) -> Float[np.ndarray, "2 ..."]:
        """Least and greatest of a quantity between which it lies with a probability of `level`."""
        values = np.array([quantity(InertialParameters.of_vector(draw)) for draw in self.draws])
        return np.quantile(values, [(1 - level) / 2, (1 + level) / 2], axis=0)


def drawn_values(equations: InertialEquations, seed: int, widening: float = 1.0) -> Float[np.ndarray, "N 10"]:
    """Values of the equations as they might have come out; their variance times a misfit that is more than chance.

    Args:
        equations: equations of the body.
        seed: seed of the draws.
        widening: factor of the variance beyond that of the motion's own misfit.
    """
    noise = np.random.default_rng(seed).standard_normal((DRAWS, len(equations.values)))
    return equations.values + np.sqrt(max(equations.misfit, widening, 1.0)) * noise


def least_squares_inertia(equations: InertialEquations, seed: int = 0) -> InertialEstimate:
    """The parameters that fit best, physical or not; those that the motion does not show are NaN.

    As Atkeson, An and Hollerbach (1986) fit them, weighed by the sensor's errors.

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
    message = ""
    if not seen.all():
        message = "the motion does not show all of the inertia: accelerate about three axes"
    elif not best.consistent:
        message = "no body of positive density has these parameters"
    return InertialEstimate(best, solutions[1:], equations.misfit, message)
