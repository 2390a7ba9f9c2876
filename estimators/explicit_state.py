"""Explicit State, a baseline of the paper: the same dynamics, descended in mass and friction themselves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from estimators.baseline import GradientBaseline
from estimators.protocol import Estimate
from testbed.objects import ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class ExplicitState(GradientBaseline):
    """Gradient descent on Eq. problem with respect to m and mu, without hidden states."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate by descent; `seed` draws the friction to start from.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        return self._answer(
            shape,
            weight,
            trajectories,
            lambda problem: self._descend(problem, seed, lambda c: problem.loss(c.mass, c.friction, self.weighting)),
        )
