"""Diagnosis of trials that disagree: the support first, then a single trial, then the errors of the setup."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.misfit import Misfit
from estimators.posterior.estimator import posterior_of
from estimators.posterior.posterior import CAUSES, Part, Posterior
from estimators.wrench.model import RIGID
from estimators.wrench.support import SupportModel
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.worlds.setup_errors import LIKELY, PARAMETERS, SetupErrors

WIDER = 3.0
"""Multiple of its stated size at which an error is tried as the cause. Ours."""
DECISIVE = 3.0
"""Decimal logarithm of the odds from which a cause is named: the simulation's own flaws reach 2. Ours."""
ABSURD = 4.0
"""Multiple of the size that is tried above which a cause is not named: another one is hidden behind it. Ours."""


@dataclass(frozen=True)
class Cause:
    """Error of the setup as the cause of a disagreement."""

    name: str
    odds: float
    """Decimal logarithm of the odds of its being as large as tried, over its being as stated."""
    size: float
    """Root mean square of its values as they fit best, in the unit of its `Parameter`."""
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
    rigid: float = math.inf
    """Misfit of one rigid body, where own weight does not explain the trials."""
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
        if self.rigid < math.inf:
            return (
                "the groups do not rest on their own weight; one rigid body explains the trials "
                f"(misfit {self.rigid:.2g}): ask support_aware"
            )
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


def diagnose(shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory]) -> Diagnosis | None:
    """Diagnosis of an object's trials; None where no trial is usable.

    Args:
        shape: geometry and groups.
        weight: M as weighed, kg.
        trajectories: trials of one object.
    """
    support: SupportModel = "own_weight" if shape.stands_in_groups else "rigid"
    found = posterior_of(shape, weight, trajectories, support)
    if found is None:
        return None
    part = next(
        (part for part in found.parts if part.implausible and not (part.of_rows and part.trial is not None)), None
    )
    diagnosis = Diagnosis(found.explained, found.by_trial, larger_than_stated(found), part)
    if diagnosis.misfit.by_chance:
        return diagnosis
    if support == "own_weight" and shape.chain is None and not diagnosis.misfit.explains:
        # by the same errors for both: neither wins by its tolerance
        rigid, own = (posterior_of(shape, weight, trajectories, each, errors=RIGID) for each in ("rigid", support))
        assert rigid is not None and own is not None
        if rigid.explained.explains and (rigid.log_evidence - own.log_evidence) / math.log(10) > DECISIVE:
            return replace(diagnosis, rigid=rigid.explained.value)
    diagnosis = _without_one(diagnosis, shape, weight, trajectories, support)
    if diagnosis.odd_trial is not None:
        return diagnosis
    return replace(diagnosis, causes=_one_by_one(found, shape, weight, trajectories, support))


def _without_one(
    diagnosis: Diagnosis,
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    support: SupportModel,
) -> Diagnosis:
    """Diagnosis with the one trial without which all others agree, if there is one."""
    if diagnosis.misfit.explains:
        return diagnosis
    for trial in diagnosis.trials:
        others = [each for place, each in enumerate(trajectories) if place != trial]
        left = posterior_of(shape, weight, others, support)
        if left is not None and left.explained.by_chance and left.explained.value < diagnosis.without:
            diagnosis = replace(diagnosis, odd_trial=trial, without=left.explained.value)
    return diagnosis


def _one_by_one(
    found: Posterior, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], support: SupportModel
) -> tuple[Cause, ...]:
    """Errors of the setup, each alone larger than stated, by the odds over all being as stated."""
    stated, causes = SetupErrors.largest([trial.setup for trial in trajectories]), []
    for name in PARAMETERS:
        tried = max(WIDER * getattr(stated, name), getattr(LIKELY, name))
        if name == "contact_points" and stated.contact_points:
            tried = stated.contact_points / WIDER  # fewer points are a larger error
        if not tried:
            continue
        trials = [replace(trial, setup=replace(stated, **{name: tried})) for trial in trajectories]
        larger = posterior_of(shape, weight, trials, support)
        if larger is None or name not in larger.unknowns.blocks:
            continue
        z = larger.optimum.z[larger.unknowns.at[name]]
        causes.append(_cause(larger, name, z, larger.log_evidence - found.log_evidence))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


def larger_than_stated(posterior: Posterior) -> tuple[Cause, ...]:
    """Stated errors by the odds of each being `WIDER` times as large, all others being as in the posterior.

    The likelihood is taken as normal about the most likely unknowns.
    """
    causes = []
    for name in PARAMETERS:
        if name not in posterior.unknowns.blocks:
            continue
        where = posterior.unknowns.at[name]
        precision = torch.linalg.inv(posterior.laplace[where, where])
        eye = torch.eye(len(precision), dtype=torch.float64)
        seen, toward = precision - eye, precision @ posterior.optimum.z[where]

        def evidence(width: float, seen: Tensor = seen, toward: Tensor = toward, eye: Tensor = eye) -> float:
            volume = torch.linalg.slogdet(eye + width**2 * seen)[1]
            return float(toward @ torch.linalg.solve(seen + eye / width**2, toward) - volume) / 2

        best = torch.linalg.solve(seen + eye / WIDER**2, toward)
        causes.append(_cause(posterior, name, best, evidence(WIDER) - evidence(1.0)))
    return tuple(sorted(causes, key=lambda cause: -cause.odds))


def _cause(posterior: Posterior, name: str, z: Float[Tensor, "m"], evidence: float) -> Cause:
    """Cause of such values, in units of the posterior's prior."""
    std = posterior.unknowns.blocks[name].std
    own = std.flatten() > 0
    part, unit = float(z[own].square().mean().sqrt()), float(std.flatten()[own].square().mean().sqrt())
    if name == "contact_points":  # in units of a pattern
        unit = 1.0
    elif name == "foot_load":  # of n feet there are n - 1 patterns, as parts of the load of all
        unit *= std.shape[-1] + 1
    return Cause(name, evidence / math.log(10), part * unit, part > ABSURD)
