"""Explicit State, a baseline of the paper: the same dynamics, descended in mass and friction themselves."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.baselines.base import GradientBaseline, Searched
from estimators.baselines.problem import Problem


@dataclass(frozen=True)
class ExplicitState(GradientBaseline):
    """Gradient descent on Eq. problem with respect to m and mu, without hidden states."""

    def _search(self, problem: Problem, seed: int) -> Searched:
        """From uniform mass; without M, `seed` draws the friction to start from."""
        return self._descend(problem, seed, lambda c: problem.loss(c.mass, c.friction, self.weighting))
