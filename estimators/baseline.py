"""What the paper's baselines have in common: settings, the way in, and the way out."""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import torch
from torch import Tensor

from estimators.candidates import Candidates, LogCoordinates
from estimators.descent import check_optimizers, descend
from estimators.friction_loads import CONTRADICTORY
from estimators.observations import robot_seconds
from estimators.prediction import Problem, Weighting
from estimators.protocol import Estimate, EstimateStatus, Trace
from estimators.published import ITERATIONS, LEARNING_RATE, OPTIMIZERS, USE_WEIGHT
from testbed.arrays import check_positive, is_number
from testbed.errors import InvalidValueError
from testbed.objects import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Searched:
    """What a search found."""

    mass: np.ndarray
    """Of a particle of each group, kg, (n_m,)."""
    friction: np.ndarray
    """(n_mu,)."""
    loss: float
    traces: tuple[Trace, ...]
    covariance: np.ndarray | None = None
    """Of `mass`, kg^2, where the search gives one."""
    misfit: float | None = None
    """By the model that was searched, where that is not `Problem`'s."""
    rollouts: int | None = None
    """Guesses held against all data, where the traces do not have one each."""

    @staticmethod
    def of_samples(method: str, batches: Sequence[tuple[Candidates, Tensor, float]]) -> Searched:
        """The best of all samples; its trace is the best so far, sample by sample.

        Args:
            method: name for the trace.
            batches: candidates, their losses, and the time when they were done, s.
        """
        mass = torch.cat([c.mass for c, _, _ in batches]).numpy()
        friction = torch.cat([c.friction for c, _, _ in batches]).numpy()
        loss = torch.cat([values for _, values, _ in batches]).numpy()
        so_far = np.minimum.accumulate(loss)
        which = np.maximum.accumulate(np.where(loss <= so_far, np.arange(len(loss)), 0))
        seconds = np.concatenate([np.full(len(values), at) for _, values, at in batches])
        trace = Trace(method, tuple(so_far.tolist()), tuple(seconds.tolist()), 0.0, mass[which])
        best = int(loss.argmin())
        return Searched(mass[best], friction[best], float(loss[best]), (trace,))


@dataclass(frozen=True)
class Baseline(ABC):
    """Settings of every baseline. Assumes, as Algorithm 1 does, that every mass group rests on its own weight."""

    iterations: int = ITERATIONS
    """Samples tried, or gradient steps of each optimiser."""
    use_weight: bool = USE_WEIGHT
    """Whether M as weighed is given to the search; as published it is not."""
    weighting: Weighting = "velocity"
    """What the loss sums: squared velocity errors (Eq. problem), or wrench errors over their covariance, as ours."""
    pivot_error: float = 2e-4
    """How well the centre of a turn is known, m."""

    def __post_init__(self) -> None:
        name = type(self).__name__
        if isinstance(self.iterations, bool) or not (isinstance(self.iterations, int) and self.iterations >= 1):
            raise InvalidValueError(f"{name}.iterations", self.iterations, "an integer >= 1")
        if not isinstance(self.use_weight, bool):
            raise InvalidValueError(f"{name}.use_weight", self.use_weight, "true or false")
        if self.weighting not in get_args(Weighting):
            raise InvalidValueError(f"{name}.weighting", self.weighting, f"one of {', '.join(get_args(Weighting))}")
        if not (is_number(self.pivot_error) and self.pivot_error >= 0):
            raise InvalidValueError(f"{name}.pivot_error", self.pivot_error, "a finite number >= 0")

    @abstractmethod
    def _search(self, problem: Problem, seed: int) -> Searched:
        """The best that the method finds; `seed` for what it draws."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Reduce the trajectories, search, and say what came of it.

        "misfit" in the diagnostics is the mean squared wrench error over its covariance, about 1 or less where the
        answer explains what was felt; "rollouts" is how many guesses were held against all data.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        begin = time.perf_counter()
        problem = Problem.of(shape, weight, trajectories, use_weight=self.use_weight, pivot_error=self.pivot_error)
        if isinstance(problem, Estimate):
            return replace(problem, seconds=time.perf_counter() - begin)
        found = self._search(problem, seed)
        # Eq. problem divides by mass, so that a heavy answer hides data that contradict each other: this does not
        misfit = found.misfit
        if misfit is None:
            misfit = float(problem.loss(torch.tensor(found.mass), torch.tensor(found.friction), "covariance"))
        rollouts = found.rollouts or sum(len(trace.loss) for trace in found.traces)
        cost = robot_seconds(trajectories)
        status: EstimateStatus = "ok"
        why = ""
        if not problem.scale_known:
            status, why = "underdetermined", "without M or an accelerated turn only mass times friction is felt"
        elif misfit > CONTRADICTORY:
            status = "not_converged"
            why = f"the best found misses what was felt by {misfit:.0f} mean squared errors: too short a search, or "
            why += "trajectories that contradict each other"
        return Estimate(
            MassDistribution(found.mass, found.friction),
            status,
            why,
            found.covariance,
            traces=tuple(replace(trace, robot_seconds=cost) for trace in found.traces),
            seconds=time.perf_counter() - begin,
            diagnostics={"loss": found.loss, "misfit": misfit, "rollouts": float(rollouts)},
        )


@dataclass(frozen=True)
class GradientBaseline(Baseline):
    """Settings of the baselines that descend."""

    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimisers to descend with; the one with the lowest loss is taken."""
    learning_rate: float = LEARNING_RATE
    """First step of Adam and RMSProp, in log mass and log friction."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_optimizers(type(self).__name__, self.optimizers)
        check_positive(f"{type(self).__name__}.learning_rate", self.learning_rate)

    def _descend(self, problem: Problem, seed: int, loss: Callable[[Candidates], Tensor]) -> Searched:
        """Descend from uniform mass; without M, `seed` draws the friction to start from."""
        coordinates = LogCoordinates.of(problem, seed)
        with torch.no_grad():
            scale = float(loss(coordinates.candidates(coordinates.start[None]))[0])
        scale = max(scale, 1e-300)
        runs = descend(
            lambda z: loss(coordinates.candidates(z)) / scale,
            coordinates.start,
            dict.fromkeys(self.optimizers, self.learning_rate),
            self.iterations,
            masses=lambda z: coordinates.candidates(z).mass,
        )
        best = coordinates.candidates(runs[0].best[None])
        return Searched(
            best.mass[0].numpy(),
            best.friction[0].numpy(),
            min(runs[0].trace.loss) * scale,
            tuple(replace(run.trace, loss=tuple(scale * v for v in run.trace.loss)) for run in runs),
        )
