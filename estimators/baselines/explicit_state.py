"""Explicit State, a baseline of the paper: gradient descent in mass and friction themselves."""

from __future__ import annotations

from dataclasses import dataclass

from estimators.baselines.base import GradientBaseline, SearchResult
from estimators.baselines.problem import Problem


@dataclass(frozen=True)
class ExplicitState(GradientBaseline):
    """Gradient descent on Eq. problem with respect to m and mu, without hidden states."""

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        return self._descend(problem, seed, lambda c: problem.loss(c.mass, c.friction, self.weighting))
