"""Inertial parameters of a body that is held in the air: M, c and the inertia, from its motion and wrench.

Least squares (`least_squares_inertia`), the same on physically consistent parameters (`consistent_inertia`), masses of
homogeneous parts (`homogeneous_parts`) and ranges of those of any density (`part_ranges`), from the same equations with
the same errors: of a motion (`inertial_equations`), or of trials with lifts (`lift_equations`).
"""

from estimators.inertial.body import InertialParameters, pseudo_inertia
from estimators.inertial.equations import HeldMotion, InertialEquations, inertial_equations, joined
from estimators.inertial.estimate import InertialEstimate, least_squares_inertia
from estimators.inertial.lifts import lift_equations
from estimators.inertial.part_masses import homogeneous_parts, part_ranges, places_of
from estimators.inertial.parts import column_parts, ellipsoid_of, solid_parts, true_body
from estimators.inertial.semidefinite import Ellipsoid, consistent_inertia

__all__ = [
    "Ellipsoid",
    "HeldMotion",
    "InertialEquations",
    "InertialEstimate",
    "InertialParameters",
    "column_parts",
    "consistent_inertia",
    "ellipsoid_of",
    "homogeneous_parts",
    "inertial_equations",
    "joined",
    "least_squares_inertia",
    "lift_equations",
    "part_ranges",
    "places_of",
    "pseudo_inertia",
    "solid_parts",
    "true_body",
]
