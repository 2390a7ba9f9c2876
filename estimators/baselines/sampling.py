"""Random Search and Weighted Sampling Search, baselines of the paper that draw masses and frictions."""

from __future__ import annotations

import itertools
import time
from dataclasses import dataclass

import numpy as np
import torch

from estimators.baselines.base import FIRST_DEVIATION, Baseline, Candidates, SearchResult, from_unit, heaviest, scaled
from estimators.baselines.problem import Problem
from testbed.errors import InvalidValueError
from testbed.validation import check_integer, check_positive_fields


@dataclass(frozen=True)
class RandomSearch(Baseline):
    """Draws mass and friction `iterations` times and returns the draw with the least loss."""

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        begin = time.perf_counter()
        unit = np.random.default_rng(seed).uniform(size=(self.iterations, problem.shape.n_mu + problem.shape.n_m))
        drawn = from_unit(problem, unit)
        loss = problem.loss(drawn.mass, drawn.friction, self.weighting)
        return SearchResult.of_samples("random", [(drawn, loss, time.perf_counter() - begin)])


@dataclass(frozen=True)
class WeightedSampling(Baseline):
    """Starts on a grid, then draws generations from a Gaussian around the best so far, with falling deviation."""

    grid_part: float = 0.25
    """Largest part of the samples spent on a grid finer than two levels a side. Ours."""
    generation: int = 15
    """Samples a generation. Ours."""
    first_deviation: float = FIRST_DEVIATION
    """First deviation, as a part of the best sample's mean mass and friction."""
    decay: float = 0.85
    """Factor on the deviation after each generation. Ours; the paper finds the method sensitive to it."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_positive_fields(self, "grid_part", "decay", "first_deviation")
        for name, value in (("grid_part", self.grid_part), ("decay", self.decay)):
            if value > 1:
                raise InvalidValueError(f"WeightedSampling.{name}", value, "a number > 0 and <= 1")
        check_integer("WeightedSampling.generation", self.generation)

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        begin = time.perf_counter()
        rng = np.random.default_rng(seed)
        batches = []
        best, lowest, left, deviation = None, np.inf, self.iterations, self.first_deviation
        sides = problem.shape.n_mu + problem.shape.n_m
        guesses = from_unit(problem, _grid(sides, problem.shape.n_mu, self.iterations, self.grid_part))
        while left > 0:
            guesses = guesses[:left]
            loss = problem.loss(guesses.mass, guesses.friction, self.weighting)
            batches.append((guesses, loss, time.perf_counter() - begin))
            left -= len(loss)
            if float(loss.min()) < lowest or best is None:
                lowest, best = float(loss.min()), guesses[loss.argmin()[None]]
            guesses = _around(problem, best, deviation, self.generation, rng)
            deviation *= self.decay
        return SearchResult.of_samples("weighted sampling", batches)


def _grid(sides: int, n_mu: int, budget: int, part: float) -> np.ndarray:
    """A full grid over the unit cube of frictions and masses: two levels a side, or more in `part` of the budget.

    If not even two levels a side fit in the whole budget, all masses are alike, and `part` of it spans friction and
    their common size.
    """
    alike = 2**sides > budget
    free = 2 if alike else sides
    least = 1 if alike else 2
    levels = max(int((part * budget) ** (1 / free) + 1e-9), least)
    axis = (np.arange(levels) + 0.5) / levels
    points = np.array(list(itertools.product(axis, repeat=free)))
    return points[:, [0] * n_mu + [1] * (sides - n_mu)] if alike else points


def _around(problem: Problem, best: Candidates, deviation: float, count: int, rng: np.random.Generator) -> Candidates:
    """Gaussian draws around the best; negative values are reflected."""
    mass = best.mass + deviation * best.mass.mean() * torch.tensor(rng.standard_normal((count, problem.shape.n_m)))
    friction = best.friction * (1 + deviation * torch.tensor(rng.standard_normal((count, problem.shape.n_mu))))
    guesses = Candidates(mass.abs().clamp(max=heaviest(problem)), friction.abs())
    return scaled(guesses, problem.per_group, problem.weight)
