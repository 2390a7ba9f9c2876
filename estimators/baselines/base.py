"""Settings of the baselines in one place: the paper's where it gives them, ours where it is silent.

All search the masses and frictions that minimise Eq. problem on the same trials as Algorithm 1, with the same budget.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Estimate, EstimateStatus, Trace
from estimators.baselines.problem import Problem, Weighting
from estimators.descent import check_optimizers, descend
from estimators.hidden_states.friction import CONTRADICTORY
from estimators.particles.windows import robot_seconds
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_positive, is_number

ITERATIONS = 500
"""Gradient steps, or samples tried. Paper: 500 for every method."""
OPTIMIZERS = ("adam", "rmsprop", "plain")
"""Descents that are run; the lowest loss is reported. Paper: Adam, RMSProp and others, the best is picked."""
USE_WEIGHT = False
"""Whether M as weighed is given to a baseline. Paper: only its own method has it."""
LEARNING_RATE = 0.05
"""First step of Adam and RMSProp in log mass and log friction; it falls to zero as (1 - i / iterations)^2. Ours."""
FRICTION_RANGE = (0.05, 1.0)
"""Frictions that searches draw from, and descents start from: metal and wood on a table lie inside. Ours."""
LARGEST_SHARE = 2.0
"""Largest mass drawn, over the mean mass that explains the largest drag felt at the friction drawn. Ours."""
DENSEST = 7850.0
"""Without M none is drawn denser than steel, kg/m^3: Eq. problem divides by mass, and heavy guesses look good. Ours."""
GRID_PART = 0.25
"""Part of the samples of Weighted Sampling Search that go to its first grid. Ours."""
GENERATION = 15
"""Samples around the best one before the deviation falls. Ours."""
FIRST_DEVIATION = 0.5
"""First deviation of Weighted Sampling Search, as a part of the mean mass and of the friction. Ours."""
DEVIATION_DECAY = 0.85
"""Factor on the deviation after each generation. Ours; the paper finds the method sensitive to it."""
LCP_DIRECTIONS = 8
"""Corners of the friction polygon. Ours."""
LCP_SUBSTEPS = 2
"""Steps of the LCP engine in one of the record's. Paper: smaller than the record's, wrench interpolated linearly."""
LCP_SAMPLES = 1
"""States along a steady turn that Diff-LCP predicts from; a polygon feels each turned state differently. Ours."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """S guesses of mass and friction."""

    mass: Float[Tensor, "S n_m"]
    """Of a particle, kg."""
    friction: Float[Tensor, "S n_mu"]

    def __getitem__(self, index: Tensor | slice) -> Candidates:
        return Candidates(self.mass[index], self.friction[index])


def from_unit(problem: Problem, unit: Float[np.ndarray, "S n_mu+n_m"]) -> Candidates:
    """Points of the unit cube as candidates: frictions first, then each group's share of the typical mass."""
    low, high = FRICTION_RANGE
    n_mu = problem.shape.n_mu
    friction = low + (high - low) * torch.tensor(unit[:, :n_mu])
    largest = (LARGEST_SHARE * problem.typical_mass(friction.mean(-1))).clamp(max=densest(problem))
    return weighed(problem, Candidates(torch.tensor(unit[:, n_mu:]) * largest[:, None], friction))


def densest(problem: Problem) -> float:
    """Mass of a particle of the densest material that is drawn, kg; where M is known, M alone bounds it."""
    if problem.weight is not None:
        return math.inf
    return DENSEST * problem.shape.cell**2 * problem.shape.height


def weighed(problem: Problem, guesses: Candidates) -> Candidates:
    """The guesses, their masses scaled to M where M is known."""
    if problem.weight is None:
        return guesses
    total = (guesses.mass @ problem.per_group)[:, None]
    even = torch.full_like(guesses.mass, problem.weight / len(problem.shape.particles))
    mass = torch.where(total > 0, guesses.mass * problem.weight / total.clamp(min=1e-300), even)
    return Candidates(mass, guesses.friction)


@dataclass(frozen=True, eq=False)
class LogCoordinates:
    """Positive by parametrisation: logarithms of mass and friction, over those of a first guess."""

    problem: Problem
    first_friction: float
    """Friction to start from; the mass to start from is uniform, as in Algorithm 1."""

    @staticmethod
    def of(problem: Problem, seed: int) -> LogCoordinates:
        """About uniform mass.

        With M known the first friction is the largest drag over the weight, as in our method; without, `seed` draws it,
        and it decides.
        """
        first = float(np.random.default_rng(seed).uniform(*FRICTION_RANGE))
        if problem.weight is not None:
            first = problem.drag / (problem.weight * GRAVITY)
        return LogCoordinates(problem, first)

    @property
    def start(self) -> Float[Tensor, "n"]:
        """The first guess."""
        return torch.zeros(self.problem.shape.n_mu + self.problem.shape.n_m, dtype=torch.float64)

    def candidates(self, z: Float[Tensor, "S n"]) -> Candidates:
        """Mass and friction at points; with M known the masses are a softmax of it."""
        n_mu = self.problem.shape.n_mu
        friction = self.first_friction * z[:, :n_mu].exp()
        typical = self.problem.typical_mass(torch.tensor(self.first_friction, dtype=torch.float64))
        return weighed(self.problem, Candidates(typical * z[:, n_mu:].exp(), friction))


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
