"""Optimal design: which trials make the answer sure, by the covariance that any set of them would leave.

Criteria: A, the trace of the masses' covariance; D, its volume; I, the expected NAD itself. All are finite before
anything is known, since masses are spread beforehand as `prior_masses` has them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int

from estimators.action_selection.cost import RobotTime
from estimators.identifiability.information import (
    SUPPORTS,
    Assumptions,
    TrialInformation,
    predicted_information,
    prior_information,
)
from estimators.support_models.fit import FRICTION_PRIOR, prior_masses
from testbed.actions.base import Action, Rotate, Slide, Weigh
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.presets import Sensing

Criterion = Literal["A", "D", "I"]
"""What a plan makes small: the trace of the masses' covariance, its volume, or the expected NAD."""
ASSUMED_SUPPORTS: dict[str, tuple[str, ...]] = {**{support: (support,) for support in SUPPORTS}, "either": SUPPORTS}
"""Support models that are thought possible, by the name on a command line and in a file."""
NORMAL_MEAN = math.sqrt(2 / math.pi)
"""Mean size of a standard normal number."""
LEAST_GAIN = 0.01
"""A trial that takes less than this part off the criterion teaches nothing worth its time."""
APART = 0.01
"""Turns in the same grasp about points nearer than this are one turn twice, with the same model error: not both, m."""


@dataclass(frozen=True, eq=False)
class Belief:
    """What is known at some moment, under each support model that is thought possible."""

    information: Float[np.ndarray, "S U U"]
    """Of masses, frictions and shared errors, what is known beforehand included; one a support model."""
    count: Int[np.ndarray, "n_m"]
    """Particles in each mass group."""
    weight: float
    """M, kg."""

    def covariance(self) -> Float[np.ndarray, "S n_m n_m"]:
        """Of the mass groups, kg^2."""
        n_m = len(self.count)
        return np.linalg.inv(self.information)[:, :n_m, :n_m] * np.outer(self.count, self.count)

    @property
    def standard_error(self) -> Float[np.ndarray, "n_m"]:
        """Of each mass group, kg: root mean square over the support models."""
        return np.sqrt(np.diagonal(self.covariance(), axis1=1, axis2=2).mean(axis=0))

    @property
    def expected_nad(self) -> float:
        """Mean over the support models; a part of 1."""
        return float(expected_nad(self.covariance(), self.weight).mean())

    def after(self, trials: Float[np.ndarray, "S U U"]) -> Belief:
        """With the information of more trials."""
        return Belief(self.information + trials, self.count, self.weight)


def expected_nad(covariance: Float[np.ndarray, "... n_m n_m"], weight: float) -> Float[np.ndarray, "..."]:
    """Expected NAD of normal errors: sqrt(2 / pi) times the sum of the groups' standard errors, over M."""
    variance = np.maximum(np.diagonal(covariance, axis1=-2, axis2=-1), 0.0)
    return NORMAL_MEAN * np.sqrt(variance).sum(axis=-1) / weight


def _trace(covariance: Float[np.ndarray, "... n_m n_m"], weight: float) -> Float[np.ndarray, "..."]:
    return np.trace(covariance, axis1=-2, axis2=-1) / weight**2


def _volume(covariance: Float[np.ndarray, "... n_m n_m"], weight: float) -> Float[np.ndarray, "..."]:
    """Geometric mean of the variances along the principal axes."""
    scaled = covariance / weight**2
    return np.exp(np.linalg.slogdet(scaled)[1] / scaled.shape[-1])


CRITERIA: dict[str, Callable[[np.ndarray, float], np.ndarray]] = {"A": _trace, "D": _volume, "I": expected_nad}
"""What is made small, from the groups' covariance (..., n_m, n_m), kg^2, and M, kg."""


@dataclass(frozen=True)
class Guess:
    """What is taken for true while nothing is felt, and how it would be felt."""

    weight: float
    """M as weighed, kg."""
    sensing: Sensing
    """How the sensor errs."""
    friction: float = 0.5
    """Of every friction group."""
    supports: tuple[str, ...] = ("own_weight",)
    """Support models that a plan is to serve; more than one where it is not known who carries the weight."""

    def __post_init__(self) -> None:
        for name in ("weight", "friction"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value > 0):
                raise InvalidValueError(f"Guess.{name}", value, "a finite number > 0")
        if not self.supports or set(self.supports) - set(SUPPORTS):
            raise InvalidValueError("Guess.supports", self.supports, f"one or more of {', '.join(SUPPORTS)}")

    def questions(self) -> tuple[Assumptions, ...]:
        """One a support model."""
        return tuple(Assumptions(support) for support in self.supports)

    def uniform(self, shape: ObjectShape) -> MassDistribution:
        """All particles of one mass."""
        mass = np.full(shape.n_m, self.weight / len(shape.particles))
        return MassDistribution(mass, np.full(shape.n_mu, self.friction))


@dataclass(frozen=True, eq=False)
class PlanStep:
    """One action of a plan."""

    action: Action
    """What to do."""
    seconds: float
    """Of the robot, travel included."""
    belief: Belief
    """After it."""
    criterion: float
    """Its value after it."""


@dataclass(frozen=True, eq=False)
class Design:
    """Candidates with what each would show, worked out once; C candidates."""

    shape: ObjectShape
    candidates: tuple[Action, ...]
    teaches: tuple[TrialInformation, ...]
    """Of every candidate; one a support model."""
    criterion: Criterion = "I"
    time: RobotTime = field(default_factory=RobotTime)

    def __post_init__(self) -> None:
        if self.criterion not in get_args(Criterion):
            raise InvalidValueError("criterion", self.criterion, f"one of {', '.join(get_args(Criterion))}")

    @staticmethod
    def of(
        shape: ObjectShape,
        candidates: Sequence[Action],
        guess: Guess,
        criterion: Criterion = "I",
        at: MassDistribution | None = None,
    ) -> Design:
        """Work out what each candidate would show.

        Args:
            shape: geometry and grasps.
            candidates: actions to choose from.
            guess: how they would be felt, under which supports.
            criterion: what is to be made small.
            at: masses and frictions at which it is taken; uniform masses if left out.
        """
        where = guess.uniform(shape) if at is None else at
        teaches = tuple(
            predicted_information(shape, where, candidates, guess.sensing, question) for question in guess.questions()
        )
        return Design(shape, tuple(candidates), teaches, criterion)

    def of_some(self, kept: Sequence[int]) -> Design:
        """Of some of the candidates."""
        teaches = tuple(replace(each, rows=each.rows[list(kept)]) for each in self.teaches)
        return replace(self, candidates=tuple(self.candidates[i] for i in kept), teaches=teaches)

    @property
    def durations(self) -> Float[np.ndarray, "C"]:
        """Of every candidate alone, s."""
        return np.array([self.time.of(action) for action in self.candidates])

    def value(self, belief: Belief) -> float:
        """The criterion, mean over the support models."""
        return float(CRITERIA[self.criterion](belief.covariance(), belief.weight).mean())

    def values_after(self, belief: Belief) -> Float[np.ndarray, "C"]:
        """The criterion after each candidate: the covariance before, less what its few rows take away."""
        n_m, found = len(belief.count), np.zeros(len(self.candidates))
        scale = np.outer(belief.count, belief.count)
        for information, teaches in zip(belief.information, self.teaches, strict=True):
            before = np.linalg.inv(information)
            seen = teaches.rows @ before
            inner = seen @ teaches.rows.transpose(0, 2, 1) + np.eye(teaches.rows.shape[1])
            lower = np.linalg.cholesky(inner)
            taken = np.linalg.solve(lower, seen[:, :, :n_m])
            after = before[:n_m, :n_m] - taken.transpose(0, 2, 1) @ taken
            found += CRITERIA[self.criterion](after * scale, belief.weight)
        return found / len(self.teaches)

    def taught(self, index: int) -> Float[np.ndarray, "S U U"]:
        """Information of one candidate, under each support model."""
        return np.stack([teaches.information([index]) for teaches in self.teaches])

    def seconds(self, last: Action | None) -> Float[np.ndarray, "C"]:
        """Of every candidate, with the way there from the last action, s."""
        way: dict[int, float] = {}
        for action in self.candidates:
            if not isinstance(action, Weigh) and action.grasp not in way:
                way[action.grasp] = self.time.between(self.shape, last, action)
        none = self.time.rise
        return self.durations + [none if isinstance(a, Weigh) else way[a.grasp] for a in self.candidates]

    def unlike(self, done: Sequence[Action]) -> np.ndarray:
        """Which candidates are none of those done, nor all but the same, (C,) bool.

        Accelerated turns and lifts are none before anything has moved at constant speed: alone they have no answer.
        """
        taken = {action for action in done if not isinstance(action, Rotate)}
        begun = any(steady(action) for action in done)
        keep = np.array([(begun or steady(a)) and a not in taken for a in self.candidates], dtype=bool)
        turns = [action for action in done if isinstance(action, Rotate)]
        if turns and keep.size:
            mine, where = zip(*[_place(self.shape, a) for a in self.candidates], strict=True)
            for turn in turns:
                grasp, point = _place(self.shape, turn)
                keep &= (np.array(mine) != grasp) | (np.linalg.norm(np.array(where) - point, axis=1) > APART)
        return keep


def steady(action: Action) -> bool:
    """Whether it moves the object at constant speed: without any such trial no method has an answer."""
    return isinstance(action, Rotate | Slide)


def prior_belief(shape: ObjectShape, guess: Guess) -> Belief:
    """The weighing, and all ways to share M as likely."""
    n_m, n_mu, count = shape.n_m, shape.n_mu, shape.particles_per_group
    covariance = prior_masses(shape, guess.weight)[1]
    both = []
    for question in guess.questions():
        information = prior_information(shape, max(guess.sensing.scale, question.stated.weight_error))
        information[:n_m, :n_m] += np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
        information[n_m : n_m + n_mu, n_m : n_m + n_mu] += np.eye(n_mu) / FRICTION_PRIOR**2
        both.append(information)
    return Belief(np.stack(both), count, guess.weight)


def _place(shape: ObjectShape, action: Action) -> tuple[int, np.ndarray]:
    """Grasp and pivot of a turn; of anything else, nothing that is near one."""
    if not isinstance(action, Rotate):
        return -1, np.full(2, np.inf)
    return action.grasp, np.array(shape.grasps[action.grasp].position if action.pivot is None else action.pivot)
