"""Inertial parameters of a body that is held in the air: M, c and the inertia, from its motion and wrench.

Least squares (`least_squares_inertia`), the same on physically consistent parameters (`consistent_inertia`) and masses
of homogeneous parts (`homogeneous_parts`), from the same equations with the same errors.
"""

from estimators.inertial.body import InertialParameters, pseudo_inertia
from estimators.inertial.equations import HeldMotion, InertialEquations, inertial_equations, joined
from estimators.inertial.estimate import InertialEstimate
from estimators.inertial.homogeneous import homogeneous_parts
from estimators.inertial.ordinary import least_squares_inertia
from estimators.inertial.semidefinite import Ellipsoid, consistent_inertia

__all__ = [
    "Ellipsoid",
    "HeldMotion",
    "InertialEquations",
    "InertialEstimate",
    "InertialParameters",
    "consistent_inertia",
    "homogeneous_parts",
    "inertial_equations",
    "joined",
    "least_squares_inertia",
    "pseudo_inertia",
]
