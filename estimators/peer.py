"""What methods made of other people's optimisers have in common: settings, and the loss as an optimiser wants it."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
import torch

from estimators.baseline import Baseline, Searched
from estimators.candidates import LogCoordinates
from estimators.prediction import Problem, Weighting

PEER_ITERATIONS = 5000
"""Losses evaluated at most: more than any of them takes on a block object before it stops by itself."""


@dataclass(frozen=True)
class Peer(Baseline):
    """Settings of every peer: the data that Algorithm 1 has, M among them, and its way of weighing errors.

    Peers differ in the optimiser alone, which keeps its authors' defaults and stops where they would.
    """

    iterations: int = PEER_ITERATIONS
    """Losses evaluated at most."""
    use_weight: bool = True
    """Whether M as weighed is given to the search."""
    weighting: Weighting = "covariance"
    """What the loss sums: squared velocity errors (Eq. problem), or wrench errors over their covariance, as ours."""


class Objective:
    """Of one point of log mass and log friction, from uniform mass: loss over that of the first guess, each kept."""

    def __init__(self, problem: Problem, weighting: Weighting, seed: int):
        self.coordinates = LogCoordinates.of(problem, seed)
        self._problem = problem
        self._weighting: Weighting = weighting
        self._begin = time.perf_counter()
        self._seen: list[tuple[np.ndarray, np.ndarray, float]] = []
        self._scale = 1.0
        self._scale = max(float(self.losses(self.start[None])[0]), 1e-300)
        self._seen.clear()

    @property
    def start(self) -> np.ndarray:
        """The first guess, (n,)."""
        return self.coordinates.start.numpy()

    def losses(self, points: np.ndarray) -> np.ndarray:
        """Of points, one a row, (S,)."""
        guessed = self.coordinates.candidates(torch.tensor(points))
        loss = self._problem.loss(guessed.mass, guessed.friction, self._weighting).numpy()
        self._seen.append((points, loss, time.perf_counter() - self._begin))
        return loss / self._scale

    def loss(self, point: np.ndarray) -> float:
        """Of one point, (n,)."""
        return float(self.losses(point[None])[0])

    def searched(self, method: str) -> Searched:
        """The best of what was evaluated."""
        batches = [
            (self.coordinates.candidates(torch.tensor(points)), torch.tensor(loss), at)
            for points, loss, at in self._seen
        ]
        return Searched.of_samples(method, batches)
