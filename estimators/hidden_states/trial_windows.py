"""Windows of trials for Algorithm 1, with its linear systems about a guess of the masses.

The paper's gripper carries no load. A real gripper presses or lifts slightly, which changes the loads on the table and
friction with them; the estimator corrects for it by the masses and frictions of the round before.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import one_hot

from estimators.base import robot_seconds
from estimators.hidden_states.equations import FrictionEquations, LinearSystem
from estimators.hidden_states.inertia import pivot_inertias
from estimators.hidden_states.masses import PivotInertia, friction_loads, inertia_map
from estimators.particles.load_groups import LoadGroups
from estimators.particles.misfit import Misfit
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.posterior.on_table import OnTable
from estimators.posterior.scale import Weighing
from estimators.posterior.table_errors import rows_of_planar
from estimators.wrench.jacobian import Theta
from estimators.wrench.model import ModelErrors, ParticleModel, inertia_of
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class TrialWindows:
    """Windows of one object's trials."""

    shape: ObjectShape
    weight: float
    """M, kg."""
    errors: ModelErrors
    model: ParticleModel
    groups: LoadGroups
    """G_s."""
    windows: Observations
    """All windows: each shows friction, those of constant acceleration also I_j."""
    robot_seconds: float
    """Robot time that the trials took, s."""
    off: Theta | None = None
    """Guess of the stated errors, each in its own unit; None before the first answer."""
    _equations: dict[MassDistribution, FrictionEquations] = field(default_factory=dict, init=False, repr=False)

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
        """Trials of given windows, some of them at constant speed; `seconds` is their robot time, s."""
        model = ParticleModel.of(shape)
        return TrialWindows(shape, weight, errors, model, LoadGroups.of(model), windows, seconds)

    @property
    def weighing(self) -> Weighing:
        """The scale that read M."""
        return Weighing.of(self.shape, self.errors.weight_error, self.windows.setup)

    @cached_property
    def steady(self) -> Observations:
        """Windows of constant speed."""
        return self.windows.where(~self.windows.accelerated)

    @cached_property
    def accelerated(self) -> Observations:
        """Windows of constant acceleration."""
        return self.windows.where(self.windows.accelerated)

    def first_guess(self) -> MassDistribution:
        """Uniform mass, as Algorithm 1 starts, and the largest drag over the weight, a lower bound of friction."""
        mass = np.full(self.shape.n_m, self.weight / len(self.shape.particles))
        return MassDistribution(mass, np.full(self.shape.n_mu, self.windows.drag / (self.weight * GRAVITY)))

    def friction_loads(self, at: MassDistribution) -> Float[np.ndarray, "n_s"]:
        """s under given masses and frictions, N."""
        return friction_loads(self.shape, self.groups.pairs, at)

    @property
    def on_table(self) -> OnTable:
        """Windows as measurements of the joint posterior, without errors of I_j, which `pivot_inertias` adds."""
        return _on_table(self.shape, self.windows, replace(self.errors, inertia_error=0.0))

    def friction_equations(self, guess: MassDistribution) -> FrictionEquations:
        """Q s = b of all windows in N and N m, with c and I_j unknown; the last guess's are cached."""
        if guess not in self._equations:
            self._equations.clear()
            found = FrictionEquations.about(self.on_table, self.weight, guess, self.on_table.errors, self.off)
            self._equations[guess] = replace(found, wide=found.wide | self._unknown_inertia())
        return self._equations[guess]

    def _unknown_inertia(self) -> dict[str, Float[Tensor, "K r n"]]:
        """Effects of c and each I_j on accelerated windows, one standard deviation by the object's weight and reach."""
        windows = self.windows
        if not bool(windows.accelerated.any()):
            return {}
        alpha, squared = windows.acceleration[:, 2] * windows.accelerated, windows.spin_square * windows.accelerated
        reach = float((self.model.particles - windows.grasp[:, None]).norm(dim=-1).max())
        along = torch.stack([torch.stack([-squared, -alpha], 1), torch.stack([alpha, -squared], 1)], 1)
        pivots, index = torch.unique(windows.grasp.round(decimals=9), dim=0, return_inverse=True)
        about = one_hot(index, len(pivots))[:, None] * alpha[:, None, None]
        # the mass acts at half the object's height
        to_rows = rows_of_planar(windows.load_map[:, 1, 0] - self.shape.height / 2, windows.hinges)
        center, inertia = to_rows[..., :2] @ along, to_rows[..., 2:3] @ about
        return {"center": self.weight * reach * center, "inertia": self.weight * reach**2 * inertia}

    def about_errors(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> TrialWindows:
        """Trials with rows linearized about the most likely errors at friction loads s, N."""
        return replace(self, off=self.friction_equations(guess).likely_errors(s))

    def friction_system(self, guess: MassDistribution) -> LinearSystem:
        """Q s = b, whitened."""
        return self.friction_equations(guess).whitened()

    def pivot_inertias(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> PivotInertia | None:
        """I_j by torques less friction at loads s, N; None without an accelerated turn."""
        if not bool(self.windows.accelerated.any()):
            return None
        inertia = inertia_of(self.model, self.model.particle_mass(torch.tensor(guess.mass)))
        return pivot_inertias(self.friction_equations(guess), self.windows, s, inertia, self.errors.inertia_error)

    def misfit(self, guess: MassDistribution, s: Float[np.ndarray, "n_s"]) -> Misfit:
        """Misfit of friction loads s, N.

        The larger of those of friction in all windows and in windows of constant speed, since accelerated windows are
        many and alike; and, where friction explains the windows, of inertia if it is larger.
        """
        equations, at_one_speed = self.friction_equations(guess), ~self.windows.accelerated
        found = equations.whitened().misfit(s)
        if not bool(at_one_speed.all()):
            found = max(found, equations.where(at_one_speed).whitened().misfit(s), key=lambda misfit: misfit.widening)
        pivots = self.pivot_inertias(guess, s)
        if pivots is None or not found.explains:
            return found
        has = inertia_map(self.shape, pivots.pivot) @ guess.mass
        missing, weights = pivots.inertia - has, np.linalg.solve(pivots.covariance, has)
        value = float(missing @ np.linalg.solve(pivots.covariance, missing)) / len(has)
        inertia = float(weights @ pivots.inertia / (weights @ has))
        of_inertia = replace(found, value=value, freedom=len(has), inertia=inertia)
        return of_inertia if of_inertia.widening > found.widening else found


@lru_cache(maxsize=1)
def _on_table(shape: ObjectShape, windows: Observations, errors: ModelErrors) -> OnTable:
    """Windows as measurements, cached for all rounds of an estimate."""
    return OnTable.of(shape, windows, "own_weight", errors)
