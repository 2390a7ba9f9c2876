"""Base classes of the baselines: settings, candidates of mass and friction, and the result of a search.

All minimise Eq. problem over masses and frictions on the trials that Algorithm 1 gets, with the same budget. A default
is the paper's where the paper gives a value; the others are marked as ours.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any, ClassVar, get_args

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import MOST_MASS, Estimate, Trace, robot_seconds
from estimators.baselines.problem import FAR_OFF, Problem, Weighting
from estimators.descent import OPTIMIZERS, check_optimizers, descend_all
from estimators.evaluation.judged import misfit_on
from estimators.identifiability.report import Identifiability, hardly_known
from estimators.particles.misfit import Misfit
from estimators.wrench.model import ModelErrors
from estimators.wrench.support import ASSUMPTION, ERRORS, SupportModel
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
    guesses = Candidates(torch.tensor(unit[:, n_mu:]) * largest[:, None], friction)
    return scaled(guesses, problem.per_group, problem.weight)


def heaviest(problem: Problem) -> float:
    """Largest particle mass that is drawn [kg]: that of steel; infinite where M is known."""
    return math.inf if problem.weight is not None else DENSEST * problem.shape.cell**2 * problem.shape.height


def scaled(
    guesses: Candidates, per_group: Float[Tensor, "n_m"], weight: float | Float[Tensor, "D 1 1"] | None
) -> Candidates:
    """The guesses with their masses scaled to M, if M is known."""
    if weight is None:
        return guesses
    total = (guesses.mass @ per_group)[..., None]
    mass = torch.where(total > 0, guesses.mass * weight / total.clamp(min=1e-300), weight / per_group.sum())
    return Candidates(mass, guesses.friction)


@dataclass(frozen=True, eq=False)
class LogCoordinates:
    """Logarithms of mass and friction relative to a first guess, so that both stay positive."""

    first_mass: Float[Tensor, "*D_1 n_m"]
    """Particle masses of the first guess [kg], uniform as in Algorithm 1."""
    first_friction: Float[Tensor, "*D_1 n_mu"]
    """Friction of the first guess."""
    per_group: Float[Tensor, "n_m"]
    """Number of particles in each mass group."""
    weight: float | Float[Tensor, "D 1 1"] | None
    """M [kg], or None if the search is not given M."""

    @staticmethod
    def of(problem: Problem, seed: int) -> LogCoordinates:
        """Coordinates about uniform mass.

        With M known the first friction is the largest drag over the weight, as in our method. Without M, `seed` draws
        it, and it decides the result.
        """
        first = float(np.random.default_rng(seed).uniform(*FRICTION_RANGE))
        if problem.weight is not None:
            first = problem.windows.drag / (problem.weight * GRAVITY)
        friction = torch.full((problem.shape.n_mu,), first, dtype=torch.float64)
        mass = problem.typical_mass(friction[:1]).expand(problem.shape.n_m)
        return LogCoordinates(mass, friction, problem.per_group, problem.weight)

    @staticmethod
    def stacked(draws: Sequence[LogCoordinates]) -> LogCoordinates:
        """Coordinates of D draws of one object, for points (D, S, n)."""
        mass, friction = (torch.stack([getattr(d, part) for d in draws]) for part in ("first_mass", "first_friction"))
        known = [draw.weight for draw in draws if draw.weight is not None]
        weight = torch.tensor(known, dtype=torch.float64)[:, None, None] if known else None
        return LogCoordinates(mass[:, None], friction[:, None], draws[0].per_group, weight)

    @property
    def start(self) -> Float[Tensor, "n"]:
        """Coordinates of the first guess."""
        return torch.zeros(self.first_friction.shape[-1] + self.first_mass.shape[-1], dtype=torch.float64)

    def candidates(self, z: Float[Tensor, "... n"]) -> Candidates:
        """Mass and friction at points; with M known the masses are a softmax of it."""
        n_mu = self.first_friction.shape[-1]
        guesses = Candidates(self.first_mass * z[..., n_mu:].exp(), self.first_friction * z[..., :n_mu].exp())
        return scaled(guesses, self.per_group, self.weight)


@dataclass(frozen=True, eq=False)
class SearchResult:
    """Best candidate of a search, and its traces."""

    mass: Float[np.ndarray, "n_m"]
    """Particle mass of each group [kg]."""
    friction: Float[np.ndarray, "n_mu"]
    loss: float
    traces: tuple[Trace, ...]
    report: Identifiability | None = None
    """Masses and frictions that the trials show at the answer, if the search has errors."""
    misfit: Misfit | None = None
    """Misfit by the search's own model of the trials, if that is not heft's."""
    rollouts: int | None = None
    """Number of guesses compared with all data; None if the traces have one entry for each."""

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

    takes_links: ClassVar[bool] = True
    """False for a method whose object is a single rigid body."""
    iterations: int = ITERATIONS
    """Samples drawn, or gradient steps of each optimizer."""
    use_weight: bool = False
    """True gives the search M as weighed. Paper: only its own method has it."""
    weighting: Weighting = "velocity"
    """Terms of the loss: squared velocity errors (Eq. problem), or wrench errors over their covariance, as ours."""
    pivot_error: float = ModelErrors.pivot_error
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

        Diagnostics: "misfit" of `misfit_on` or the search's own model; "rollouts", guesses compared with all data.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        begin, problem = time.perf_counter(), self._problem(shape, weight, trajectories)
        if not isinstance(problem, Estimate):
            problem = self._judged(problem, self._search(problem, seed), weight, trajectories)
        return replace(problem, seconds=time.perf_counter() - begin)

    def _problem(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory]
    ) -> Problem | Estimate:
        """The problem, under the errors of the model that all methods share."""
        given = {"errors": self._errors, "support": self._support}
        return Problem.of(shape, weight, trajectories, self.takes_links, use_weight=self.use_weight, **given)

    def _judged(
        self, problem: Problem, found: SearchResult, weight: float | None, trajectories: Sequence[Trajectory]
    ) -> Estimate:
        """The estimate of a search, less its time; `weight` is M as weighed, whether or not the search had it.

        A descent without M may diverge: masses beyond `MOST_MASS` are set to it, and frictions that are no numbers to
        the largest that is drawn.
        """
        friction = np.where(np.isfinite(found.friction), found.friction, FRICTION_RANGE[1])
        found = replace(found, mass=np.where(found.mass <= MOST_MASS, found.mass, MOST_MASS), friction=friction)
        at, count = MassDistribution(found.mass, found.friction), problem.shape.particles_per_group
        misfit = found.misfit or misfit_on(self._support, problem.shape, weight, trajectories, at, self._errors)
        assert misfit is not None
        left = math.sqrt(problem.unexplained(torch.tensor(found.mass), torch.tensor(found.friction)))
        rollouts = found.rollouts or sum(len(trace.loss) for trace in found.traces)
        covariance = (
            None if found.report is None else misfit.widening * found.report.covariance / np.outer(count, count)
        )
        status, why = misfit.status, misfit.reason
        if not problem.scale_known:
            status, why = "underdetermined", "without M or an accelerated turn only mass times friction is observable"
        elif left > FAR_OFF and not misfit.explains:
            status, why = "not_converged", f"the best candidate leaves {100 * left:.0f} % of the largest wrench: "
            why += "the search is too short, or the trajectories contradict each other"
        elif problem.shape.n_mu > 1 and (open_ := (found.report or problem.report(at)).ambiguity):
            status, why = "underdetermined", open_
        elif status == "ok" and covariance is not None and (loose := hardly_known(problem.shape, at.mass, covariance)):
            status, why = "underdetermined", loose
        return Estimate(
            at,
            status,
            why,
            covariance,
            traces=tuple(replace(trace, robot_seconds=robot_seconds(trajectories)) for trace in found.traces),
            diagnostics={"loss": found.loss, "rollouts": float(rollouts), **misfit.diagnostics},
            assumes=ASSUMPTION[self._support],
        )

    @property
    def _support(self) -> SupportModel:
        """Support that the method assumes."""
        return "own_weight"

    @property
    def _errors(self) -> ModelErrors:
        """Errors of the model."""
        return replace(ERRORS[self._support], pivot_error=self.pivot_error)


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

    @abstractmethod
    def _loss(self, problems: Sequence[Problem]) -> Callable[[Candidates], Tensor]:
        """Loss (D, S) of candidates (D, S, ...) on D problems with windows of the same trials."""

    def estimate_many(
        self,
        shape: ObjectShape,
        weights: Sequence[float | None],
        draws: Sequence[Sequence[Trajectory]],
        seeds: Sequence[int],
    ) -> list[Estimate]:
        """`estimate` of every draw, all with windows of the same trials in one descent.

        `seconds`, and those of a trace, are a draw's share of the descent.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        answers: dict[int, Estimate] = {}
        alike: dict[Any, list[tuple[int, Problem, float]]] = {}
        for i, (weight, trajectories) in enumerate(zip(weights, draws, strict=True)):
            begin = time.perf_counter()
            problem = self._problem(shape, weight, trajectories)
            took = time.perf_counter() - begin
            if isinstance(problem, Problem):
                alike.setdefault(problem.layout, []).append((i, problem, took))
            else:
                answers[i] = replace(problem, seconds=took)
        for group in alike.values():
            begin = time.perf_counter()
            indices, problems, prepared = zip(*group, strict=True)
            found = self._descend(problems, [seeds[i] for i in indices])
            share = (time.perf_counter() - begin) / len(group)
            for i, problem, took, one in zip(indices, problems, prepared, found, strict=True):
                answers[i] = replace(self._judged(problem, one, weights[i], draws[i]), seconds=took + share)
        return [answers[i] for i in range(len(draws))]

    def _search(self, problem: Problem, seed: int) -> SearchResult:
        return self._descend([problem], [seed])[0]

    def _descend(self, problems: Sequence[Problem], seeds: Sequence[int]) -> list[SearchResult]:
        """Descend from uniform mass; without M, each seed draws the friction to start from."""
        loss = self._loss(problems)
        coordinates = LogCoordinates.stacked(
            [LogCoordinates.of(problem, seed) for problem, seed in zip(problems, seeds, strict=True)]
        )
        starts = coordinates.start.expand(len(problems), -1)
        with torch.no_grad():
            scale = loss(coordinates.candidates(starts[:, None])).clamp(min=1e-300)
        runs = descend_all(
            lambda z: loss(coordinates.candidates(z)) / scale,
            starts,
            dict.fromkeys(self.optimizers, self.learning_rate),
            self.iterations,
            masses=lambda z: coordinates.candidates(z).mass,
        )
        best = coordinates.candidates(torch.stack([first.best for first, *_ in runs])[:, None])
        return [
            SearchResult(
                mass[0].numpy(),
                friction[0].numpy(),
                min(of[0].trace.loss) * size,
                tuple(replace(run.trace, loss=tuple(size * v for v in run.trace.loss)) for run in of),
            )
            for of, mass, friction, size in zip(runs, best.mass, best.friction, scale[:, 0].tolist(), strict=True)
        ]


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
