"""Fit of friction and masses under one support model.

Both models, every group on its own weight and one rigid body, give loads that are affine in the masses, so the wrench
is bilinear in friction and mass: one fit serves both, with the same data and the same stated errors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import block_diag
from scipy.optimize import nnls
from torch import Tensor

from estimators.particles.friction_system import wrench_errors
from estimators.particles.lifts import LiftedRows, lifted_rows
from estimators.particles.misfit import Misfit
from estimators.particles.pivots import PivotInertia, corrected_inertias, inertia_map
from estimators.particles.setup_effects import LinearRows
from estimators.particles.windows import Observations
from estimators.particles.wrench import AffineLoads, WrenchModel
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import LOADS, Support, SupportModel, contact_spread
from estimators.wrench.weighing import Weighing
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape

ROUNDS = 6
"""Most rounds of Gauss-Newton: friction is tight from the first on."""
WEIGHED = 3
"""Rounds in which the errors are worked out anew: they hardly depend on the masses."""
SETTLED = 1e-6
"""Change of a friction or a mass, as a part of it, from which on no round follows."""
FRICTION_PRIOR = 1.0
"""Standard deviation of every friction coefficient beforehand; so wide that it decides nothing."""


@dataclass(frozen=True, eq=False)
class SupportFit:
    """Wrenches linear in (friction, mass) about a support model's best fit, whitened: R = 3 K rows of unit error."""

    support: SupportModel
    friction: Float[np.ndarray, "n_mu"]
    mass: Float[np.ndarray, "n_m"]
    """Particle masses, kg; under one rigid body only their M, c and I_cm are known."""
    of_friction: Float[np.ndarray, "R n_mu"]
    of_mass: Float[np.ndarray, "R n_m"]
    wider: Float[np.ndarray, "R w"]
    """Effect of loads outside this support model: on own weight those rising along x or y, else each group's own."""
    target: Float[np.ndarray, "R"]
    """Measured value of of_friction friction + of_mass mass."""
    log_volume: float
    """Half the log determinant of the wrenches' covariance."""
    pivots: PivotInertia | None
    """I_j, with friction's change taken away as this support has it."""
    known: Float[np.ndarray, "1+J+L n_m"]
    """Rows of the weight, of each I_j and of all lifts, in units of their errors."""
    known_target: Float[np.ndarray, "1+J+L"]
    known_log_volume: float

    @property
    def moments(self) -> slice:
        """Rows of `known` for the I_j."""
        return slice(1, 1 if self.pivots is None else 1 + len(self.pivots.inertia))

    @property
    def squares(self) -> float:
        """Squared residual of the wrenches, R where the model holds."""
        missing = self.target - self.of_friction @ self.friction - self.of_mass @ self.mass
        return float(missing @ missing)

    @property
    def misfit(self) -> Misfit:
        """How far the wrenches of friction and mass are from the measured ones."""
        unknown = np.linalg.matrix_rank(np.hstack([self.of_friction, self.of_mass]), rtol=1e-6)
        freedom = len(self.target) - int(unknown)
        return Misfit(self.squares / max(freedom, 1), freedom)

    def on_mass(self) -> tuple[Float[np.ndarray, "r n_m"], Float[np.ndarray, "r"]]:
        """Equations of the masses, friction eliminated: rows a with a m = y, independent and of unit error.

        The first row is the surest; r is n_m where every mass is known, and 4 at most under one rigid
        body, or 6 with lifts. Errors of wrenches are as wide as their misfit.
        """
        q, _ = np.linalg.qr(self.of_friction)
        both = np.column_stack([self.of_mass, self.target]) / np.sqrt(self.misfit.widening)
        free = both - q @ (q.T @ both)
        rows = np.vstack([free[:, :-1], self.known])
        values = np.concatenate([free[:, -1], self.known_target])
        left, strength, right = np.linalg.svd(rows, full_matrices=False)
        kept = strength > 1e-6 * strength[0]
        return strength[kept, None] * right[kept], left[:, kept].T @ values

    def log_evidence(self, mean: Float[np.ndarray, "n_m"], covariance: Float[np.ndarray, "n_m n_m"]) -> float:
        """Log of the data's probability density, exact for Gaussian masses and wide Gaussian friction beforehand."""
        n_mu, n_m = len(self.friction), len(self.mass)
        design = np.zeros((len(self.target) + len(self.known), n_mu + n_m))
        design[: len(self.target)] = np.hstack([self.of_friction, self.of_mass])
        design[len(self.target) :, n_mu:] = self.known
        values = np.concatenate([self.target, self.known_target])
        root = np.zeros((n_mu + n_m, n_mu + n_m))
        root[:n_mu, :n_mu] = FRICTION_PRIOR * np.eye(n_mu)
        scale, axes = np.linalg.eigh(covariance)
        root[n_mu:, n_mu:] = axes * np.sqrt(np.maximum(scale, 0.0))
        missing = values - design @ np.concatenate([self.friction, mean])
        spread = design @ root
        inner = np.eye(n_mu + n_m) + spread.T @ spread
        explained = spread.T @ missing
        chi = missing @ missing - explained @ np.linalg.solve(inner, explained)
        volume = np.linalg.slogdet(inner)[1] / 2 + self.log_volume + self.known_log_volume
        return float(-chi / 2 - volume)


def fit_support(
    shape: ObjectShape,
    weight: float,
    observed: Observations,
    support: SupportModel,
    errors: ModelErrors,
    lifted: LiftedRows | None = None,
    *,
    spread_known: bool = True,
    at: MassDistribution | None = None,
) -> SupportFit:
    """Fit friction and masses under one support model, by Gauss-Newton with neither negative.

    Args:
        shape: geometry and groups.
        weight: M, kg.
        observed: windows of constant speed, and of constant acceleration where there are any.
        support: support model.
        errors: errors of the model.
        lifted: equations of lifts, which hold under either support.
        spread_known: True if the gripper's lift and moment spread over the feet as in this model; else as in either
            model, or between: then that spread tells nothing.
        at: masses and frictions to take as they are, in place of the best.
    """
    lifted = lifted or lifted_rows(shape, weight, [])
    model = ParticleModel.of(shape)
    steady, accelerated = observed.where(~observed.accelerated), observed.where(observed.accelerated)
    mass = np.full(shape.n_m, weight / len(shape.particles))
    friction = np.full(shape.n_mu, steady.drag / (weight * GRAVITY))
    if at is not None:
        mass, friction = at.mass, at.friction
    table = observed.table(model, errors.pivot_error)
    loads = AffineLoads.of(shape, model, observed, LOADS[support])
    other = support if spread_known else next(name for name in LOADS if name != support)
    responses = [Support.of(name, model, table.lever, observed.held).response for name in (support, other)]
    response, elsewhere = (each[~observed.accelerated] for each in responses)
    swung = [each[observed.accelerated] for each in responses]
    wrenches = WrenchModel.of(model, steady, loads.where(~observed.accelerated), errors.pivot_error)
    unsure = 0.0 if spread_known else 1.0
    (weak, even), n_mu = _weak_prior(shape, weight), shape.n_mu
    fit: SupportFit | None = None
    every: LinearRows | None = None
    for index in range(ROUNDS):
        at_mass, at_friction = torch.tensor(mass), torch.tensor(friction)
        particle_mass, rough = model.particle_mass(at_mass), model.particle_friction(at_friction)
        pushed = rough * loads.at(at_mass)
        if every is None or index < WEIGHED:
            every = LinearRows.of(observed, table, particle_mass, pushed, errors.lead_error, observed.setup)
        linear = every.where(~observed.accelerated)
        rows = linear.by_particle
        carried, otherwise = rows @ (rough[:, None] * response), rows @ (rough[:, None] * elsewhere)
        apart, common = wrench_errors(steady, linear, carried, errors)
        pressing = steady.gripper_load(linear.lever, linear.motion(particle_mass), shape.height).carried
        spread = unsure * ((otherwise - carried) * pressing[:, None]).flatten(0, 1)
        moved = _moved(rows, model, at_mass, at_friction, support).flatten(0, 1)
        root = torch.linalg.cholesky(apart + common @ common.T + spread @ spread.T + moved @ moved.T)
        whiten = torch.linalg.inv(root)
        of_friction = (wrenches.weighed @ at_mass + wrenches.carried).flatten(1).T
        of_mass = (wrenches.inertial + torch.einsum("k,kwim->wim", at_friction, wrenches.weighed)).flatten(0, 1)
        off = steady.wrench - wrenches.wrench(at_mass, at_friction)
        target = off.flatten() + of_friction @ at_friction + of_mass @ at_mass
        excluded = rough[:, None] * _excluded(model, support)
        pivots = _pivots(
            every.where(observed.accelerated), shape, accelerated, at_mass, at_friction, support, swung, unsure, errors
        )
        known, known_target, known_volume = _known(
            shape, weight, pivots, Weighing.of(shape, errors.weight_error, observed.setup), lifted
        )
        fit = SupportFit(
            support,
            friction,
            mass,
            (whiten @ of_friction).numpy(),
            (whiten @ of_mass).numpy(),
            (whiten @ (rows @ excluded).flatten(0, 1)).numpy(),
            (whiten @ target).numpy(),
            float(torch.log(torch.diagonal(root)).sum()),
            pivots,
            known,
            known_target,
            known_volume,
        )
        if at is not None:
            return fit
        below = np.vstack([known, weak])
        system = np.block([[fit.of_friction, fit.of_mass], [np.zeros((len(below), n_mu)), below]])
        solved, _ = nnls(system, np.concatenate([fit.target, known_target, even]))
        settled = np.allclose(solved, np.concatenate([friction, mass]), rtol=SETTLED, atol=SETTLED * mass.max())
        friction, mass = solved[:n_mu], solved[n_mu:]
        if settled:
            break
    assert fit is not None
    return replace(fit, friction=friction, mass=mass)


def prior_masses(shape: ObjectShape, weight: float) -> tuple[Float[np.ndarray, "n_m"], Float[np.ndarray, "n_m n_m"]]:
    """Mean and covariance of particle masses before any trial, where all ways to share M are as likely.

    Shares of a Dirichlet distribution, in proportion to the groups' sizes: for blocks of one size it is even over the
    simplex.
    """
    count = shape.particles_per_group
    part = count / count.sum()
    covariance = (np.diag(part) - np.outer(part, part)) / (shape.n_m + 1)
    return weight * part / count, weight**2 * covariance / np.outer(count, count)


def _moved(
    rows: Float[Tensor, "K 3 P"], model: ParticleModel, mass: Tensor, friction: Tensor, support: SupportModel
) -> Float[Tensor, "K 3 w"]:
    """Change of the wrenches with the loads that a rigid body on more than three points leaves open."""
    if support == "own_weight":
        return torch.zeros(*rows.shape[:2], 0, dtype=torch.float64)
    return rows @ (model.particle_friction(friction)[:, None] * contact_spread(model, model.particle_mass(mass)))


def _weak_prior(shape: ObjectShape, weight: float) -> tuple[np.ndarray, np.ndarray]:
    """Rows that draw an unknown mass to the mean, and change no other noticeably."""
    mean, covariance = prior_masses(shape, weight)
    rows = np.diag(0.1 / np.sqrt(np.maximum(np.diag(covariance), (1e-3 * mean) ** 2)))
    return rows, rows @ mean


def _excluded(model: ParticleModel, support: SupportModel) -> Float[Tensor, "P w"]:
    """Loads that a support model excludes, and the other allows."""
    if support == "own_weight":
        return model.particles - model.particles.mean(0)
    return torch.nn.functional.one_hot(model.mass_group).double()


def _pivots(
    linear: LinearRows,
    shape: ObjectShape,
    windows: Observations,
    mass: Tensor,
    friction: Tensor,
    support: SupportModel,
    responses: Sequence[Float[Tensor, "K P 3"]],
    unsure: float,
    errors: ModelErrors,
) -> PivotInertia | None:
    """I_j less the change of friction with the gripper's load; `responses` are by this support model and the other."""
    if len(windows) == 0:
        return None
    model, particle_mass, rows = linear.model, linear.model.particle_mass(mass), linear.by_particle
    load = windows.gripper_load(linear.lever, linear.motion(particle_mass), shape.height)
    drag = model.particle_friction(friction) * LOADS[support](model, particle_mass, load)
    response, otherwise = (rows @ model.particle_friction(friction).diag() @ each for each in responses)
    spread = unsure * ((otherwise - response)[:, 2] * load.carried).numpy()
    swayed = _moved(rows, model, mass, friction, support)[:, 2].numpy()
    more = spread @ spread.T + swayed @ swayed.T
    return corrected_inertias(windows, linear, particle_mass, drag, response, errors.inertia_error, more)


def _known(
    shape: ObjectShape, weight: float, pivots: PivotInertia | None, weighing: Weighing, lifted: LiftedRows
) -> tuple[np.ndarray, np.ndarray, float]:
    """Rows of the weight, of the inertia about every pivot and of lifts, their values, and half their log volume.

    All whitened; the lifts' volume is left out, being the same whoever carries the weight.
    """
    rows, values, covariance = weighing.count[None], np.array([weight]), np.array([[weighing.error**2]])
    if pivots is not None:
        rows = np.vstack([rows, inertia_map(shape, pivots.pivot)])
        values = np.append(values, pivots.inertia)
        covariance = np.asarray(block_diag(covariance, pivots.covariance))
    root = np.linalg.cholesky(covariance)
    whitened, targets = np.linalg.solve(root, rows), np.linalg.solve(root, values)
    volume = float(np.log(np.diag(root)).sum())
    return np.vstack([whitened, lifted.rows]), np.concatenate([targets, lifted.values]), volume
