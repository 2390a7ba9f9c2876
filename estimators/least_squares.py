"""Nonlinear least squares on the explicit model, by scipy's trust region (Branch, Coleman and Li 1999)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from scipy.optimize import least_squares

from estimators.baseline import Searched
from estimators.peer import Objective, Peer
from estimators.prediction import Problem


@dataclass(frozen=True)
class LeastSquares(Peer):
    """Fits mass and friction to every wrench at once, in log mass and log friction; slopes are differences."""

    def _search(self, problem: Problem, seed: int) -> Searched:
        objective = Objective(problem, self.weighting, seed)

        def residuals(point: np.ndarray) -> np.ndarray:
            objective.losses(point[None])
            guess = objective.coordinates.candidates(torch.tensor(point[None]))
            return problem.residuals(guess.mass[0], guess.friction[0], self.weighting).numpy()

        steps = self.iterations // (len(objective.start) + 1)  # a difference along every direction each
        least_squares(residuals, objective.start, max_nfev=max(steps, 1))
        return objective.searched("least_squares")
