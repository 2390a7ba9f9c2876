"""Windows of trials for Algorithm 1, with the gripper's load on the object taken off them at a guess of the masses.

The paper's gripper carries nothing. A real one presses or lifts a little, which changes the loads on the table and with
them friction. The change follows from the measured lift and tilt, but also from mass and friction themselves: the
estimator takes them from the round before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from estimators.base import robot_seconds
from estimators.hidden_states.masses import friction_loads
from estimators.particles.friction_system import (
    FrictionEquations,
    LinearSystem,
    LoadGroups,
    compliance_variance,
    friction_equations,
    linear_rows,
    unknown_motion,
)
from estimators.particles.misfit import Misfit, misfit_of
from estimators.particles.observe import observe
from estimators.particles.pivots import PivotInertia, corrected_inertias
from estimators.particles.setup_effects import LinearRows
from estimators.particles.windows import Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import own_weight
from estimators.wrench.weighing import Weighing
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TrialWindows:
    """Windows of one object's trials, sorted by whether they accelerate."""

    shape: ObjectShape
    weight: float
    """M, kg."""
    errors: ModelErrors
    model: ParticleModel
    groups: LoadGroups
    """G_s."""
    windows: Observations
    """All windows: friction shows in each."""
    accelerated: Observations
    """Windows of constant acceleration: I_j shows in these."""
    robot_seconds: float
    """Robot time that the trials took, s."""
    _linear: dict[tuple[object, object], LinearRows] = field(default_factory=dict, init=False, repr=False)

    @classmethod
    def of(
        cls, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], errors: ModelErrors
    ) -> TrialWindows | None:
        """Windows of some trajectories; None where none slides or turns at constant speed."""
        windows = observe(shape, trajectories, errors)
        if windows is None or bool(windows.accelerated.all()):
            return None
        return TrialWindows.about(shape, weight, windows, errors, robot_seconds(trajectories))

    @staticmethod
    def about(
        shape: ObjectShape, weight: float, windows: Observations, errors: ModelErrors, seconds: float = 0.0
    ) -> TrialWindows:
        """Windows that are there, some of them at constant speed; `seconds` of the robot."""
        model, accelerated = ParticleModel.of(shape), windows.where(windows.accelerated)
        return TrialWindows(shape, weight, errors, model, LoadGroups.of(model), windows, accelerated, seconds)

    @property
    def weighing(self) -> Weighing:
        """The scale that read M."""
        return Weighing.of(self.shape, self.errors.weight_error, self.windows.setup)

    @property
    def steady(self) -> Observations:
        """Windows of constant speed."""
        return self.windows.where(~self.windows.accelerated)

    def first_guess(self) -> MassDistribution:
        """Uniform mass, as Algorithm 1 starts, and the largest drag over the weight, a lower bound of friction."""
        mass = np.full(self.shape.n_m, self.weight / len(self.shape.particles))
        return MassDistribution(mass, np.full(self.shape.n_mu, self.windows.drag / (self.weight * GRAVITY)))

    def friction_loads(self, at: MassDistribution) -> Float[np.ndarray, "n_s"]:
        """s under given masses and frictions, N."""
        return friction_loads(self.shape, self.groups.pairs, at)

    def friction_equations(
        self, guess: MassDistribution, windows: Observations | None = None, linear: LinearRows | None = None
    ) -> FrictionEquations:
        """Q s = b of all windows, or of others in their place, in N and N m; whatever c and I_j may be."""
        windows = self.windows if windows is None else windows
        at, linear = self._particles(guess), linear or self.linear_rows(guess, windows)
        found = friction_equations(self.model, self.groups, windows, *at, self.shape.height, self.errors, linear)
        drag = self.groups.spread(self.friction_loads(guess)).clamp(min=0)
        table, more = windows.table(self.model, self.errors.pivot_error), len(found.b) - 3 * len(windows)
        own = found.apart + pad(compliance_variance(windows, table, drag), (0, more)).diag()
        moved = pad(unknown_motion(windows, self.model, self.weight), (0, 0, 0, more))
        return replace(found, apart=own, common=torch.cat([found.common, moved], 1))

    def _particles(self, at: MassDistribution) -> tuple[Float[Tensor, "P"], Float[Tensor, "P"]]:
        """Mass of every particle, kg, and its friction coefficient."""
        mass, friction = torch.tensor(at.mass), torch.tensor(at.friction)
        return self.model.particle_mass(mass), self.model.particle_friction(friction)

    def linear_rows(self, guess: MassDistribution, windows: Observations) -> LinearRows:
        """Rows of some windows as functions of everything that may err; of one guess they are worked out once."""
        asked = guess, windows
        if asked not in self._linear:
            self._linear.clear()
            at = self._particles(guess)
            self._linear[asked] = linear_rows(windows, self.model, *at, self.errors)
        return self._linear[asked]

    def turning(self, guess: MassDistribution) -> LinearRows:
        """Rows of the accelerated windows."""
        return self.linear_rows(guess, self.windows).where(self.windows.accelerated)

    def friction_system(self, guess: MassDistribution) -> LinearSystem:
        """Q s = b, whitened."""
        return self.friction_equations(guess).whitened()

    def pivot_inertias(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> PivotInertia | None:
        """I_j, the torques less friction at s and less its change with the gripper's load; None without a turn."""
        windows, model = self.accelerated, self.model
        if len(windows) == 0:
            return None
        (mass, friction), linear = self._particles(guess), self.turning(guess)
        load = windows.gripper_load(linear.lever, linear.motion(mass), self.shape.height)
        support = own_weight(model, mass, load)
        drag = self.groups.spread(s) + friction * (support.lean + support.change(load))
        response = linear.by_particle @ (friction[:, None] * support.response)
        return corrected_inertias(windows, linear, mass, drag, response, self.errors.inertia_error)

    def misfit(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> Misfit:
        """Misfit of friction loads s, N.

        Of friction in all windows, or in those of constant speed where it is larger, since windows of acceleration are
        many and alike; then of inertia.
        """
        linear, at_one_speed = self.linear_rows(guess, self.windows), ~self.windows.accelerated
        found = misfit_of(self.friction_equations(guess, self.windows, linear), s, len(s))
        if not bool(at_one_speed.all()):
            rows = self.friction_equations(guess, self.steady, linear.where(at_one_speed))
            found = max(found, misfit_of(rows, s, len(s)), key=lambda misfit: misfit.widening)
        return found.or_of_inertia(self.shape, self.pivot_inertias(guess, s), guess)
