"""Errors of the rows of trials on the table: of the sensor, of the gripper's load, and of the forward model itself."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import torch
from jaxtyping import Float, Int
from torch import Tensor
from torch.nn.functional import pad

from estimators.particles.links import link_errors, resting
from estimators.particles.windows import Observations
from estimators.posterior.solver import Blocks
from estimators.wrench.jacobian import Slopes, zeros
from estimators.wrench.model import ModelErrors, turned
from estimators.wrench.sensor import walk
from estimators.wrench.table import Table

SWING = 3e-4
"""Error of the center of an accelerated turn, m: the arm swings. Ours."""
PUSH_ERROR = 0.002
"""Model error of a push, as a part of the total drag, besides that of slow feet: the simulation differs by 0.05 to
0.14 %, and by more in the few windows in which a light block tips."""
LEANING = 0.01
"""Further model error of a push on unknown points of contact, as a part of the drag: it tilts every group. Ours."""
SLOW = 1e-3
"""Speed at which half of the friction of a pushed object's foot has no known size and direction, m/s: a foot near the
center of rotation sticks. Ours."""
LEAST_VARIANCE = 1e-12
"""Least variance of a row, N^2 and (N m)^2, for sensors without noise."""
ROUNDING = 1e-13
"""Part of the largest variance of a trial added to all variances, so that rounding leaves a covariance definite."""


@dataclass(frozen=True, eq=False)
class TableErrors:
    """Errors of the rows of K windows, r rows a window; those by the gripper's load are linear in its effects."""

    windows: Observations
    own: Float[Tensor, "K r r"]
    """Covariance of each window's own errors, of sensor and model."""
    shared: Float[Tensor, "K r m"]
    """Effects of one standard deviation of each error that the windows of a trial share."""

    @staticmethod
    def of(
        windows: Observations, table: Table, mass: Float[Tensor, "P"], drag: Float[Tensor, "K P"], errors: ModelErrors
    ) -> TableErrors:
        """Errors at some masses and friction.

        Args:
            windows: windows of constant speed or acceleration.
            table: their forward model with each particle on its middle: errors of the motion act on feet, each at one
                place, and would cancel in the mean over a cell.
            mass: mass of every particle, kg.
            drag: friction of every particle, N.
            errors: errors of the model.
        """
        by_hand = ~(windows.pushed | windows.articulated)  # motion measured by a camera has noise, but does not wander
        wanders = windows.twists[by_hand].diff(dim=1).any()
        unresolved = [by_hand[:, None, None] * (table.unresolved @ drag[..., None])] if wanders else []
        table = table.dragged(drag)
        slopes, hinges = _slopes(windows, table, mass), windows.hinges
        slopes["unresolved"] = torch.cat([slopes["twist"][..., :0], *unresolved], -1)
        planar, shared = _of_motion(windows, table, slopes, drag, errors)
        # the inertia errs once a trial, and once in all trials: the second error is an unknown
        shared = torch.cat([shared, errors.inertia_error * slopes["mass"] @ mass[:, None]], -1)
        swing, of_center = (SWING * windows.twist[:, 2]).square(), slopes["twist"][..., :2]
        planar = planar + (swing * windows.accelerated)[:, None, None] * of_center @ of_center.mT
        to_rows = rows_of_planar(windows.load_map[:, 1, 0], hinges)
        own = to_rows @ planar @ to_rows.mT + pad(windows.noise, (0, hinges, 0, hinges))
        return TableErrors(windows, own + LEAST_VARIANCE * torch.eye(6 + hinges, dtype=torch.float64), to_rows @ shared)

    def blocks(self, carried: Float[Tensor, "K r 3"]) -> Blocks:
        """Indices of the rows of each trial, and the covariance of their errors.

        Args:
            carried: derivatives of the rows in the gripper's lift and moment.
        """
        windows, rows, found = self.windows, self.own.shape[1], []
        for inside in self.trials:
            each, shared = torch.arange(inside.shape[1]), self.shared[inside].flatten(1, 2)
            drifts = walk(windows.since_tare[inside])[:, :, None, :, None]
            covariance = self._of_load(carried, inside) + drifts * self._of_sensor(windows.drift, inside)
            covariance += self._of_sensor(windows.bias, inside)
            covariance[:, each, :, each] += self.own[inside].transpose(0, 1)
            covariance = covariance.flatten(3).flatten(1, 2) + shared @ shared.mT
            variance = covariance.diagonal(dim1=1, dim2=2)
            variance.add_(ROUNDING * variance.amax(1, keepdim=True))
            found.append(((inside[..., None] * rows + torch.arange(rows)).flatten(1), covariance))
        return found

    def _of_load(self, carried: Float[Tensor, "K r 3"], inside: Int[Tensor, "C k"]) -> Float[Tensor, "C k r k r"]:
        """Part of the covariance of some trials' rows that the gripper's load causes."""
        return torch.einsum("ckia,ckla,clja->ckilj", carried[inside], self.load_covariance(inside), carried[inside])

    def _of_sensor(self, error: Float[Tensor, "K 6 6"], inside: Int[Tensor, "C k"]) -> Float[Tensor, "C k r k r"]:
        """Covariance of some trials' rows by an error that is constant in the sensor's axes.

        A pushed object turns under the hand, and the sensor's axes in those of the object.

        Args:
            error: covariance of the error in each window, of which that in the first of a trial counts.
            inside: indices of the windows of each trial.
        """
        axes = self.windows.from_sensor[inside]
        turned = pad(torch.linalg.solve(axes[:, :1], axes, left=False), (0, 0, 0, self.windows.hinges))
        return torch.einsum("ckab,cbd,cled->ckale", turned, error[inside[:, 0]], turned)

    def absorbed(self, carried: Float[Tensor, "K r 3"], blocks: Blocks) -> float:
        """Number of rows absorbed by the gripper's load: the trace of its part of their covariance."""
        count = 0.0
        for inside, (_, covariance) in zip(self.trials, blocks, strict=True):
            of_load = self._of_load(carried, inside).flatten(3).flatten(1, 2)
            count += float(torch.linalg.solve(covariance, of_load).diagonal(dim1=1, dim2=2).sum())
        return count

    @cached_property
    def trials(self) -> list[Int[Tensor, "C k"]]:
        """Indices of the windows of each trial: an entry for C trials of k windows each."""
        _, trial, count = torch.unique(self.windows.trial, return_inverse=True, return_counts=True)
        order, begin = torch.argsort(trial, stable=True), count.cumsum(0) - count
        return [order[begin[count == k, None] + torch.arange(int(k))] for k in count.unique()]

    def load_covariance(self, inside: Int[Tensor, "C k"]) -> Float[Tensor, "C k k 3"]:
        """Prior covariance of the gripper's lift and moments in the windows of a trial, each component on its own."""
        windows = self.windows
        alpha, changed = (windows.acceleration[:, 2] * windows.accelerated)[inside], windows.load_change[inside]
        along = alpha / alpha.square().mean(1, keepdim=True).sqrt().clamp(min=1e-9)
        # a swinging arm carries load in proportion to its acceleration, besides the change from window to window
        change = torch.eye(inside.shape[1], dtype=torch.float64) + along[:, :, None] * along[:, None]
        change = change[..., None] * changed[:, :, None] * changed[:, None]
        if inside.shape[1] > 1:  # the change is about the trial's mean, which a nulled gripper keeps small
            change = change - change.mean(1, keepdim=True)
            change = change - change.mean(2, keepdim=True)
        size = windows.load_size[inside]
        return change + size[:, :, None] * size[:, None]

    def shrunken_load(
        self, residual: Float[Tensor, "K r"], carried: Float[Tensor, "K r 3"], blocks: Blocks
    ) -> Float[Tensor, "K 3"]:
        """Most likely lift and moments of the gripper, N and N m; residuals are those of a gripper without load."""
        found = torch.zeros(len(residual), 3, dtype=torch.float64)
        for inside, (rows, covariance) in zip(self.trials, blocks, strict=True):
            root = torch.linalg.cholesky(covariance)
            weighed = torch.cholesky_solve(residual.flatten()[rows][..., None], root).reshape(*inside.shape, -1)
            toward = torch.einsum("ckra,ckr->cka", carried[inside], weighed)
            found[inside] = -torch.einsum("ckla,cla->cka", self.load_covariance(inside), toward)
        return found


def rows_of_planar(height: Float[Tensor, "K"], hinges: int) -> Float[Tensor, "K 6+H 3+H"]:
    """Map from planar wrenches and hinge torques to rows: the forces have moments about the feet.

    Args:
        height: height of the TCP over the point at which each wrench acts, m.
        hinges: H.
    """
    found = torch.zeros(len(height), 6 + hinges, 3 + hinges, dtype=torch.float64)
    found[:, [0, 1, *range(5, 6 + hinges)], range(3 + hinges)] = 1.0
    found[:, 4, 0], found[:, 3, 1] = -height, height
    return found


def _slopes(windows: Observations, table: Table, mass: Float[Tensor, "P"]) -> Slopes:
    """Derivatives of planar wrenches and hinge torques in the quantities that err from window to window.

    `link_camera` and `idle` are changes by one standard deviation; `idle` is the drag of particles so slow that it has
    no known direction.
    """
    pushed = windows.camera_errors.shape[-1] > 0
    unknown = zeros(twist=(3,)) | {"mass": mass}
    if pushed:
        unknown |= zeros(camera_errors=(windows.camera_errors.shape[-1],))
    if pushed or windows.articulated:
        unknown |= zeros(force=table.model.particles.shape)
    if windows.articulated:
        unknown |= zeros(friction=table.points.shape[:2])
    if windows.setup.friction_law:
        unknown |= zeros(friction_law=(3,))
    rows, slopes = table.linearized(unknown)
    if windows.articulated:
        ways = torch.eye(table.windows["links_with_errors"].shape[1], dtype=torch.float64)
        off = [table.rows({"mass": mass, "link_camera": way}) - rows for way in ways]
        slopes["link_camera"] = torch.stack(off, -1)
    if pushed or windows.articulated:
        idle = resting(windows, table) if windows.articulated else _stuck(windows, table)
        slopes["idle"] = slopes.pop("force") * (idle * table.windows["drag"]).repeat_interleave(2, 1)[:, None]
    return slopes


def _of_motion(
    windows: Observations, table: Table, slopes: Slopes, drag: Float[Tensor, "K P"], errors: ModelErrors
) -> tuple[Float[Tensor, "K 3+H 3+H"], Float[Tensor, "K 3+H m"]]:
    """Errors of planar wrenches and hinge torques: of the model, of the hand's motion and of the cameras.

    Returns:
        Covariance of each window's own errors, and the effects of one standard deviation of those that all windows of a
        trial share.
    """
    along = drag @ torch.ones_like(table.model.fill)
    total = torch.stack([along, along, (table.lever.norm(dim=-1) * drag).sum(-1)], 1)
    torque = (errors.torque_error * windows.wrench[:, 2:]).square()
    own = torch.cat([(errors.force_error * total[:, :2]).square(), torque], -1) + 1e-10
    of_push = math.hypot(PUSH_ERROR, LEANING if windows.setup.contact_points else 0.0)
    own = pad(own + (of_push * windows.pushed[:, None] * total).square(), (0, windows.hinges))
    held = ~windows.pushed[:, None, None]
    moved = errors.pivot_error * windows.twist[:, 2].abs()[:, None, None] * slopes["twist"][..., :2]
    alone = [moved, slopes["twist"] * windows.twist_noise.sqrt() * held, slopes["unresolved"]]
    alone.append(slopes.get("idle", moved[..., :0]))
    if "friction_law" in slopes:  # friction varies within a trial as it does between them
        alone.append(windows.setup.friction_law * slopes["friction_law"])
    shared = [moved[..., :0]]  # an error of the clock is the same throughout a trial
    for name in ("camera_errors", "link_camera"):
        if name in slopes:
            alone.append(slopes[name][..., :-1])
            shared.append(slopes[name][..., -1:])
    if windows.articulated:
        about = (slopes["friction"][:, 3:].abs() @ drag[..., None])[..., 0]
        own = own + link_errors(windows, torch.cat([total, about], 1)).square()
    by_window = torch.cat(alone, -1)
    return torch.diag_embed(own) + by_window @ by_window.mT, torch.cat(shared, -1)


def _stuck(windows: Observations, table: Table) -> Float[Tensor, "K P"]:
    """Standard deviation of each particle's drag along each axis, as a part of it, where its direction is unknown.

    For particles slower than `SLOW` or than the camera's error of their speed; that of faster ones has a linear effect.
    """
    square = table.moved({}).velocity.square().sum(-1)
    place = windows.grasp[:, None] + table.lever
    of_camera = windows.camera_errors[:, None, 3:5] + turned(place)[..., None] * windows.camera_errors[:, None, 5:6]
    slow = SLOW**2 + of_camera.square().sum((2, 3))[:, None]
    return (slow / (square + slow)).mean(1) * windows.pushed[:, None]
