"""Estimators of mass distributions from trajectories, policies that choose actions, and metrics.

The names below load their module on first use: `import estimators` by itself costs nothing.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from estimators.action_selection.greedy import PlannedPolicy
    from estimators.action_selection.online import OnlinePolicy
    from estimators.action_selection.rank import RankDriven
    from estimators.base import ActionPolicy, Estimate, Estimator, HiddenStateEstimate, Trace
    from estimators.baselines.diff_lcp import DiffLcp
    from estimators.baselines.explicit_state import ExplicitState
    from estimators.baselines.mujoco_sysid import MujocoSysid
    from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
    from estimators.baselines.random_search import RandomSearch
    from estimators.baselines.weighted_sampling import WeightedSampling
    from estimators.evaluation.metrics import mean_particle_distance, normalized_absolute_difference
    from estimators.hidden_states.estimator import HiddenStates
    from estimators.identifiability.information import expected, observed
    from estimators.identifiability.report import Identifiability
    from estimators.particles.errors import ModelErrors
    from estimators.particles.windows import Observations, observe
    from estimators.registry import METHODS, build_method
    from estimators.support_models.estimator import SupportAware

_MODULES = {
    "action_selection.greedy": ("PlannedPolicy",),
    "action_selection.online": ("OnlinePolicy",),
    "action_selection.rank": ("RankDriven",),
    "base": ("ActionPolicy", "Estimate", "Estimator", "HiddenStateEstimate", "Trace"),
    "baselines.diff_lcp": ("DiffLcp",),
    "baselines.explicit_state": ("ExplicitState",),
    "baselines.mujoco_sysid": ("MujocoSysid",),
    "baselines.optimizers": ("CmaEs", "LeastSquares", "NelderMead"),
    "baselines.random_search": ("RandomSearch",),
    "baselines.weighted_sampling": ("WeightedSampling",),
    "evaluation.metrics": ("mean_particle_distance", "normalized_absolute_difference"),
    "hidden_states.estimator": ("HiddenStates",),
    "identifiability.information": ("expected", "observed"),
    "identifiability.report": ("Identifiability",),
    "particles.errors": ("ModelErrors",),
    "particles.windows": ("Observations", "observe"),
    "registry": ("METHODS", "build_method"),
    "support_models.estimator": ("SupportAware",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

__all__ = [
    "METHODS",
    "ActionPolicy",
    "CmaEs",
    "DiffLcp",
    "Estimate",
    "Estimator",
    "ExplicitState",
    "HiddenStateEstimate",
    "HiddenStates",
    "Identifiability",
    "LeastSquares",
    "ModelErrors",
    "MujocoSysid",
    "NelderMead",
    "Observations",
    "OnlinePolicy",
    "PlannedPolicy",
    "RandomSearch",
    "RankDriven",
    "SupportAware",
    "Trace",
    "WeightedSampling",
    "build_method",
    "expected",
    "mean_particle_distance",
    "normalized_absolute_difference",
    "observe",
    "observed",
]


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
