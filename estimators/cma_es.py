"""CMA-ES on the explicit model: an evolving covariance (Hansen 2016), as the cmaes package has it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from cmaes import CMA

from estimators.baseline import Searched
from estimators.peer import Objective, Peer
from estimators.prediction import Problem
from estimators.published import FIRST_DEVIATION
from testbed.arrays import check_positive
from testbed.errors import InvalidValueError


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
