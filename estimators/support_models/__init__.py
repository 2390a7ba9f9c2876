"""Estimation where the support is not known: a test of the support models, and the masses that fit each."""

from estimators.posterior.support import SupportTest, support_test
from estimators.support_models.estimator import SupportAware
from estimators.support_models.materials import RankedAssignments, rank_assignments
from estimators.support_models.polytope import MassPolytope

__all__ = [
    "MassPolytope",
    "RankedAssignments",
    "SupportAware",
    "SupportTest",
    "rank_assignments",
    "support_test",
]
