"""Estimates of an object's trials, and their distance from the truth."""

from __future__ import annotations

from collections.abc import Sequence

from estimators.base import Estimate, Estimator
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.trajectory import Trajectory


def ask(obj: ObjectModel, trajectories: Sequence[Trajectory], method: Estimator | None = None) -> Estimate:
    """Estimate of `method`, or of Algorithm 1, from trials and the true weight."""
    return (method or HiddenStates()).estimate(obj.shape, obj.total_mass, trajectories, 0)


def found(answer: Estimate) -> MassDistribution:
    """Masses and frictions of an estimate that has them."""
    assert answer.distribution is not None, answer.message
    return answer.distribution


def nad(obj: ObjectModel, answer: Estimate) -> float:
    """NAD of an estimate that has masses."""
    return normalized_absolute_difference(obj.shape, found(answer), obj.truth)
