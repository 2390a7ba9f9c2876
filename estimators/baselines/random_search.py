"""Random Search, a baseline of the paper: independent draws of mass and friction."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from estimators.baselines.base import Baseline, SearchResult, from_unit
from estimators.baselines.problem import Problem


@dataclass(frozen=True)
class RandomSearch(Baseline):
    """Draws mass and friction `iterations` times and returns the draw with the least loss."""

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        begin = time.perf_counter()
        unit = np.random.default_rng(seed).uniform(size=(self.iterations, problem.shape.n_mu + problem.shape.n_m))
        drawn = from_unit(problem, unit)
        loss = problem.loss(drawn.mass, drawn.friction, self.weighting)
        return SearchResult.of_samples("random", [(drawn, loss, time.perf_counter() - begin)])
