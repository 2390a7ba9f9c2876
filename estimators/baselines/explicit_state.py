"""Explicit State, a baseline of the paper: gradient descent in mass and friction themselves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import ClassVar

from torch import Tensor

from estimators.baselines.base import Candidates, GradientBaseline
from estimators.baselines.problem import Problem


@dataclass(frozen=True)
class ExplicitState(GradientBaseline):
    """Gradient descent on Eq. problem with respect to m and mu, without hidden states."""

    takes_links: ClassVar[bool] = False
    """It moves the object in one piece."""

    def _loss(self, problems: Sequence[Problem]) -> Callable[[Candidates], Tensor]:
        together = Problem.stacked(problems)
        return lambda c: together.loss(c.mass, c.friction, self.weighting)
