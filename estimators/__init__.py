"""Estimators of mass distributions from trajectories, policies that choose actions, and metrics.

The names below load their module on first use, so that `import estimators` is fast.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from estimators.action_selection.greedy import PlannedPolicy
    from estimators.action_selection.online import OnlinePolicy
    from estimators.action_selection.rank import RankDriven
    from estimators.base import ActionPolicy, BatchEstimator, Estimate, Estimator, HiddenStateEstimate, Trace
    from estimators.baselines.diff_lcp import DiffLcp
    from estimators.baselines.explicit_state import ExplicitState
    from estimators.baselines.mujoco_sysid import MujocoSysid
    from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
    from estimators.baselines.sampling import RandomSearch, WeightedSampling
    from estimators.evaluation.metrics import mean_particle_distance, normalized_absolute_difference
    from estimators.hidden_states.estimator import HiddenStates
    from estimators.hidden_states.published import PublishedHiddenStates
    from estimators.identifiability.information import expected, observed
    from estimators.identifiability.report import Identifiability
    from estimators.learned.estimator import Learned
    from estimators.particles.observe import observe
    from estimators.particles.windows import Observations
    from estimators.posterior.estimator import Bayes
    from estimators.registry import METHODS, build_method
    from estimators.support_models.estimator import SupportAware
    from estimators.wrench.model import ModelErrors


__all__ = [
    "METHODS",
    "ActionPolicy",
    "BatchEstimator",
    "Bayes",
    "CmaEs",
    "DiffLcp",
    "Estimate",
    "Estimator",
    "ExplicitState",
    "HiddenStateEstimate",
    "HiddenStates",
    "Identifiability",
    "Learned",
    "LeastSquares",
    "ModelErrors",
    "MujocoSysid",
    "NelderMead",
    "Observations",
    "OnlinePolicy",
    "PlannedPolicy",
    "PublishedHiddenStates",
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

__getattr__, __dir__ = lazy_names(__name__)
