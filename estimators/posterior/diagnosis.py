"""Diagnosis of trials that disagree: the support first, then a single trial, then the errors of the setup."""

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

WIDER = 3.0
"""Multiple of its stated size at which an error is tried as the cause. Ours."""
DECISIVE = 3.0
"""Decimal logarithm of the odds from which a cause is named: the simulation's own flaws reach 2. Ours."""
WIDTHS = tuple(np.logspace(-3, 3, 241).tolist())
"""Sizes of an error that are held against each other, as multiples of that stated; each 6 % over the last. Ours."""
ABSURD = 4.0
"""Multiple of the size that is tried above which a cause is not named: another one is hidden behind it. Ours."""


@dataclass(frozen=True)
class Cause:
    """Error of the setup as the cause of a disagreement."""

    name: str
    odds: float
    """Decimal logarithm of the odds of its being as large as tried, over its being as stated."""
    size: float
    """Standard deviation of its values that makes the measurements likeliest, in the unit of its `Parameter`."""
    absurd: bool
    """True if it would have to be far larger than such errors are."""

    @property
    def formatted(self) -> str:
        """Size in words, such as "2.1 mm"."""
        return CAUSES[self.name].formatted(self.size)


@dataclass(frozen=True)
class Diagnosis:
    """Diagnosis of the trials of an object: their misfit, and what would explain it."""

    misfit: Misfit
    """Misfit on own weight, or of one rigid body where the object can only be that."""
    trials: dict[int, float]
    """Misfit of each trial, by its place among those given."""
    causes: tuple[Cause, ...]
    """Errors of the setup, likeliest first."""
    part: Part | None = None
    """Least plausible part of the misfit that is no trial's, if it is implausible."""
    support: SupportTest | None = None
    """Test that finds another support than own weight, which explains the trials."""
    odd_trial: int | None = None
    """Trial without which the others agree, where all together do not."""
    without: float = math.inf
    """Misfit without that trial."""

    @property
    def named(self) -> list[Cause]:
        """Causes that are likely enough to be named."""
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
        """Why the trials do not agree."""
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
        progress: receives how many fits of those that may be needed are done.
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
    diagnosis = _without_one(diagnosis, shape, weight, trajectories, support, fitted)
    if diagnosis.odd_trial is not None:
        return diagnosis
    return replace(diagnosis, causes=_one_by_one(found, shape, weight, trajectories, support, fitted))


def _without_one(
    diagnosis: Diagnosis,
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    support: SupportModel,
    fitted: Callable[[], None],
) -> Diagnosis:
    """Diagnosis with the one trial without which all others agree, if there is one and no other would do."""
    if diagnosis.misfit.explains:
        return diagnosis
    healed = dict[int, float]()
    for trial in diagnosis.trials:
        others = [each for place, each in enumerate(trajectories) if place != trial]
        left = posterior_of(shape, weight, others, support)
        fitted()
        if left is not None and left.explained.by_chance:
            healed[trial] = left.explained.value
    if len(healed) != 1:
        return diagnosis
    ((trial, value),) = healed.items()
    return replace(diagnosis, odd_trial=trial, without=value)


def _one_by_one(
    found: Posterior,
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    support: SupportModel,
    fitted: Callable[[], None],
) -> tuple[Cause, ...]:
    """Errors of the setup, each alone larger than stated, by the odds over all being as stated."""
    stated, causes = SetupErrors.largest([trial.setup for trial in trajectories]), []
    for name in PARAMETERS:
        tried = max(WIDER * getattr(stated, name), getattr(LIKELY, name))
        if name == "contact_points" and stated.contact_points:
            tried = stated.contact_points / WIDER  # fewer points are a larger error
        if not tried:
            continue
        wider = replace(stated, **{name: tried})
        trials = [replace(trial, setup=wider) for trial in trajectories]
        larger = posterior_of(shape, weight, trials, support)
        fitted()
        if larger is None or name not in larger.unknowns.blocks:
            continue
        causes.append(_cause(_Seen.of(larger, name, wider), larger.log_evidence - found.log_evidence))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


def larger_than_stated(posterior: Posterior, setup: SetupErrors) -> tuple[Cause, ...]:
    """Stated errors by the odds of each being `WIDER` times as large, all others being as in the posterior.

    The likelihood is taken as normal about the most likely unknowns.
    """
    causes = []
    for name in PARAMETERS:
        if name in posterior.unknowns.blocks:
            seen = _Seen.of(posterior, name, setup)
            causes.append(_cause(seen, seen.log_evidence(WIDER) - seen.log_evidence(1.0), WIDER))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


@dataclass(frozen=True, eq=False)
class _Seen:
    """Evidence of the measurements on one error of the setup, all others being as in the posterior."""

    name: str
    unit: float
    """Standard deviation as stated, in the unit of its `Parameter`; 1 pattern of unknown points."""
    precision: Float[Tensor, "m"]
    """Precision along the axes that the measurements show apart, in units of the prior's."""
    toward: Float[Tensor, "m"]
    """Precision times the likeliest value along each axis."""

    @staticmethod
    def of(posterior: Posterior, name: str, setup: SetupErrors) -> _Seen:
        """Share of a posterior, of trials in a setup, that is one error's."""
        std, where = posterior.unknowns.blocks[name].std, posterior.unknowns.at[name]
        whole = torch.linalg.inv(posterior.laplace[where, where])
        own = std.flatten() > 0
        value, axes = torch.linalg.eigh((whole - torch.eye(len(whole), dtype=torch.float64))[own][:, own])
        unit = 1.0 if name == "contact_points" else getattr(setup, name)
        return _Seen(name, unit, value.clamp(min=0), axes.T @ (whole @ posterior.optimum.z[where])[own])

    def log_evidence(self, width: float) -> float:
        """Logarithm of the evidence for a standard deviation of `width` times that stated, but for a constant."""
        variance = width**2
        gained = variance * self.toward.square() / (1 + variance * self.precision)
        return float((gained - torch.log1p(variance * self.precision)).sum()) / 2

    @property
    def likeliest(self) -> float:
        """Likeliest standard deviation, as a multiple of that stated."""
        return max(WIDTHS, key=self.log_evidence)


def _cause(seen: _Seen, log_evidence: float, tried: float = 1.0) -> Cause:
    """Cause by the evidence for an error `tried` times as large as the prior's."""
    width = seen.likeliest
    return Cause(seen.name, log_evidence / math.log(10), width * seen.unit, width > ABSURD * tried)
