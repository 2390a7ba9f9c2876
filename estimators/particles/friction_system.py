"""The linear system Q s = b of the friction loads s = mu m g, Eq. dvs, with its errors and its rank.

Errors become weights here alone, for every support model: errors of the sensor and of the particle model, and the
gripper's load that the sensor cannot measure.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from estimators.particles.links import HINGE_PRIOR, carried_moment, link_errors
from estimators.particles.setup_effects import LinearRows, by_row, setup_effects, shared_and_own
from estimators.particles.windows import PLANAR, Observations
from estimators.wrench.model import ModelErrors, ParticleModel
from estimators.wrench.support import GripperLoad, own_weight
from estimators.wrench.table import Table
from testbed.objects.model import GRAVITY, ObjectShape

SWING = 3e-4
"""Error of the center of an accelerated turn, m: the arm swings. Ours."""

LEAST_VARIANCE = 1e-12
"""Least variance of a mean torque, (N m)^2: sensors without any noise too have weights."""
PUSH_ERROR = 0.002
"""Model error of a push, as a part of the total drag, beside that of slow feet: the simulation is off by 0.05 to
0.14 %, and by more in few windows, where a light block tips."""
LEANING = 0.01
"""Further model error of a push on unknown points of contact, as a part of the drag: it leans every group. Ours."""


@dataclass(frozen=True, eq=False)
class LoadGroups:
    """G_s: particles in contact that share both mass group and friction group share one s."""

    index: Tensor
    """Column of G_s for each particle, -1 without contact, (P,)."""
    pairs: tuple[tuple[int, int], ...]
    """(mass group, friction group) of each column."""

    @staticmethod
    def of(model: ParticleModel) -> LoadGroups:
        """The groups of a model."""
        both = list(zip(model.mass_group.tolist(), model.friction_group.tolist(), strict=True))
        pairs = sorted({(m, f) for m, f in both if f >= 0})
        column = {pair: i for i, pair in enumerate(pairs)}
        return LoadGroups(torch.tensor([column.get(pair, -1) for pair in both]), tuple(pairs))

    def gather(self, values: Float[Tensor, "... P"]) -> Float[Tensor, "... n_s"]:
        """Sum over each group: values @ G_s^T."""
        kept = self.index >= 0
        out = torch.zeros(*values.shape[:-1], len(self.pairs), dtype=values.dtype)
        return out.index_add(-1, self.index[kept], values[..., kept])

    def spread(self, s: Float[np.ndarray, "n_s"]) -> Float[Tensor, "P"]:
        """Friction load of each particle, G_s^T s, N; 0 without contact."""
        return torch.where(self.index >= 0, torch.tensor(s)[self.index.clamp(min=0)], 0.0)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """Q s = b, whitened: every row has unit variance. 3 rows a window."""

    q: Float[Tensor, "R n_s"]
    b: Float[Tensor, "R"]
    whiten: Float[Tensor, "R R"]
    """Inverse root of the rows' covariance, which whitened them."""

    @property
    def rank(self) -> int:
        """rank(Q)."""
        return rank_of(self.q.numpy())

    def loss(self, s: Float[np.ndarray, "n_s"]) -> float:
        """Mean squared residual, Eq. problem_si in units of the data's own error."""
        return float((self.q @ torch.tensor(s) - self.b).square().mean())


@dataclass(frozen=True, eq=False)
class FrictionEquations:
    """Q s = b in N and N m, with its errors. R = 3 K rows, 3 a window."""

    q: Float[Tensor, "R n_s"]
    b: Float[Tensor, "R"]
    apart: Float[Tensor, "R R"]
    """Covariance of the errors that no two trials share."""
    common: Float[Tensor, "R E"]
    """Effect on each row of one standard deviation of each error that windows share: the model's, and the setup's."""
    linear: LinearRows
    """The rows as functions of everything that may err."""
    response: Float[Tensor, "K 3+H 3"]
    """Change of the rows with the gripper's lift and tilt, N/N and N m/N m."""
    hinges: Float[Tensor, "R H"] | None = None
    """Effect on each row of 1 N m of friction of each hinge; None of a rigid object. Of an articulated one R = 3 K +
    K H: a row for every hinge follows those of the wrenches."""

    @property
    def covariance(self) -> Float[Tensor, "R R"]:
        """Covariance of the rows, the friction of hinges apart."""
        return self.apart + self.common @ self.common.T

    def whitened(self) -> LinearSystem:
        """The system in units of its errors, whatever the hinges' friction."""
        whiten = torch.linalg.inv(torch.linalg.cholesky(self.covariance))
        if self.hinges is not None:  # in units of the other errors first: the prior is larger by many orders
            ways, size, _ = torch.linalg.svd(HINGE_PRIOR * whiten @ self.hinges, full_matrices=False)
            whiten = whiten - (ways * (1 - (1 + size.square()).rsqrt())) @ (ways.T @ whiten)
        return LinearSystem(whiten @ self.q, whiten @ self.b, whiten)


def friction_equations(
    model: ParticleModel,
    groups: LoadGroups,
    windows: Observations,
    mass: Float[Tensor, "P"],
    friction: Float[Tensor, "P"],
    height: float,
    errors: ModelErrors,
    linear: LinearRows | None = None,
) -> FrictionEquations:
    """Eq. dvs for every window, about the grasp point: friction of s balances the measured wrench.

    The present mass and friction enter only through the gripper's load (lift and tilt), which is small.

    Args:
        model: particles of the object.
        groups: G_s.
        windows: windows of constant speed.
        mass: present particle masses, kg.
        friction: present friction coefficients.
        height: height of the object, m.
        errors: errors of the model.
        linear: rows of the windows at these masses and frictions, where they are known.
    """
    linear = linear or linear_rows(windows, model, mass, friction, errors)
    rows, motion = linear.by_particle, linear.motion(mass)
    load = windows.gripper_load(linear.lever, motion, height)
    support = own_weight(model, mass, load)
    of_load = (rows @ (friction * (support.lean + support.change(load)))[..., None])[..., 0]
    response = rows @ (friction[:, None] * support.response)
    apart, common = wrench_errors(windows, linear, response, errors)
    b = pad(windows.wrench, (0, windows.hinges)) - motion - of_load  # no sensor is at a hinge
    hinges = None
    if windows.articulated:
        moved = support.beside - support.held_by(own_weight(model, mass, GripperLoad.none(model)))
        unseen = by_row((response[..., 1:] * ((1 - windows.load_kept[:, 1:]) * moved)[:, None]).sum(-1, keepdim=True))
        apart, hinges = apart + unseen @ unseen.T, by_row(linear.slopes["hinge_friction"])
    return FrictionEquations(
        by_row(groups.gather(rows)), by_row(b[..., None])[:, 0], apart, common, linear, response, hinges
    )


def linear_rows(
    windows: Observations,
    model: ParticleModel,
    mass: Float[Tensor, "P"],
    friction: Float[Tensor, "P"],
    errors: ModelErrors,
) -> LinearRows:
    """Rows of windows as functions of everything that may err, about the drag of every group's own weight alone.

    Arguments as `friction_equations`.
    """
    table = windows.table(model, errors.pivot_error)
    drag = friction * own_weight(model, mass, GripperLoad.none(model)).share * GRAVITY
    return LinearRows.of(windows, table, mass, drag, errors.lead_error, windows.setup)


def hinge_friction(
    found: FrictionEquations,
) -> tuple[Float[np.ndarray, "H"], Float[np.ndarray, "H"]] | None:
    """Torque of friction of every hinge, N m, and its standard deviation; None of a rigid object.

    With the friction loads as they fit best; one that the trials do not show has the spread of `HINGE_PRIOR`.
    """
    if found.hinges is None:
        return None
    root = torch.linalg.cholesky(found.covariance)
    both = torch.linalg.solve_triangular(root, torch.cat([found.hinges, found.q], 1), upper=False)
    count = found.hinges.shape[1]
    prior = torch.zeros(both.shape[1], dtype=torch.float64)
    prior[:count] = HINGE_PRIOR**-2
    precision = both.T @ both + prior.diag()
    seen = both.T @ torch.linalg.solve_triangular(root, found.b[:, None], upper=False)
    spread = torch.linalg.pinv(precision, hermitian=True)
    return (spread @ seen)[:count, 0].numpy(), spread.diagonal()[:count].sqrt().numpy()


def weight_per_mass(shape: ObjectShape, pairs: Sequence[tuple[int, int]]) -> Float[np.ndarray, "n_s"]:
    """Weight on one particle in contact of each pair a kg of its group's particle mass, N/kg."""
    feet = np.bincount(shape.mass_group[shape.friction_group >= 0], minlength=shape.n_m)
    return np.array([GRAVITY * shape.particles_per_group[m] / feet[m] for m, _ in pairs])


def rank_of(q: Float[np.ndarray, "R n_s"]) -> int:
    """rank(Q) with columns scaled to unit length; a direction below 1e-3 of the strongest is not observed."""
    scale = np.linalg.norm(q, axis=0)
    values = np.linalg.svd(q / np.where(scale > 0, scale, 1.0), compute_uv=False)
    return int((values > 1e-3 * values.max(initial=1e-300)).sum())


def wrench_errors(
    windows: Observations,
    linear: LinearRows,
    response: Float[Tensor, "K 3+H 3"],
    errors: ModelErrors,
) -> tuple[Float[Tensor, "R R"], Float[Tensor, "R E"]]:
    """Errors of wrenches less the effect of the gripper's load, and of torques about H hinges: R = 3 K + K H rows.

    Args:
        windows: windows of constant speed.
        linear: their rows.
        response: change of the rows with lift and tilt, N/N and N m/N m.
        errors: errors of the model.

    Returns:
        Covariance of the errors that no two trials share, and the effect on each row of one standard deviation of each
        error that windows share: lift, height, lead, and those of the setup.
    """
    slopes = linear.slopes
    blocks, late = model_errors(windows, linear, errors)
    by_trial = by_row(late)
    same = windows.together[windows.of_row][:, windows.of_row]
    apart = (by_trial @ by_trial.T) * same + in_windows(blocks)
    lift, tilt = errors.lift_error, errors.tilt_error
    shared = torch.tensor([lift / 2**0.5, 0.0, 0.0], dtype=torch.float64)
    nulled = torch.tensor([lift / 2**0.5, tilt, tilt], dtype=torch.float64)
    if windows.articulated:
        moment = carried_moment(linear.model, windows.wrench[:, :2].norm(dim=1).max(), windows.setup)
        nulled = torch.maximum(nulled, moment * torch.tensor([0.0, 1.0, 1.0], dtype=torch.float64))
    apart = apart + _sensor_error(windows, response, nulled, shared)
    hidden = (response * (shared * (1 - windows.load_kept))[:, None]).sum(-1)
    # the drag's own moment about the feet is as wrong as the height over them
    raised = errors.height_error * (response[..., 1:] @ windows.wrench[:, :2, None])[..., 0]
    common = by_row(torch.cat([torch.stack([hidden, raised], -1), slopes.get("lead", hidden[..., None] * 0)], -1))
    if windows.setup.none:
        return apart, common
    effects = setup_effects(windows, linear, sensor_map(windows, response), windows.setup)
    shared, own = shared_and_own(effects, windows)
    return apart + own, torch.cat([common, shared], 1)


def model_errors(
    windows: Observations, linear: LinearRows, errors: ModelErrors
) -> tuple[Float[Tensor, "K 3+H 3+H"], Float[Tensor, "K 3+H m"]]:
    """Errors of planar wrenches and hinge torques: of the model, of the hand's motion and of the cameras.

    Returns:
        Covariance of each window's own errors, and the effects of one standard deviation of those that all windows of a
        trial share.
    """
    slopes, along = linear.slopes, linear.sum_of_drag
    total = along[:, :3]
    torque = (errors.torque_error * windows.wrench[:, 2:]).square()
    own = torch.cat([(errors.force_error * total[:, :2]).square(), torque], -1) + 1e-10
    of_push = math.hypot(PUSH_ERROR, LEANING if windows.setup.contact_points else 0.0)
    own = pad(own + (of_push * windows.pushed[:, None] * total).square(), (0, windows.hinges))
    held = ~windows.pushed[:, None, None]
    moved = errors.pivot_error * windows.twist[:, 2].abs()[:, None, None] * slopes["twist"][..., :2]
    alone = [moved, slopes["twist"] * windows.twist_noise.sqrt() * held, slopes.get("idle", moved[..., :0])]
    if "friction_law" in slopes:  # friction varies within a trial as it does between them
        alone.append(windows.setup.friction_law * slopes["friction_law"])
    late = [moved[..., :0]]  # an error of the clock is the same throughout a trial
    for name in ("seen", "links_seen"):
        if name in slopes:
            alone.append(slopes[name][..., :-1])
            late.append(slopes[name][..., -1:])
    if windows.articulated:
        own = own + link_errors(windows, along).square()
    by_window = torch.cat(alone, -1)
    return torch.diag_embed(own) + by_window @ by_window.mT, torch.cat(late, -1)


def in_windows(blocks: Float[Tensor, "K 3+H 3+H"]) -> Float[Tensor, "R R"]:
    """Covariance of rows of which only those of one window are correlated; those of hinges come last."""
    count, rows = blocks.shape[:2]
    place = torch.arange(count * rows).reshape(count, rows)  # window by window
    order = by_row(place[..., None])[:, 0]
    return torch.block_diag(*blocks)[order][:, order]


def unknown_motion(windows: Observations, model: ParticleModel, weight: float) -> Float[Tensor, "R E"]:
    """Effects of c and of each I_j on accelerated windows, as large as the object's `weight` (kg) and reach allow.

    Treated as errors, they leave friction alone to those windows: the slopes of torque show I_j.
    """
    grasp, alpha = windows.grasp.detach(), windows.acceleration[:, 2] * windows.accelerated
    reach = float((model.particles - grasp[:, None]).norm(dim=-1).max())
    squared, none = windows.spin_square * windows.accelerated, torch.zeros_like(alpha)
    along = torch.stack([torch.stack([-squared, alpha, none], 1), torch.stack([-alpha, -squared, none], 1)], -1)
    pivots, index = torch.unique(grasp.round(decimals=9), dim=0, return_inverse=True)
    about = torch.nn.functional.one_hot(index, len(pivots)) * alpha[:, None]
    turning = torch.stack([torch.zeros_like(about), torch.zeros_like(about), about], 1)
    return weight * reach * torch.cat([along, reach * turning], -1).flatten(0, 1)


def compliance_variance(windows: Observations, table: Table, drag: Float[Tensor, "P"]) -> Float[Tensor, "R"]:
    """Variance of accelerated windows' forces from particles so near the center that its swing turns their drag.

    Args:
        windows: windows of constant speed or acceleration.
        table: their forward model.
        drag: friction of every particle, N.
    """
    swing = (SWING * windows.twist[:, 2:]).square()
    turned = swing / (table.velocity.square().sum(-1) + swing + 1e-18)
    force = (turned * drag.square()).sum(-1) * windows.accelerated
    return torch.stack([force, force, torch.zeros_like(force)], 1).flatten()


def torque_covariance(
    windows: Observations,
    linear: LinearRows,
    response: Float[Tensor, "K 3 3"],
) -> Float[np.ndarray, "K K"]:
    """Covariance of accelerated windows' torques less the gripper's effect; a trial's constant is not in it.

    Arguments as `wrench_errors`.
    """
    none = torch.zeros(3, dtype=torch.float64)
    covariance = _sensor_error(windows, response, none, none)
    if not windows.setup.none:
        effects = setup_effects(windows, linear, sensor_map(windows, response), windows.setup)
        shared, own = shared_and_own(effects, windows)
        covariance = covariance + own + shared @ shared.T
    return (covariance[2::3, 2::3] + LEAST_VARIANCE * torch.eye(len(windows), dtype=torch.float64)).numpy()


def sensor_map(windows: Observations, response: Float[Tensor, "K 3+H 3"]) -> Float[Tensor, "R 6K"]:
    """Map from errors of the sensor, about the TCP, to those of wrenches less the `response` to lift and tilt.

    One force feeds both, so an error common to a wrench and to the load on the feet counts once. Torques about hinges
    follow those of the wrenches: of them the sensor feels the load alone.
    """
    count, hinges = len(windows), response.shape[1] - 3
    carried = response @ _load_error(windows).reshape(count, 3, 6 * count)
    planar = pad(torch.eye(6, dtype=torch.float64)[PLANAR], (0, 0, 0, hinges)).expand(count, 3 + hinges, 6)
    return by_row(torch.block_diag(*planar).reshape(count, 3 + hinges, 6 * count) - carried)


def _sensor_error(
    windows: Observations, response: Float[Tensor, "K 3+H 3"], nulled: Float[Tensor, "3"], shared: Float[Tensor, "3"]
) -> Float[Tensor, "R R"]:
    """Covariance of wrenches less the `response` to lift and tilt: errors of the sensor, and loads taken for them."""
    sensed, error = _sensor_covariance(windows), sensor_map(windows, response)
    return error @ sensed @ error.T + _shrinkage_covariance(windows, sensed, response, nulled, shared)


def _shrinkage_covariance(
    windows: Observations,
    sensed: Float[Tensor, "6K 6K"],
    response: Float[Tensor, "K 3+H 3"],
    nulled: Float[Tensor, "3"],
    shared: Float[Tensor, "3"],
) -> Float[Tensor, "R R"]:
    """Covariance of wrenches from the lift and tilt that were taken for the sensor's error.

    Where a part k of a load was kept against a sensor's error of variance b, the load scatters by k b / (1 - k),
    and (1 - k) of it went: k (1 - k) b is its variance. A trial's mean is taken to scatter by no less than `nulled`
    about what all trials share, which scatters by `shared` and is not in it (N, N m, one standard deviation).
    """
    count, mean, change = len(windows), windows.trial_mean, windows.trial_change
    to_load = torch.block_diag(*windows.load_map)
    error = torch.diagonal((to_load @ sensed @ to_load.T).reshape(count, 3, count, 3), dim1=1, dim2=3)
    of_mean, of_change = (torch.einsum("kl,lma,nm->kna", part, error, part) for part in (mean, change))
    dropped = 1 - windows.load_kept
    scatter = windows.load_kept * dropped * torch.diagonal(of_mean).T - (dropped * shared).square()
    hidden = torch.maximum(scatter, (dropped * nulled).square()).sqrt()
    missed = torch.diagonal(of_change).T.clamp(min=0) * windows.load_followed * (1 - windows.load_followed)
    alpha = windows.acceleration[:, 2]
    along = alpha / (mean @ alpha.square()).sqrt().clamp(min=1e-9)
    swung = windows.together * along[:, None] * along  # what a swing of the arm changes goes with its acceleration
    changed = torch.where(windows.accelerated[:, None], swung, change)[..., None] * missed.sqrt()
    load = windows.together[..., None] * hidden[:, None] * hidden + changed * missed.sqrt()[:, None]
    rows = by_row(torch.einsum("kia,kla,lja->kilj", response, load, response).flatten(2))
    return by_row(rows.T.reshape(count, -1, len(rows)))


def _sensor_covariance(windows: Observations) -> Float[Tensor, "6K 6K"]:
    """Covariance of all windows' six components."""
    shared = windows.together[:, None, :, None] * windows.bias[:, :, None] + (
        windows.walked[:, None, :, None] * windows.drift[:, :, None]
    )
    return shared.reshape(6 * len(windows), 6 * len(windows)) + torch.block_diag(*windows.noise)


def _load_error(windows: Observations) -> Float[Tensor, "3K 6K"]:
    """Map from the sensor's errors to those of lift and tilt, of which only parts of mean and change were kept."""
    followed, kept = windows.load_followed[..., None], windows.load_kept[..., None]
    own = windows.trial_change[:, None] * followed + windows.trial_mean[:, None] * kept
    return torch.einsum("kal,lai->kali", own, windows.load_map).reshape(3 * len(windows), 6 * len(windows))
