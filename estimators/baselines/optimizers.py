"""General optimizers on the explicit model: CMA-ES, Nelder-Mead and nonlinear least squares, with their defaults."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace

import numpy as np
import torch
from cmaes import CMA
from scipy.optimize import least_squares, minimize

from estimators.baselines.base import FIRST_DEVIATION, LogCoordinates, Peer, SearchResult
from estimators.baselines.problem import Problem, Weighting
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution
from testbed.validation import check_positive

RESTART = 0.01
"""Least relative fall of the loss by a simplex after which another one starts. Ours."""


class Objective:
    """Loss over that of the first guess, as a function of log mass and log friction; keeps every evaluation."""

    def __init__(self, problem: Problem, weighting: Weighting, seed: int):
        self.coordinates = LogCoordinates.of(problem, seed)
        self.start = self.coordinates.start.numpy()
        self._problem = problem
        self._weighting: Weighting = weighting
        self._begin = time.perf_counter()
        self._evaluated: list[tuple[np.ndarray, np.ndarray, float]] = []
        self._scale = 1.0
        self._scale = max(self.loss(self.start), 1e-300)
        self._evaluated.clear()

    def losses(self, points: np.ndarray) -> np.ndarray:
        """Losses of S points (S, n), shape (S,)."""
        guessed = self.coordinates.candidates(torch.tensor(points))
        loss = self._problem.loss(guessed.mass, guessed.friction, self._weighting).numpy()
        self._evaluated.append((points, loss, time.perf_counter() - self._begin))
        return loss / self._scale

    def loss(self, point: np.ndarray) -> float:
        """Loss of one point (n,)."""
        return float(self.losses(point[None])[0])

    def result(self, method: str) -> SearchResult:
        """The best of all evaluations."""
        batches = [
            (self.coordinates.candidates(torch.tensor(points)), torch.tensor(loss), at)
            for points, loss, at in self._evaluated
        ]
        return SearchResult.of_samples(method, batches)


@dataclass(frozen=True)
class CmaEs(Peer):
    """Evolving Gaussian in log mass and log friction (Hansen 2016): its covariance learns from the best of each draw.

    All but the first deviation is the default of the cmaes package.
    """

    first_deviation: float = FIRST_DEVIATION
    """First deviation of log mass and log friction; the package has no default."""
    population: int = 0
    """Samples a generation; 0 is the package's 4 + 3 ln(n)."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive("CmaEs.first_deviation", self.first_deviation)
        whole = isinstance(self.population, int) and not isinstance(self.population, bool)
        if not (whole and (self.population == 0 or self.population >= 5)):
            raise InvalidValueError("CmaEs.population", self.population, "0, or an integer >= 5")

    def _search(self, problem: Problem, seed: int) -> SearchResult:
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
        return objective.result("cma_es")


@dataclass(frozen=True)
class NelderMead(Peer):
    """Downhill simplex in log mass and log friction, restarted at its end point while that lowers the loss.

    A simplex may collapse off the minimum (Kelley 1999); a new one has the scipy default size.
    """

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        objective = Objective(problem, self.weighting, seed)
        point, least, left, gained = objective.start, 1.0, self.iterations, True  # the first guess has a loss of 1
        while gained and left > 0:
            found = minimize(objective.loss, point, method="Nelder-Mead", options={"maxfev": left})
            gained, left = found.fun < (1 - RESTART) * least, left - found.nfev
            point, least = found.x, found.fun
        return objective.result("nelder_mead")


@dataclass(frozen=True)
class LeastSquares(Peer):
    """Fit of all wrenches at once in log mass and log friction, with difference quotients for slopes.

    Weighted by covariance it has the covariance of its answer, from the slopes there.
    """

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        objective = Objective(problem, self.weighting, seed)

        def residuals(point: np.ndarray) -> np.ndarray:
            objective.losses(point[None])
            guess = objective.coordinates.candidates(torch.tensor(point[None]))
            return problem.residuals(guess.mass[0], guess.friction[0], self.weighting).numpy()

        steps = self.iterations // (len(objective.start) + 1)  # one difference along every direction
        least_squares(residuals, objective.start, max_nfev=max(steps, 1))
        found = objective.result("least_squares")
        if self.weighting != "covariance":
            return found
        return replace(found, report=problem.report(MassDistribution(found.mass, found.friction)))
