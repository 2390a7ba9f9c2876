"""CMA-ES on the explicit model: an evolving covariance (Hansen 2016), as the cmaes package has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from cmaes import CMA
from scipy.optimize import least_squares, minimize

from estimators.baselines.base import FIRST_DEVIATION, Objective, Peer, Searched
from estimators.baselines.problem import Problem
from testbed.errors import InvalidValueError
from testbed.validation import check_positive


@dataclass(frozen=True)
class CmaEs(Peer):
    """Draws generations from a Gaussian in log mass and log friction whose covariance learns from the best of each.

    All but the first deviation is the package's default.
    """

    first_deviation: float = FIRST_DEVIATION
    """Of log mass and log friction; the package has no default."""
    population: int = 0
    """Samples a generation; 0 is the package's 4 + 3 ln(n)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("CmaEs.first_deviation", self.first_deviation)
        whole = isinstance(self.population, int) and not isinstance(self.population, bool)
        if not (whole and (self.population == 0 or self.population >= 5)):
            raise InvalidValueError("CmaEs.population", self.population, "0, or an integer >= 5")

    def _search(self, problem: Problem, seed: int) -> Searched:
        objective = Objective(problem, self.weighting, seed)
        size = self.population or None
        search = CMA(objective.start, self.first_deviation, seed=seed % 2**32, population_size=size)
        left = self.iterations
        while left > 0 and not search.should_stop():
            points = np.array([search.ask() for _ in range(search.population_size)])
            losses = objective.losses(points[:left])
            left -= len(losses)
            if len(losses) == len(points):
                search.tell(list(zip(points, losses.tolist(), strict=True)))
        return objective.searched("cma_es")


@dataclass(frozen=True)
class NelderMead(Peer):
    """Moves a simplex downhill in log mass and log friction."""

    def _search(self, problem: Problem, seed: int) -> Searched:
        objective = Objective(problem, self.weighting, seed)
        minimize(objective.loss, objective.start, method="Nelder-Mead", options={"maxfev": self.iterations})
        return objective.searched("nelder_mead")


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
