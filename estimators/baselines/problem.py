"""The loss of Eq. problem over masses and frictions, on steady windows: what the baselines minimize."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.base import Estimate, weighed
from estimators.hidden_states.equations import FrictionEquations
from estimators.hidden_states.friction import closed_form
from estimators.hidden_states.masses import one_friction_masses
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.identifiability.report import Identifiability, identifiability
from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.particles.observe import HAS_HINGES, NO_DATA, NO_DRAG, ONE_BODY, observe
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads, WrenchModel
from estimators.posterior.on_table import OnTable
from estimators.posterior.scale import Weighing
from estimators.wrench.model import ModelErrors, ParticleModel, cross, inertia_of
from estimators.wrench.support import LOADS, SupportModel
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape, check_shape
from testbed.trajectory import Trajectory

STEP = 0.01
"""Step of the prediction [s], that of a 100 Hz record."""
ROUNDS = 2
"""Rounds in which the errors of the rows settle, as in Algorithm 1 before its last."""
LIKELY_FRICTION = 0.5
"""Friction at which errors are counted where M, and so the friction's level, is not known."""
FAR_OFF = 0.45
"""Part of the largest wrench, root mean square, above which a candidate explains no trial: a trial with its sign
turned leaves more. Ours. Eq. problem cannot show this, since it divides by mass: a heavy guess hides such trials."""
SLIDES = 1e-3
"""Turn rate below which a window is one of a slide [rad/s]."""
Weighting = Literal["velocity", "covariance"]


@dataclass(frozen=True, eq=False)
class SensedRows:
    """All six components that the sensor shows, of a gripper that carries nothing, and their errors."""

    model: WrenchModel
    read: Float[Tensor, "K 6"]
    """Components as measured, about the TCP, N and N m."""
    whiten: Float[Tensor, "6K 6K"]
    """Map of their residuals to unit variance, by the errors of sensor and model and the gripper's load."""


@dataclass(frozen=True, eq=False)
class Problem:
    """Data of a search: the windows of one object, and M if the search gets it."""

    shape: ObjectShape
    model: ParticleModel
    windows: Observations
    loads: AffineLoads
    wrenches: WrenchModel
    """Planar wrenches, with the gripper's measured load."""
    weight: float | None
    """M [kg], or None if the method does not get it."""
    errors: ModelErrors
    """Errors of the model on its support."""
    support: SupportModel
    draws: tuple[Problem, ...] = ()
    """Problems that this one stacks."""

    @staticmethod
    def of(
        shape: ObjectShape,
        weight: float | None,
        trajectories: Sequence[Trajectory],
        takes_links: bool = True,
        *,
        use_weight: bool,
        errors: ModelErrors,
        support: SupportModel = "own_weight",
    ) -> Problem | Estimate:
        """The problem, or an estimate with the reason for none; `errors` are those of the model on its `support`.

        Raises:
            InvalidValueError: `use_weight` without a weight.
        """
        known = weighed(shape, weight) if use_weight else None
        check_shape(shape)
        if shape.chain is not None and not takes_links:
            return Estimate(None, "assumption_violated", HAS_HINGES)
        if support != "rigid" and not shape.stands_in_groups:
            return Estimate(None, "assumption_violated", ONE_BODY)
        windows = observe(shape, trajectories, errors)
        if windows is None or bool(windows.accelerated.all()):
            return Estimate(None, "no_data", NO_DATA)
        if known is None and not windows.drag:
            return Estimate(None, "no_data", f"{NO_DRAG}: without M nothing shows the size of the masses")
        model = ParticleModel.of(shape)
        groups = LoadGroups.of(model)
        steady = windows.where(~windows.accelerated)
        rank = rank_of(groups.gather(steady.drag_rows(model, errors.pivot_error)).flatten(0, 1).numpy())
        if rank < len(groups.pairs):
            why = f"rank(Q) is {rank} and {len(groups.pairs)} friction loads are unknown: turn about more points"
            return Estimate(None, "underdetermined", why)
        loads = AffineLoads.of(shape, model, windows, LOADS[support])
        wrenches = WrenchModel.of(model, windows, loads, errors.pivot_error)
        return Problem(shape, model, windows, loads, wrenches, known, errors, support)

    @staticmethod
    def stacked(draws: Sequence[Problem]) -> Problem:
        """Problems of D draws of one object with the same `layout`, for `loss` at candidates (D, S, ...)."""
        return replace(
            draws[0],
            windows=Observations.stacked([draw.windows for draw in draws]),
            loads=AffineLoads.stacked([draw.loads for draw in draws]),
            wrenches=WrenchModel.stacked([draw.wrenches for draw in draws]),
            draws=tuple(draws),
        )

    @cached_property
    def sensed(self) -> SensedRows:
        """Rows of the loss weighted by covariance: those of Algorithm 1, about the most likely errors.

        On own weight they are about the masses that its friction loads give with one friction for all. A search
        predicts no torques about hinges.
        """
        if self.draws:
            each = [draw.sensed for draw in self.draws]
            stacked = WrenchModel.stacked([rows.model for rows in each])
            read, whiten = torch.stack([rows.read for rows in each]), torch.stack([rows.whiten for rows in each])
            return SensedRows(stacked, read[:, None], whiten)
        shape, windows, errors = self.shape, self.windows, self.errors
        mass = windows.drag / (LIKELY_FRICTION * GRAVITY) if self.weight is None else self.weight
        trials = TrialWindows.about(shape, mass, windows, errors)
        at, on_table = trials.first_guess(), OnTable.of(shape, windows, self.support, errors)
        for _ in range(ROUNDS if self.support == "own_weight" else 0):
            s = closed_form(trials.friction_system(at))
            if self.weight is not None:  # else the inertia of the guess is off as well
                trials = trials.about_errors(at, s)
            at = one_friction_masses(shape, mass, trials.groups.pairs, s)
        equations = FrictionEquations.about(on_table, mass, at, errors, trials.off)
        covariance = equations.covariance[:, :6, :, :6].flatten(0, 1).flatten(1)
        per_mass, inertial = on_table.table.windows["per_mass"], on_table.inertial_rows[:, :6]
        loads = AffineLoads(per_mass, torch.zeros_like(per_mass[..., 0]))
        found = WrenchModel.by_rows(self.model, inertial, equations.drag_rows[:, :6], loads)
        read = equations.missing[:, :6] + found.wrench(torch.tensor(at.mass), torch.tensor(at.friction))
        return SensedRows(found, read, torch.linalg.inv(torch.linalg.cholesky(covariance)))

    @property
    def layout(self) -> tuple[float, ...]:
        """Trial of each window, and the sign of its acceleration: problems with equal ones can be stacked."""
        w = self.windows
        return tuple([*w.trial.tolist(), *torch.where(w.accelerated, w.acceleration[:, 2].sign(), 2.0).tolist()])

    @property
    def per_group(self) -> Float[Tensor, "n_m"]:
        """Number of particles in each mass group."""
        return torch.tensor(self.shape.particles_per_group, dtype=torch.float64)

    @property
    def scale_known(self) -> bool:
        """True if M or an acceleration separates mass from friction."""
        return self.weight is not None or bool(self.windows.accelerated.any())

    def typical_mass(self, friction: Float[Tensor, "..."]) -> Float[Tensor, "..."]:
        """Mean particle mass [kg]: by M if known, else by the largest drag at that friction."""
        count = len(self.shape.particles)
        if self.weight is not None:
            return torch.full_like(friction, self.weight / count)
        return self.windows.drag / (friction * GRAVITY * count)

    def loss(
        self, mass: Float[Tensor, "... n_m"], friction: Float[Tensor, "... n_mu"], weighting: Weighting = "velocity"
    ) -> Float[Tensor, "..."]:
        """Mean over windows of |v_predicted - v_measured|^2 one step on (Eq. problem), or of the whitened error."""
        if weighting == "covariance":
            return self._whitened(mass, friction).square().mean(-1)
        along, spin = self._missing_acceleration(mass, friction)
        return STEP**2 * (along.square().sum(-1) + spin.square()).mean(-1)

    def unexplained(self, mass: Float[Tensor, "n_m"], friction: Float[Tensor, "n_mu"]) -> float:
        """Mean square of the wrench that is left, as a part of that of the largest force and torque.

        A fingertip has no torque, nor need a slide have one: both count their force at the object's reach.
        """
        wrench, straight = self.windows.wrench, self.windows.pushed | (self.windows.twist[:, 2].abs() < SLIDES)
        force, torque = wrench[:, :2].norm(dim=1).max(), wrench[:, 2].abs().max()
        if straight.any():
            torque = torch.maximum(torque, self.model.reach * wrench[straight, :2].norm(dim=1).max())
        missing = (wrench - self.wrenches.wrench(mass, friction)) / torch.stack([force, force, torque])
        return float(missing.square().mean())

    def residuals(
        self, mass: Float[Tensor, "n_m"], friction: Float[Tensor, "n_mu"], weighting: Weighting
    ) -> Float[Tensor, "R"]:
        """Residuals whose squares sum to `loss`."""
        if weighting == "covariance":
            return self._whitened(mass, friction) / math.sqrt(len(self.sensed.whiten))
        along, spin = self._missing_acceleration(mass, friction)
        return STEP / math.sqrt(len(self.windows)) * torch.cat([along.flatten(), spin])

    def report(self, at: MassDistribution) -> Identifiability:
        """Masses and frictions that whitened wrenches, and the weight where it is known, show at an answer."""
        slopes = torch.autograd.functional.jacobian(self._whitened, (torch.tensor(at.mass), torch.tensor(at.friction)))
        rows = torch.cat(slopes, 1).numpy()
        if self.weight is not None:
            weighing = Weighing.of(self.shape, ModelErrors.weight_error, self.windows.setup)
            rows = np.vstack([rows, weighing.row(rows.shape[1])])
        return identifiability(self.shape, at, rows)

    def _whitened(self, mass: Tensor, friction: Tensor) -> Float[Tensor, "... 6K"]:
        """Residuals of all six components in units of their errors."""
        rows = self.sensed
        return (rows.read - rows.model.wrench(mass, friction)).flatten(-2) @ rows.whiten.mT

    def _missing_acceleration(self, mass: Tensor, friction: Tensor) -> tuple[Tensor, Tensor]:
        """Acceleration of the center of mass and of the turn by the missing wrench, shapes (..., K, 2) and (..., K)."""
        missing = self.windows.wrench - self.wrenches.wrench(mass, friction)
        inertia = inertia_of(self.model, self.model.particle_mass(mass))
        arm = inertia.com[..., None, :] - self.windows.grasp
        spin = (missing[..., 2] - cross(arm, missing[..., :2])) / inertia.about_com[..., None]
        return missing[..., :2] / inertia.mass[..., None, None], spin
