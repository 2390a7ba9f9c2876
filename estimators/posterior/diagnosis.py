"""Diagnosis of trials that disagree: the support, then single trials, then errors of the setup."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.misfit import Misfit
from estimators.posterior.estimator import posterior_of
from estimators.posterior.posterior import CAUSES, Part, Posterior
from estimators.posterior.support import SupportTest, support_test
from estimators.wrench.support import SupportModel
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import LIKELY, PARAMETERS, SetupErrors

ENLARGED = 3.0
"""Factor on the stated size of an error at which it is tried as the cause. Ours."""
DECISIVE = 3.0
"""Decimal logarithm of the odds above which a cause is named: errors of the simulation itself reach 2. Ours."""
SIZE_FACTORS = tuple(np.logspace(-3, 3, 241).tolist())
"""Candidate sizes of an error, as factors on the stated size, in steps of 6 %. Ours."""
MAX_FACTOR = 4.0
"""Factor on the tried size above which a cause is not named: another cause is behind it. Ours."""


@dataclass(frozen=True)
class Cause:
    """Error of the setup as the cause of a disagreement."""

    name: str
    odds: float
    """Decimal logarithm of the odds of the tried size over the stated size."""
    size: float
    """Most likely standard deviation of its values, in the unit of its `Parameter`."""
    absurd: bool
    """True if its most likely size is far above the tried one."""

    @property
    def formatted(self) -> str:
        """Size with its unit, such as "2.1 mm"."""
        return CAUSES[self.name].formatted(self.size)


@dataclass(frozen=True)
class Diagnosis:
    """Misfit of the trials of an object, and its likely causes."""

    misfit: Misfit
    """Misfit on own weight, or of one rigid body where the object can only be that."""
    trials: dict[int, float]
    """Misfit of each trial, by its index among the trajectories."""
    causes: tuple[Cause, ...]
    """Errors of the setup, most likely first."""
    part: Part | None = None
    """Least plausible part of the misfit other than a trial's rows; None if no part is implausible."""
    support: SupportTest | None = None
    """Support test, where a support other than own weight explains the trials."""
    odd_trial: int | None = None
    """Index of the trial without which the others agree; None where all agree or no single trial explains it."""
    without: float = math.inf
    """Misfit without that trial."""

    @property
    def named(self) -> list[Cause]:
        """Causes of odds above `DECISIVE` and of a usual size."""
        return [cause for cause in self.causes if cause.odds > DECISIVE and not cause.absurd]

    @property
    def verdict(self) -> str:
        """Finding in a sentence."""
        if not self.misfit.by_chance:
            return f"misfit {self.misfit.value:.2g} in place of 1: {self._reason}"
        begin = f"misfit {self.misfit.value:.2g}: the trials agree"
        if not self.named:
            return f"{begin} within the errors stated"
        cause = self.named[0]
        return f"{begin}, but {cause.name} is larger than stated, {cause.formatted}: {CAUSES[cause.name].cause}"

    @property
    def _reason(self) -> str:
        """Reason for which the trials do not agree."""
        if self.support is not None:
            return f"{self.support.sentence}: ask support_aware"
        if self.odd_trial is not None:
            return (
                f"trial {self.odd_trial + 1} does not agree with the others, which without it do "
                f"(misfit {self.without:.2g}): check its grasp, its signs and its clock"
            )
        odds = max((cause.odds for cause in self.named), default=0.0)
        if self.part is not None and -self.part.log_chance > math.log(10) * odds:
            return self.part.sentence
        if self.named:
            return f"likeliest, {self.named[0].formatted}: {CAUSES[self.named[0].name].cause}"
        return "no single trial and no error of a usual size explains it; check the shape, the groups and the units"


def diagnose(
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> Diagnosis | None:
    """Diagnosis of an object's trials; None where no trial is usable.

    Args:
        shape: geometry and groups.
        weight: M as weighed, kg.
        trajectories: trials of one object.
        progress: called with the number of completed fits and the largest number of fits.
    """
    most = len(trajectories) + len(PARAMETERS) + 1
    steps = iter(range(1, most + 1))

    def fitted() -> None:
        progress(next(steps), most)

    support: SupportModel = "own_weight" if shape.stands_in_groups else "rigid"
    found = posterior_of(shape, weight, trajectories, support)
    fitted()
    if found is None:
        return None
    answer = found.leaning() if support == "own_weight" else found
    part = next(
        (part for part in answer.parts if part.implausible and not (part.of_rows and part.trial is not None)), None
    )
    stated = SetupErrors.largest([trial.setup for trial in trajectories])
    diagnosis = Diagnosis(answer.explained, answer.by_trial, larger_than_stated(found, stated), part)
    if diagnosis.misfit.by_chance:
        return diagnosis
    if support == "own_weight" and shape.chain is None and not diagnosis.misfit.explains:
        rigid = posterior_of(shape, weight, trajectories, "rigid")
        assert rigid is not None
        test = support_test(shape, weight, trajectories, found, rigid)
        if test.shared or (test.kind == "rigid" and rigid.explained.explains):
            return replace(diagnosis, support=test)
    diagnosis = _with_odd_trial(diagnosis, shape, weight, trajectories, support, fitted)
    if diagnosis.odd_trial is not None:
        return diagnosis
    return replace(diagnosis, causes=_ranked_causes(found, shape, weight, trajectories, support, fitted))


def _with_odd_trial(
    diagnosis: Diagnosis,
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    support: SupportModel,
    fitted: Callable[[], None],
) -> Diagnosis:
    """Diagnosis with the odd trial, if the others agree without exactly one trial."""
    if diagnosis.misfit.explains:
        return diagnosis
    agreeing = dict[int, Misfit | None]()
    for trial in diagnosis.trials:
        others = [each for place, each in enumerate(trajectories) if place != trial]
        rest = posterior_of(shape, weight, others, support)
        fitted()
        # where nothing is left that could disagree, the trial stays a suspect
        misfit = None if rest is None or rest.freedom < 1 else rest.explained
        if misfit is None or misfit.by_chance:
            agreeing[trial] = misfit
    if len(agreeing) != 1:
        return diagnosis
    ((trial, misfit),) = agreeing.items()
    return diagnosis if misfit is None else replace(diagnosis, odd_trial=trial, without=misfit.value)


def _ranked_causes(
    found: Posterior,
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    support: SupportModel,
    fitted: Callable[[], None],
) -> tuple[Cause, ...]:
    """Causes by a fit each, with one error of the setup larger than stated; the highest odds first."""
    stated, causes = SetupErrors.largest([trial.setup for trial in trajectories]), []
    for name in PARAMETERS:
        tried = max(ENLARGED * getattr(stated, name), getattr(LIKELY, name))
        if name == "contact_points" and stated.contact_points:
            tried = stated.contact_points / ENLARGED  # fewer points are a larger error
        if not tried:
            continue
        enlarged = replace(stated, **{name: tried})
        trials = [replace(trial, setup=enlarged) for trial in trajectories]
        larger = posterior_of(shape, weight, trials, support)
        fitted()
        if larger is None or name not in larger.unknowns.blocks:
            continue
        causes.append(_cause(_Evidence.of(larger, name, enlarged), larger.log_evidence - found.log_evidence))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


def larger_than_stated(posterior: Posterior, setup: SetupErrors) -> tuple[Cause, ...]:
    """Causes by the odds of each stated error being `ENLARGED` times as large, the others as in the posterior.

    The likelihood is approximated by a normal one about the most likely unknowns.
    """
    causes = []
    for name in PARAMETERS:
        if name in posterior.unknowns.blocks:
            evidence = _Evidence.of(posterior, name, setup)
            causes.append(_cause(evidence, evidence.log_evidence(ENLARGED) - evidence.log_evidence(1.0), ENLARGED))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


@dataclass(frozen=True, eq=False)
class _Evidence:
    """Evidence of the measurements on one error of the setup, the others as in the posterior."""

    name: str
    unit: float
    """Standard deviation as stated, in the unit of its `Parameter`; 1 pattern of unknown points."""
    precision: Float[Tensor, "m"]
    """Precision of the measurements along its principal axes, in units of the prior's."""
    toward: Float[Tensor, "m"]
    """Precision times the most likely value along each axis."""

    @staticmethod
    def of(posterior: Posterior, name: str, setup: SetupErrors) -> _Evidence:
        """Evidence of a posterior on an error, by name; `setup` is that of its trials."""
        std, where = posterior.unknowns.blocks[name].std, posterior.unknowns.at[name]
        whole = torch.linalg.inv(posterior.laplace[where, where])
        own = std.flatten() > 0
        value, axes = torch.linalg.eigh((whole - torch.eye(len(whole), dtype=torch.float64))[own][:, own])
        unit = 1.0 if name == "contact_points" else getattr(setup, name)
        return _Evidence(name, unit, value.clamp(min=0), axes.T @ (whole @ posterior.optimum.z[where])[own])

    def log_evidence(self, factor: float) -> float:
        """Log evidence for a standard deviation of `factor` times that stated, up to a constant."""
        variance = factor**2
        gained = variance * self.toward.square() / (1 + variance * self.precision)
        return float((gained - torch.log1p(variance * self.precision)).sum()) / 2

    @property
    def likeliest(self) -> float:
        """Most likely standard deviation, as a factor on that stated."""
        return max(SIZE_FACTORS, key=self.log_evidence)


def _cause(evidence: _Evidence, log_odds: float, tried: float = 1.0) -> Cause:
    """Cause by its natural log odds; `tried` is the tried size over the prior's."""
    factor = evidence.likeliest
    return Cause(evidence.name, log_odds / math.log(10), factor * evidence.unit, factor > MAX_FACTOR * tried)
