"""The paper's baselines, and general optimizers on the same loss."""

from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.mujoco_sysid import MujocoSysid
from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
from estimators.baselines.random_search import RandomSearch
from estimators.baselines.weighted_sampling import WeightedSampling

__all__ = [
    "CmaEs",
    "DiffLcp",
    "ExplicitState",
    "LeastSquares",
    "MujocoSysid",
    "NelderMead",
    "RandomSearch",
    "WeightedSampling",
]
