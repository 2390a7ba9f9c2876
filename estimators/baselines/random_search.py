"""Random Search, a baseline of the paper: draw masses and frictions, keep the one that predicts best."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from estimators.baselines.base import Baseline, Searched, from_unit
from estimators.baselines.problem import Problem


@dataclass(frozen=True)
class RandomSearch(Baseline):
    """Draws mass and friction `iterations` times, independently, and returns the draw with the least loss."""

    def _search(self, problem: Problem, seed: int) -> Searched:
        begin = time.perf_counter()
        rng = np.random.default_rng(seed)
        unit = rng.uniform(size=(self.iterations, problem.shape.n_mu + problem.shape.n_m))
        drawn = from_unit(problem, unit)
        loss = problem.loss(drawn.mass, drawn.friction, self.weighting)
        return Searched.of_samples("random", [(drawn, loss, time.perf_counter() - begin)])
