"""Random Search, a baseline of the paper: draw masses and frictions, keep the one that predicts best."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from estimators.baseline import Baseline, Searched
from estimators.candidates import from_unit
from estimators.prediction import Problem
from estimators.protocol import Estimate
from testbed.objects import ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class RandomSearch(Baseline):
    """Draws mass and friction `iterations` times, independently, and returns the draw with the least loss."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate by drawing.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        return self._answer(shape, weight, trajectories, lambda problem: self._search(problem, seed))

    def _search(self, problem: Problem, seed: int) -> Searched:
        begin = time.perf_counter()
        rng = np.random.default_rng(seed)
        unit = rng.uniform(size=(self.iterations, problem.shape.n_mu + problem.shape.n_m))
        drawn = from_unit(problem, unit)
        loss = problem.loss(drawn.mass, drawn.friction, self.weighting)
        return Searched.of_samples("random", problem, [(drawn, loss, time.perf_counter() - begin)])
