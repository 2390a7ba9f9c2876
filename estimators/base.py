"""Estimate, and the protocols of estimators and of policies that choose actions."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np
from jaxtyping import Float
from numpy.typing import ArrayLike

from estimators.identifiability.report import Identifiability
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape, check_shape
from testbed.trajectory import Trajectory
from testbed.validation import check_kilograms, frozen_array, is_number

if TYPE_CHECKING:
    import pandas as pd

EstimateStatus = Literal[
    "ok", "underdetermined", "unexplained", "not_converged", "contradictory", "no_data", "assumption_violated"
]
"""Status of an estimate.

* `ok`: mass and friction are determined, and explain the trials.
* `underdetermined`: the trials leave a direction open.
* `unexplained`: the masses do not explain the trials within the errors stated (`Misfit`); their own errors are widened.
* `not_converged`: the best masses found leave most of the wrenches: the search is too short.
* `contradictory`: no masses explain them.
* `no_data`: no trial is usable.
* `assumption_violated`: an assumption of the method, as own weight, does not hold for the object.
"""
MOST_MASS = 1e3
"""Largest mass of a particle in an answer, kg: no object has it."""
ROUNDING = 1e-15
"""Largest negative variance that counts as rounding [kg^2]."""
NO_MASSES = ("underdetermined", "contradictory")
"""Statuses of an answer that may have no masses, since the trials do not determine them."""


@dataclass(frozen=True, eq=False)
class HiddenStateEstimate:
    """Hidden states H of the paper, which the wrench shows before it is split into mass and friction."""

    mass: float
    """M, kg."""
    inertia_cm: float
    """I_cm, kg m^2; NaN where it is not observed."""
    center_of_mass: Float[np.ndarray, "2"]
    """c, m, object frame; NaN in a component that is not observed."""
    friction_load: Float[np.ndarray, "n_s"]
    """s = mu m g of one particle of each (mass group, friction group) in contact, N."""
    groups: tuple[tuple[int, int], ...]
    """Mass group and friction group of each entry of `friction_load`."""
    unobserved: str = ""
    """Unobserved numbers in words; empty where all are observed."""


@dataclass(frozen=True, eq=False)
class Trace:
    """Path of an iterative method over I iterations."""

    method: str
    """Optimizer, or the search itself."""
    loss: tuple[float, ...]
    """Loss at each iteration."""
    seconds: tuple[float, ...]
    """Wall time up to the end of each iteration, s."""
    robot_seconds: float
    """Robot time of the data, s."""
    mass: Float[np.ndarray, "I n_m"]
    """Particle masses at each iteration, kg; (0, 0) where the method has none on its way."""


@dataclass(frozen=True, eq=False, repr=False)
class Estimate:
    """Mass and friction with their uncertainty, or a status that is the reason for none."""

    distribution: MassDistribution | None
    """Mass and friction; None where there is no estimate."""
    status: EstimateStatus
    """ok, or the reason why there is no estimate or only part of one."""
    message: str = ""
    """A sentence where status is not ok."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Covariance of the particle masses, kg^2, infinite where not observed; None where the method gives none."""
    identifiability: Identifiability | None = None
    """Observed and open directions, for methods that report them."""
    hidden: HiddenStateEstimate | None = None
    """Hidden states, for methods that have them."""
    traces: tuple[Trace, ...] = ()
    """One a run of an optimizer."""
    seconds: float = 0.0
    """Wall time of the whole estimate, s."""
    diagnostics: dict[str, float] = field(default_factory=dict)
    """Method-specific numbers: residuals, ranks, conditioning."""
    assumes: str = ""
    """Assumption that the masses rest on and the method does not test, in words; empty without one."""

    def __post_init__(self) -> None:
        if self.status not in get_args(EstimateStatus):
            raise InvalidValueError("Estimate.status", self.status, f"one of {', '.join(get_args(EstimateStatus))}")
        if not isinstance(self.distribution, MassDistribution | None):
            raise InvalidValueError("Estimate.distribution", self.distribution, "a MassDistribution, or None")
        if self.distribution is None and self.status == "ok":
            raise InvalidValueError("Estimate.distribution", None, "a MassDistribution where the status is ok")
        if self.distribution is not None and (self.distribution.mass > MOST_MASS).any():
            given = f"particles of {self.distribution.mass.max():.3g} kg"
            raise InvalidValueError("Estimate.distribution", given, f"at most {MOST_MASS:g} kg per particle")
        if self.covariance is not None:
            object.__setattr__(self, "covariance", _checked_covariance(self.covariance))
        for name, kind, allowed in (
            ("message", str, "text"),
            ("assumes", str, "text"),
            ("identifiability", Identifiability | None, "an Identifiability, or None"),
            ("hidden", HiddenStateEstimate | None, "a HiddenStateEstimate, or None"),
        ):
            if not isinstance(value := getattr(self, name), kind):
                raise InvalidValueError(f"Estimate.{name}", value, allowed)
        if not is_number(self.seconds) or self.seconds < 0:
            raise InvalidValueError("Estimate.seconds", self.seconds, "a number >= 0, s")
        if not isinstance(self.traces, tuple) or not all(isinstance(trace, Trace) for trace in self.traces):
            raise InvalidValueError("Estimate.traces", self.traces, "a tuple of Traces")
        _check_diagnostics(self.diagnostics)

    def group_mass(self, shape: ObjectShape) -> Float[np.ndarray, "n_m"] | None:
        """Mass of each group, kg; None without an answer."""
        return None if self.distribution is None else self.distribution.group_mass(shape)

    def group_error(self, shape: ObjectShape) -> Float[np.ndarray, "n_m"] | None:
        """Standard error of each group's mass, kg, infinite where nothing is observed; None without a covariance."""
        return None if self.covariance is None else np.sqrt(np.diag(self.covariance)) * shape.particles_per_group

    def friction_error(self) -> Float[np.ndarray, "n_mu"] | None:
        """Standard error of each friction; None without an answer, NaN where the method gives none."""
        if self.distribution is None:
            return None
        report, count = self.identifiability, len(self.distribution.friction)
        errors = np.full(count, np.nan) if report is None else report.friction_error
        return np.array([self.diagnostics.get(f"friction_{k}_std", errors[k]) for k in range(count)])

    def table(self, shape: ObjectShape) -> pd.DataFrame:
        """Masses of the groups [kg], then frictions, a row each: value and standard error.

        NaN where the method gives none; no rows without an answer.

        Raises:
            InvalidValueError: a shape with other numbers of groups.
        """
        import pandas  # noqa: PLC0415  it takes half a second, and few who import an Estimate print one

        if self.distribution is None:
            return pandas.DataFrame({"value": [], "error": [], "unit": []})
        check_estimate("Estimate.table", self, shape)
        friction, errors = self.distribution.friction, (self.group_error(shape), self.friction_error())
        unknown = (np.full(shape.n_m, np.nan), np.full(shape.n_mu, np.nan))
        known = [found if given is None else given for given, found in zip(errors, unknown, strict=True)]
        return pandas.DataFrame(
            {
                "value": np.concatenate([self.distribution.group_mass(shape), friction]),
                "error": np.concatenate(known),
                "unit": ["kg"] * shape.n_m + [""] * len(friction),
            },
            index=[*shape.group_names, *shape.friction_names],
        )

    def __repr__(self) -> str:
        """Status and message; masses are per particle, so `table` prints them per group."""
        count = 0 if self.distribution is None else len(self.distribution.mass)
        message = f", {self.message!r}" if self.message else ""
        return f"Estimate({self.status!r}{message}, {count} groups: table(shape) lists them)"


def check_estimate(called: str, answer: Any, shape: ObjectShape) -> Estimate:
    """The answer of an estimator, if it is an Estimate with the shape's groups.

    Args:
        called: name of the call, for the message.
        answer: what the call returned.
        shape: shape of the object.

    Raises:
        InvalidValueError: another type, or masses, frictions or a covariance of another size.
    """
    if not isinstance(answer, Estimate):
        raise InvalidValueError(called, answer, "an Estimate of estimators.base")
    if (found := answer.distribution) is not None and (len(found.mass), len(found.friction)) != (shape.n_m, shape.n_mu):
        given = f"{len(found.mass)} masses, {len(found.friction)} frictions"
        allowed = f"{shape.n_m} and {shape.n_mu}, one of each mass group and friction group"
        raise InvalidValueError(called, given, allowed)
    if answer.covariance is not None and len(answer.covariance) != shape.n_m:
        allowed = f"one row and column of each of {shape.n_m} mass groups"
        raise InvalidValueError(f"{called}.covariance", answer.covariance.shape, allowed)
    return answer


def _check_diagnostics(values: dict[str, float]) -> None:
    """Check that diagnostics are numbers by name."""
    if not isinstance(values, dict):
        raise InvalidValueError("Estimate.diagnostics", values, "a dict of numbers by name")
    for name, value in values.items():
        if not isinstance(name, str) or not isinstance(value, int | float | np.integer | np.floating | np.bool_):
            raise InvalidValueError(f"Estimate.diagnostics[{name!r}]", value, "a number, by a name")
    if (misfit := values.get("misfit", 0.0)) < -ROUNDING:
        raise InvalidValueError("Estimate.diagnostics['misfit']", misfit, "a mean square, >= 0")


def _checked_covariance(values: ArrayLike) -> np.ndarray:
    """A covariance that is symmetric and positive semidefinite; infinite where nothing is observed."""
    given = frozen_array("Estimate.covariance", values, (None, None), finite=False).copy()
    if len(given) != given.shape[1]:
        raise InvalidValueError("Estimate.covariance", f"shape {given.shape}", "as many rows as columns")
    if np.isnan(given).any():
        raise InvalidValueError("Estimate.covariance", f"{int(np.isnan(given).sum())} NaN", "numbers, inf if unknown")
    variance, known = np.diag(given), np.isfinite(given).all(axis=0)
    if (variance < -ROUNDING).any():
        raise InvalidValueError("Estimate.covariance", f"variances {variance.tolist()}", "variances >= 0, kg^2")
    inner = given[np.ix_(known, known)]
    if not np.allclose(inner, inner.T, rtol=1e-6, atol=1e-6 * np.abs(inner).max(initial=0.0)):
        raise InvalidValueError("Estimate.covariance", inner.tolist(), "a symmetric matrix")
    if len(inner) and (least := np.linalg.eigvalsh(inner)[0]) < -1e-6 * np.trace(inner) - ROUNDING:
        raise InvalidValueError("Estimate.covariance", f"an eigenvalue of {least:.3g}", "eigenvalues >= 0, kg^2")
    np.fill_diagonal(given, np.maximum(variance, 0))
    given.flags.writeable = False
    return given


def weighed(shape: ObjectShape, weight: float | None) -> float:
    """Weight M of a method that cannot do without it, kg.

    Raises:
        InvalidValueError: no weight, or one that no object has; or a model of the object in place of its shape.
    """
    check_shape(shape)
    check_kilograms("weight", weight)
    assert weight is not None
    return weight


@runtime_checkable
class Estimator(Protocol):
    """Method that estimates a mass distribution from trajectories. Frozen configuration; no state between calls."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate mass and friction.

        Args:
            shape: geometry and groups; never the truth.
            weight: M as weighed, kg, or None.
            trajectories: measured trials.
            seed: seed of methods that draw.
        """
        ...


@runtime_checkable
class BatchEstimator(Estimator, Protocol):
    """Estimator that takes many draws of the sensor's errors at once, where that is faster."""

    def estimate_many(
        self,
        shape: ObjectShape,
        weights: Sequence[float | None],
        draws: Sequence[Sequence[Trajectory]],
        seeds: Sequence[int],
    ) -> list[Estimate]:
        """Estimates of D draws, each as `estimate` gives it; its `seconds` are its share of the batch.

        A draw that cannot be used has a status. If the call raises, `estimate` is called for each draw.

        Args:
            shape: geometry and groups; never the truth.
            weights: M as weighed of each draw, kg, or None.
            draws: measured trials of each draw.
            seeds: seed of each draw.
        """
        ...


@runtime_checkable
class ActionPolicy(Protocol):
    """Choice of the next action. Frozen configuration."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action, or None when no further one is worth its time."""
        ...


def robot_seconds(trajectories: Sequence[Trajectory]) -> float:
    """Robot time that trajectories took, s."""
    return float(sum(t.time_s[-1] - t.time_s[0] for t in trajectories))
