"""Algorithm 1 of the paper: mass and friction by way of the hidden states."""

from estimators.hidden_states.algorithm import Solution, Underdetermined, algorithm_1
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.published import PublishedHiddenStates
from estimators.hidden_states.trial_windows import TrialWindows

__all__ = [
    "HiddenStates",
    "PublishedHiddenStates",
    "Solution",
    "TrialWindows",
    "Underdetermined",
    "algorithm_1",
]
