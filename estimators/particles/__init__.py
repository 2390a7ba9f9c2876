"""The particle model: dynamics, steady windows of trials, support models, the friction system, and their errors."""

from estimators.particles.friction_system import LinearSystem, LoadGroups, friction_equations, rank_of
from estimators.particles.lifts import LiftErrors, lifted_rows
from estimators.particles.model import (
    EXACT,
    RIGID,
    ModelErrors,
    ParticleModel,
    acceleration,
    inertia_of,
    one_step,
    rollout,
)
from estimators.particles.observe import observe
from estimators.particles.pivots import PivotInertia, inertia_map, pivot_inertias
from estimators.particles.support import GripperLoad, own_weight, rigid_loads
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads, ParticleLoads, WrenchModel, predicted_wrenches

__all__ = [
    "EXACT",
    "RIGID",
    "AffineLoads",
    "GripperLoad",
    "LiftErrors",
    "LinearSystem",
    "LoadGroups",
    "ModelErrors",
    "Observations",
    "ParticleLoads",
    "ParticleModel",
    "PivotInertia",
    "WrenchModel",
    "acceleration",
    "friction_equations",
    "inertia_map",
    "inertia_of",
    "lifted_rows",
    "observe",
    "one_step",
    "own_weight",
    "pivot_inertias",
    "predicted_wrenches",
    "rank_of",
    "rigid_loads",
    "rollout",
]
