"""Optimal design: the covariance of the masses after a set of trials, and the criteria on it.

Criteria: A, the trace of the masses' covariance; D, its volume; I, the expected NAD itself. All are finite before the
first trial, since the masses have the prior of `prior_masses`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
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
from estimators.identifiability.report import prior_masses
from estimators.posterior.scale import Weighing
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.sensing.presets import Sensing
from testbed.validation import check_kilograms, check_positive_fields
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

Criterion = Literal["A", "D", "I"]
"""Quantity that a plan minimizes: trace of the masses' covariance, its volume, or the expected NAD."""
ASSUMED_SUPPORTS: dict[str, tuple[str, ...]] = {**{support: (support,) for support in SUPPORTS}, "either": SUPPORTS}
"""Assumed support models by their name on a command line and in a file."""
NORMAL_MEAN = math.sqrt(2 / math.pi)
"""Mean absolute value of a standard normal number."""
LEAST_GAIN = 0.01
"""Least fall of the criterion's logarithm by a trial that is worth its time."""
FRICTION_PRIOR = 1.0
"""Prior standard deviation of every friction coefficient: large against any measured error."""
APART = 0.01
"""Least distance between centers of turns in one grasp, and between points of pushes [m]: nearer ones repeat each
other, model error included."""


@dataclass(frozen=True, eq=False)
class Belief:
    """Information at some moment, under each assumed support model."""

    information: Float[np.ndarray, "S U U"]
    """Information about masses, frictions and shared errors, prior included; one matrix a support model."""
    count: Int[np.ndarray, "n_m"]
    """Particles in each mass group."""
    weight: float
    """M, kg."""

    def covariance(self) -> Float[np.ndarray, "S n_m n_m"]:
        """Covariance of the mass groups [kg^2]."""
        n_m = len(self.count)
        return np.linalg.inv(self.information)[:, :n_m, :n_m] * np.outer(self.count, self.count)

    @property
    def standard_error(self) -> Float[np.ndarray, "n_m"]:
        """Standard error of each mass group [kg], root mean square over the support models."""
        return np.sqrt(np.diagonal(self.covariance(), axis1=1, axis2=2).mean(axis=0))

    @property
    def expected_nad(self) -> float:
        """Expected NAD as a ratio (0.05 is 5 %), mean over the support models."""
        return float(expected_nad(self.covariance(), self.weight).mean())

    def after(self, trials: Float[np.ndarray, "S U U"]) -> Belief:
        """Belief with the information of more trials added."""
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
"""Criterion as a function of the groups' covariance (..., n_m, n_m) [kg^2] and M [kg]."""


def check_criterion(field: str, value: object) -> None:
    """Raise InvalidValueError for a criterion that is none."""
    if value not in get_args(Criterion):
        raise InvalidValueError(field, value, f"one of {', '.join(get_args(Criterion))}")


@dataclass(frozen=True)
class Guess:
    """Assumptions before the first trial: weight, sensor, friction, support models and setup."""

    weight: float
    """Weighed M [kg]."""
    sensing: Sensing
    """Errors of the sensor."""
    friction: float = 0.5
    """Coefficient of every friction group."""
    supports: tuple[str, ...] = ("own_weight",)
    """Support models that a plan serves; more than one where the support is not known."""
    setup: SetupErrors = EXACT_SETUP
    """Errors of the setup as stated."""
    hinge_friction: tuple[float, ...] | None = None
    """Torque of friction of each hinge of an object in links [N m]; None before any trial."""

    def __post_init__(self) -> None:
        check_kilograms("Guess.weight", self.weight)
        check_positive_fields(self, "friction")
        if not isinstance(self.sensing, Sensing):
            raise InvalidValueError("Guess.sensing", self.sensing, 'a Sensing, such as heft.preset("ft300s")')
        if not self.supports or set(self.supports) - set(SUPPORTS):
            raise InvalidValueError("Guess.supports", self.supports, f"one or more of {', '.join(SUPPORTS)}")

    def assumptions(self) -> tuple[Assumptions, ...]:
        """Assumptions of each support model, with its measured model errors and the setup's."""
        return tuple(
            Assumptions(support, setup=self.setup, hinge_friction=self.hinge_friction) for support in self.supports
        )

    def uniform(self, shape: ObjectShape) -> MassDistribution:
        """Distribution of equal masses of cells."""
        cells = np.bincount(shape.mass_group[shape.cells], minlength=shape.n_m)
        mass = self.weight * cells / cells.sum() / shape.particles_per_group
        return MassDistribution(mass, np.full(shape.n_mu, self.friction))


@dataclass(frozen=True, eq=False)
class Design:
    """C candidates with the predicted information of each."""

    shape: ObjectShape
    candidates: tuple[Action, ...]
    information: tuple[TrialInformation, ...]
    """Information of every candidate; one entry a support model."""
    criterion: Criterion = "I"
    time: RobotTime = field(default_factory=RobotTime)

    def __post_init__(self) -> None:
        check_criterion("criterion", self.criterion)

    @staticmethod
    def of(
        shape: ObjectShape,
        candidates: Sequence[Action],
        guess: Guess,
        criterion: Criterion = "I",
        at: MassDistribution | None = None,
    ) -> Design:
        """Design with the predicted information of each candidate.

        Args:
            shape: geometry and grasps.
            candidates: actions to choose from.
            guess: sensor and support models.
            criterion: quantity to minimize.
            at: masses and frictions at which information is taken; uniform masses if left out.
        """
        where = guess.uniform(shape) if at is None else at
        each = [predicted_information(shape, where, candidates, guess.sensing, a) for a in guess.assumptions()]
        return Design(shape, tuple(candidates), tuple(each), criterion)

    def of_some(self, kept: Sequence[int]) -> Design:
        """Design of some of the candidates."""
        information = tuple(replace(each, rows=each.rows[list(kept)]) for each in self.information)
        return replace(self, candidates=tuple(self.candidates[i] for i in kept), information=information)

    def value(self, belief: Belief) -> float:
        """Criterion, mean over the support models."""
        return float(CRITERIA[self.criterion](belief.covariance(), belief.weight).mean())

    def values_after(self, belief: Belief) -> Float[np.ndarray, "C"]:
        """Criterion after each candidate, by a low-rank update of the covariance."""
        n_m, found = len(belief.count), np.zeros(len(self.candidates))
        scale = np.outer(belief.count, belief.count)
        for information, trials in zip(belief.information, self.information, strict=True):
            before = np.linalg.inv(information)
            for count in np.unique(trials.lengths):
                (of_length,) = np.nonzero(trials.lengths == count)
                rows = trials.rows[of_length, :count]
                projected = (rows.reshape(-1, rows.shape[-1]) @ before).reshape(rows.shape)
                inner = projected @ rows.transpose(0, 2, 1) + np.eye(count)
                taken = np.linalg.solve(np.linalg.cholesky(inner), projected[:, :, :n_m])
                after = before[:n_m, :n_m] - taken.transpose(0, 2, 1) @ taken
                found[of_length] += CRITERIA[self.criterion](after * scale, belief.weight)
        return found / len(self.information)

    def information_of(self, chosen: Sequence[int]) -> Float[np.ndarray, "S U U"]:
        """Information of the chosen candidates together, under each support model."""
        return np.stack([trials.information(chosen) for trials in self.information])

    def seconds(self, last: Action | None) -> Float[np.ndarray, "C"]:
        """Robot time of every candidate [s], travel from the last action included."""
        way: dict[int | Action, float] = {}
        places = [action if action.grasp is None else action.grasp for action in self.candidates]
        for place, action in zip(places, self.candidates, strict=True):
            if place not in way:
                way[place] = self.time.between(self.shape, last, action)
        return self._own_seconds + np.array([way[place] for place in places])

    @cached_property
    def _own_seconds(self) -> Float[np.ndarray, "C"]:
        """Robot time of every candidate without travel [s]."""
        return np.array([self.time.of(action) for action in self.candidates])

    def novel(self, done: Sequence[Action]) -> np.ndarray:
        """Mask of the candidates that neither repeat a completed action nor come too early, shape (C,).

        Accelerated turns and lifts come after a trial at constant speed: alone they give no answer.
        """
        begun = any(steady(action) for action in done)
        return self.unlike(done) & np.array([begun or steady(a) for a in self.candidates], dtype=bool)

    def unlike(self, done: Sequence[Action]) -> np.ndarray:
        """Mask of the candidates that repeat no completed action exactly or nearly, shape (C,)."""
        # turns at constant speed are compared by grasp and center, pushes by point, other actions as a whole
        taken = {action for action in done if not _placed(action)}
        keep = np.array([a not in taken for a in self.candidates], dtype=bool)
        placed = [action for action in done if _placed(action)]
        if placed and keep.size:
            mine, where = zip(*[_place(self.shape, a) for a in self.candidates], strict=True)
            for action in placed:
                grasp, point = _place(self.shape, action)
                keep &= (np.array(mine) != grasp) | (np.linalg.norm(np.array(where) - point, axis=1) > APART)
        return keep


def steady(action: Action) -> bool:
    """True if the action moves the object at constant speed: without such a trial no method has an answer."""
    return action.on_table and not action.accelerated


def prior_belief(shape: ObjectShape, guess: Guess) -> Belief:
    """Belief after the weighing, with all splits of M among the groups equally likely."""
    n_m, n_mu, count = shape.n_m, shape.n_mu, shape.particles_per_group
    covariance = prior_masses(shape, guess.weight)
    each = []
    for assumptions in guess.assumptions():
        weight_error = max(guess.sensing.scale, assumptions.model_errors.weight_error)
        information = prior_information(shape, Weighing.of(shape, weight_error, guess.setup), assumptions)
        information[:n_m, :n_m] += np.linalg.pinv(covariance, rcond=1e-9, hermitian=True)
        information[n_m : n_m + n_mu, n_m : n_m + n_mu] += np.eye(n_mu) / FRICTION_PRIOR**2
        each.append(information)
    return Belief(np.stack(each), count, guess.weight)


def _place(shape: ObjectShape, action: Action) -> tuple[int, np.ndarray]:
    """Grasp and pivot of a turn, or -2 and the point of a push; -1 and infinity for other actions."""
    if not _placed(action):
        return -1, np.full(2, np.inf)
    return (-2, action.hand(shape)[0]) if action.grasp is None else (action.grasp, action.center(shape))


def _placed(action: Action) -> bool:
    return action.pushes or (action.turns and not action.accelerated)
