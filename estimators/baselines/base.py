"""The frame of every baseline: settings, candidates of mass and friction, and the result of a search.

All minimise Eq. problem over masses and frictions on the trials that Algorithm 1 gets, with the same budget. A default
is the paper's where the paper gives a value; the others are marked as ours.
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
from estimators.descent import OPTIMIZERS, check_optimizers, descend
from estimators.hidden_states.friction import CONTRADICTORY
from estimators.particles.support import ASSUMPTION
from estimators.particles.windows import robot_seconds
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer, check_positive, is_number

ITERATIONS = 500
"""Gradient steps, or samples drawn. Paper: 500 for every method."""
FRICTION_RANGE = (0.05, 1.0)
"""Frictions that searches draw from and descents start from: metal and wood on a table lie inside. Ours."""
LARGEST_SHARE = 2.0
"""Largest mass drawn over the mean mass that explains the largest measured drag at the friction drawn. Ours."""
DENSEST = 7850.0
"""Density of steel [kg/m^3], the largest drawn without M: dividing by mass, Eq. problem favors heavy guesses. Ours."""
FIRST_DEVIATION = 0.5
"""First deviation of a Gaussian search. Ours."""


@dataclass(frozen=True, eq=False)
class Candidates:
    """S guesses of mass and friction."""

    mass: Float[Tensor, "S n_m"]
    """Particle mass of each group [kg]."""
    friction: Float[Tensor, "S n_mu"]

    def __getitem__(self, index: Tensor | slice) -> Candidates:
        return Candidates(self.mass[index], self.friction[index])


def from_unit(problem: Problem, unit: Float[np.ndarray, "S n_mu+n_m"]) -> Candidates:
    """Candidates at points of the unit cube: frictions first, then each group's share of the typical mass."""
    low, high = FRICTION_RANGE
    n_mu = problem.shape.n_mu
    friction = low + (high - low) * torch.tensor(unit[:, :n_mu])
    largest = (LARGEST_SHARE * problem.typical_mass(friction.mean(-1))).clamp(max=heaviest(problem))
    return scaled(problem, Candidates(torch.tensor(unit[:, n_mu:]) * largest[:, None], friction))


def heaviest(problem: Problem) -> float:
    """Largest particle mass that is drawn [kg]: one of steel; infinite where M is known and bounds it."""
    return math.inf if problem.weight is not None else DENSEST * problem.shape.cell**2 * problem.shape.height


def scaled(problem: Problem, guesses: Candidates) -> Candidates:
    """The guesses with their masses scaled to M, if M is known."""
    if problem.weight is None:
        return guesses
    total = (guesses.mass @ problem.per_group)[:, None]
    even = torch.full_like(guesses.mass, problem.weight / len(problem.shape.particles))
    mass = torch.where(total > 0, guesses.mass * problem.weight / total.clamp(min=1e-300), even)
    return Candidates(mass, guesses.friction)


@dataclass(frozen=True, eq=False)
class LogCoordinates:
    """Logarithms of mass and friction relative to a first guess, so that both stay positive."""

    problem: Problem
    first_friction: float
    """Friction of the first guess; its mass is uniform, as in Algorithm 1."""

    @staticmethod
    def of(problem: Problem, seed: int) -> LogCoordinates:
        """Coordinates about uniform mass.

        With M known the first friction is the largest drag over the weight, as in our method. Without M, `seed` draws
        it, and it decides the result.
        """
        first = float(np.random.default_rng(seed).uniform(*FRICTION_RANGE))
        if problem.weight is not None:
            first = problem.windows.drag / (problem.weight * GRAVITY)
        return LogCoordinates(problem, first)

    @property
    def start(self) -> Float[Tensor, "n"]:
        """Coordinates of the first guess."""
        return torch.zeros(self.problem.shape.n_mu + self.problem.shape.n_m, dtype=torch.float64)

    def candidates(self, z: Float[Tensor, "S n"]) -> Candidates:
        """Mass and friction at S points; with M known the masses are a softmax of it."""
        n_mu = self.problem.shape.n_mu
        friction = self.first_friction * z[:, :n_mu].exp()
        typical = self.problem.typical_mass(torch.tensor(self.first_friction, dtype=torch.float64))
        return scaled(self.problem, Candidates(typical * z[:, n_mu:].exp(), friction))


@dataclass(frozen=True, eq=False)
class SearchResult:
    """The best candidate of a search, and the way to it."""

    mass: Float[np.ndarray, "n_m"]
    """Particle mass of each group [kg]."""
    friction: Float[np.ndarray, "n_mu"]
    loss: float
    traces: tuple[Trace, ...]
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Covariance of `mass` [kg^2], if the search gives one."""
    misfit: float | None = None
    """Misfit by the search's own model, if that is not `Problem`'s."""
    rollouts: int | None = None
    """Number of guesses compared with all data, if the traces do not have one entry each."""

    @staticmethod
    def of_samples(method: str, batches: Sequence[tuple[Candidates, Tensor, float]]) -> SearchResult:
        """The best of all samples; the trace is the best so far, sample by sample.

        Args:
            method: name for the trace.
            batches: candidates, their losses, and the time [s] at which they were done.
        """
        mass = torch.cat([c.mass for c, _, _ in batches]).numpy()
        friction = torch.cat([c.friction for c, _, _ in batches]).numpy()
        loss = torch.cat([values for _, values, _ in batches]).numpy()
        so_far = np.minimum.accumulate(loss)
        which = np.maximum.accumulate(np.where(loss <= so_far, np.arange(len(loss)), 0))
        seconds = np.concatenate([np.full(len(values), at) for _, values, at in batches])
        trace = Trace(method, tuple(so_far.tolist()), tuple(seconds.tolist()), 0.0, mass[which])
        best = int(loss.argmin())
        return SearchResult(mass[best], friction[best], float(loss[best]), (trace,))


@dataclass(frozen=True)
class Baseline(ABC):
    """Settings of every baseline. Assumes, as Algorithm 1 does, that every mass group rests on its own weight."""

    iterations: int = ITERATIONS
    """Samples drawn, or gradient steps of each optimizer."""
    use_weight: bool = False
    """True gives the search M as weighed. Paper: only its own method has it."""
    weighting: Weighting = "velocity"
    """Terms of the loss: squared velocity errors (Eq. problem), or wrench errors over their covariance, as ours."""
    pivot_error: float = 2e-4
    """Standard error of a turn's center [m]."""

    def __post_init__(self) -> None:
        name = type(self).__name__
        check_integer(f"{name}.iterations", self.iterations)
        if not isinstance(self.use_weight, bool):
            raise InvalidValueError(f"{name}.use_weight", self.use_weight, "true or false")
        if self.weighting not in get_args(Weighting):
            raise InvalidValueError(f"{name}.weighting", self.weighting, f"one of {', '.join(get_args(Weighting))}")
        if not (is_number(self.pivot_error) and self.pivot_error >= 0):
            raise InvalidValueError(f"{name}.pivot_error", self.pivot_error, "a finite number >= 0")

    @abstractmethod
    def _search(self, problem: Problem, seed: int) -> SearchResult:
        """The best candidate that the method finds; `seed` determines its draws."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Reduce the trajectories, search, and judge the result.

        Diagnostics: "misfit" is the mean squared wrench error over its covariance, about 1 or less where the answer
        explains the measurements; "rollouts" is the number of guesses compared with all data.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        begin = time.perf_counter()
        problem = Problem.of(shape, weight, trajectories, use_weight=self.use_weight, pivot_error=self.pivot_error)
        if isinstance(problem, Estimate):
            return replace(problem, seconds=time.perf_counter() - begin)
        found = self._search(problem, seed)
        # Eq. problem divides by mass, so a heavy answer hides data that contradict each other; the misfit does not
        misfit = found.misfit
        if misfit is None:
            misfit = float(problem.loss(torch.tensor(found.mass), torch.tensor(found.friction), "covariance"))
        rollouts = found.rollouts or sum(len(trace.loss) for trace in found.traces)
        cost = robot_seconds(trajectories)
        status: EstimateStatus = "ok"
        why = ""
        if not problem.scale_known:
            status, why = "underdetermined", "without M or an accelerated turn only mass times friction is observable"
        elif misfit > CONTRADICTORY:
            status = "not_converged"
            why = f"the best candidate misses the measured wrenches by {misfit:.0f} mean squared errors: the search is "
            why += "too short, or the trajectories contradict each other"
        return Estimate(
            MassDistribution(found.mass, found.friction),
            status,
            why,
            found.covariance,
            traces=tuple(replace(trace, robot_seconds=cost) for trace in found.traces),
            seconds=time.perf_counter() - begin,
            diagnostics={"loss": found.loss, "misfit": misfit, "rollouts": float(rollouts)},
            assumes=ASSUMPTION[self._support],
        )

    @property
    def _support(self) -> str:
        """Support that the method assumes."""
        return "own_weight"


@dataclass(frozen=True)
class GradientBaseline(Baseline):
    """Settings of the baselines that descend."""

    optimizers: tuple[str, ...] = OPTIMIZERS
    """Optimizers to descend with; the lowest loss wins. Paper: Adam, RMSProp and others, the best is picked."""
    learning_rate: float = 0.05
    """First step of Adam and RMSProp in log mass and log friction; falls to zero as (1 - i / iterations)^2. Ours."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_optimizers(type(self).__name__, self.optimizers)
        check_positive(f"{type(self).__name__}.learning_rate", self.learning_rate)

    def _descend(self, problem: Problem, seed: int, loss: Callable[[Candidates], Tensor]) -> SearchResult:
        """Descend from uniform mass; without M, `seed` draws the friction to start from."""
        coordinates = LogCoordinates.of(problem, seed)
        with torch.no_grad():
            scale = max(float(loss(coordinates.candidates(coordinates.start[None]))[0]), 1e-300)
        runs = descend(
            lambda z: loss(coordinates.candidates(z)) / scale,
            coordinates.start,
            dict.fromkeys(self.optimizers, self.learning_rate),
            self.iterations,
            masses=lambda z: coordinates.candidates(z).mass,
        )
        best = coordinates.candidates(runs[0].best[None])
        return SearchResult(
            best.mass[0].numpy(),
            best.friction[0].numpy(),
            min(runs[0].trace.loss) * scale,
            tuple(replace(run.trace, loss=tuple(scale * v for v in run.trace.loss)) for run in runs),
        )


@dataclass(frozen=True)
class Peer(Baseline):
    """Settings of the field's general optimizers, on Algorithm 1's data, M included, and its weighting of errors.

    Peers differ in the optimizer alone, which keeps its authors' defaults and stops where they would.
    """

    iterations: int = 5000
    """Losses evaluated at most: more than any peer takes on a block object before it stops by itself."""
    use_weight: bool = True
    """True gives the search M as weighed."""
    weighting: Weighting = "covariance"
    """Terms of the loss: squared velocity errors (Eq. problem), or wrench errors over their covariance, as ours."""
