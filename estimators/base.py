"""What an estimator is given and what it answers; what a policy chooses. Two protocols, one value."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from estimators.identifiability.report import Identifiability
from testbed.actions.base import Action
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import frozen_array

EstimateStatus = Literal["ok", "underdetermined", "not_converged", "contradictory", "no_data", "assumption_violated"]
"""Whether there is an answer, or what keeps it from being one.

* `underdetermined`: the trials leave something open.
* `not_converged`: the best that was found does not explain them.
* `contradictory`: nothing does.
* `no_data`: no trial is usable.
* `assumption_violated`: the mass groups do not rest on their own weight.
"""


@dataclass(frozen=True, eq=False)
class HiddenStateEstimate:
    """H of the paper: what the wrench shows before it is split into mass and friction."""

    mass: float
    """M, kg."""
    inertia_cm: float
    """I_cm, kg m^2; NaN where no accelerated turn was given."""
    center_of_mass: Float[np.ndarray, "2"]
    """c, m, object frame; NaN in a component that is not observed."""
    friction_load: Float[np.ndarray, "n_s"]
    """s = mu m g of one particle of each (mass group, friction group) in contact, N."""
    groups: tuple[tuple[int, int], ...]
    """Mass group and friction group of each entry of `friction_load`."""
    unobserved: str = ""
    """What the trajectories do not show, in words; empty where all is observed."""


@dataclass(frozen=True, eq=False)
class Trace:
    """How an iterative method came to its answer: I iterations."""

    method: str
    """Optimiser, or the search itself."""
    loss: tuple[float, ...]
    """Loss at each iteration."""
    seconds: tuple[float, ...]
    """Wall time up to the end of each iteration, s."""
    robot_seconds: float
    """Robot time that the data took, s."""
    mass: Float[np.ndarray, "I n_m"]
    """Particle masses at each iteration, kg; (0, 0) where the method has none on its way."""


@dataclass(frozen=True, eq=False)
class Estimate:
    """An estimator's answer."""

    distribution: MassDistribution | None
    """Mass and friction; None where status says there is no answer."""
    status: EstimateStatus
    """ok, or why there is none or only part of one."""
    message: str = ""
    """A sentence where status is not ok."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Of the particle masses, kg^2, infinite where they are not observed; None where the method gives none."""
    identifiability: Identifiability | None = None
    """What the trajectories show and leave open, for methods that say so."""
    hidden: HiddenStateEstimate | None = None
    """Hidden states, for methods that have them."""
    traces: tuple[Trace, ...] = ()
    """One a run of an optimiser."""
    seconds: float = 0.0
    """Wall time of the whole estimate, s."""
    diagnostics: dict[str, float] = field(default_factory=dict)
    """Method-specific numbers: residuals, ranks, conditioning."""

    def __post_init__(self) -> None:
        if self.covariance is not None:
            n = len(self.covariance)
            object.__setattr__(
                self, "covariance", frozen_array("Estimate.covariance", self.covariance, (n, n), finite=False)
            )


@runtime_checkable
class Estimator(Protocol):
    """Turns trajectories into a mass distribution. Frozen configuration; keeps no state between calls."""

    def estimate(
        self, shape: ObjectShape, weight: float | None, trajectories: Sequence[Trajectory], seed: int
    ) -> Estimate:
        """Estimate mass and friction.

        Args:
            shape: geometry and groups; never the truth.
            weight: M as weighed, kg, or None.
            trajectories: what was felt.
            seed: for methods that draw.
        """
        ...


@runtime_checkable
class ActionPolicy(Protocol):
    """Chooses what to do next. Frozen configuration."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """The next action, or None when there is nothing more worth doing."""
        ...
