"""Windows of trials for Algorithm 1, with the gripper's load on the object taken off them at a guess of the masses.

The paper's gripper carries nothing. A real one presses or lifts a little, which changes the loads on the table and with
them friction. The change follows from the measured lift and tilt, but also from mass and friction themselves: the
estimator takes them from the round before.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Self

import numpy as np
import torch
from jaxtyping import Float

from estimators.base import Estimate, robot_seconds
from estimators.hidden_states.masses import friction_loads
from estimators.particles.errors import ModelErrors
from estimators.particles.friction_system import (
    FrictionEquations,
    LinearSystem,
    LoadGroups,
    friction_equations,
    torque_covariance,
)
from estimators.particles.misfit import Misfit, likely_causes, misfit_of
from estimators.particles.model import ParticleModel, friction_wrench, inertia_of
from estimators.particles.pivots import PivotInertia, pivot_inertias
from estimators.particles.support import own_weight
from estimators.particles.windows import Observations, observe
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
    steady: Observations
    """Windows of constant speed."""
    accelerated: Observations
    """Windows of constant acceleration."""
    robot_seconds: float
    """Robot time that the trials took, s."""

    @classmethod
    def of(
        cls, shape: ObjectShape, weight: float, trajectories: Sequence[Trajectory], errors: ModelErrors
    ) -> TrialWindows | None:
        """Windows of some trajectories; None where none slides or turns at constant speed."""
        windows = observe(shape, trajectories, errors)
        if windows is None or bool(windows.accelerated.all()):
            return None
        model, steady = ParticleModel.of(shape), windows.where(~windows.accelerated)
        accelerated, seconds = windows.where(windows.accelerated), robot_seconds(trajectories)
        errors = replace(errors, weight_error=math.hypot(errors.weight_error, windows.setup.scale))
        return TrialWindows(shape, weight, errors, model, LoadGroups.of(model), steady, accelerated, seconds)

    def first_guess(self) -> MassDistribution:
        """Uniform mass, as Algorithm 1 starts, and the largest drag over the weight, a lower bound of friction."""
        mass = np.full(self.shape.n_m, self.weight / len(self.shape.particles))
        return MassDistribution(mass, np.full(self.shape.n_mu, self.steady.drag / (self.weight * GRAVITY)))

    def friction_loads(self, at: MassDistribution) -> Float[np.ndarray, "n_s"]:
        """s under given masses and frictions, N."""
        return friction_loads(self.shape, self.groups.pairs, at)

    def friction_equations(self, guess: MassDistribution, windows: Observations | None = None) -> FrictionEquations:
        """Q s = b of the steady windows, or of others in their place, in N and N m."""
        mass = self.model.particle_mass(torch.tensor(guess.mass))
        friction = self.model.particle_friction(torch.tensor(guess.friction))
        windows = self.steady if windows is None else windows
        return friction_equations(self.model, self.groups, windows, mass, friction, self.shape.height, self.errors)

    def friction_system(self, guess: MassDistribution) -> LinearSystem:
        """Q s = b, whitened."""
        return self.friction_equations(guess).whitened()

    def pivot_inertias(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> PivotInertia | None:
        """I_j, the torques less friction at s and less its change with the gripper's load; None without a turn."""
        windows, model = self.accelerated, self.model
        if len(windows) == 0:
            return None
        mass = model.particle_mass(torch.tensor(guess.mass))
        friction = model.particle_friction(torch.tensor(guess.friction))
        inertia = inertia_of(model, mass)
        load = windows.gripper_load(inertia, self.shape.height)
        support = own_weight(model, mass, load)
        drag = self.groups.spread(s) + friction * (support.lean + support.change(load))
        torque = -friction_wrench(drag, windows.drag_directions(model), windows.lever(model))[:, 2]
        inertial = windows.inertial_wrench(inertia)[:, 2]
        response = windows.drag_rows(model, 0.0) @ (friction[:, None] * support.response)
        covariance = torque_covariance(windows, model, mass, drag.clamp(min=0).expand(len(windows), -1), response)
        return pivot_inertias(windows, torque.numpy(), inertial.numpy(), self.errors.inertia_error, covariance)

    def misfit(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"], *, always: bool = False) -> Misfit:
        """How far the wrenches of s are from the measured ones, and why; `always` says why of a small misfit too."""
        return self._misfit(self.steady, guess, s, len(s), always=always)

    def _misfit(
        self,
        windows: Observations,
        guess: MassDistribution,
        s: Float[np.ndarray, "n_s"],
        unknowns: int,
        *,
        always: bool,
    ) -> Misfit:
        """Misfit in given windows."""
        causes = partial(likely_causes, windows, self.model, self.shape, guess, self.groups.spread(s), self.errors)
        equations = self.friction_equations(guess, windows)
        return misfit_of(equations, s, windows.trial, causes, unknowns, always=always)

    def refined(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> Self:
        """The trials for the next round; the same where nothing of the setup is unknown."""
        del guess, s
        return self

    def annotated(self, estimate: Estimate, s: Float[np.ndarray, "n_s"]) -> Estimate:
        """The estimate with what was found of the setup; the same where nothing of it is unknown."""
        del s
        return estimate
