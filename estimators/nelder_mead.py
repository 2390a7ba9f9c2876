"""Nelder and Mead's simplex on the explicit model, as scipy has it."""

from __future__ import annotations

from dataclasses import dataclass

from scipy.optimize import minimize

from estimators.baseline import Searched
from estimators.peer import Objective, Peer
from estimators.prediction import Problem


@dataclass(frozen=True)
class NelderMead(Peer):
    """Moves a simplex downhill in log mass and log friction."""

    def _search(self, problem: Problem, seed: int) -> Searched:
        objective = Objective(problem, self.weighting, seed)
        minimize(objective.loss, objective.start, method="Nelder-Mead", options={"maxfev": self.iterations})
        return objective.searched("nelder_mead")
