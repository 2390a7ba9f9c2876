"""Links of an articulated object in the friction equations: how they move, and a row a hinge without any sensor.

The torque about a hinge of all that trails behind it, friction and inertia, is the hinge's own friction against its
turn: an unknown of its own, and no wrench is needed for it. Where a hinge does not turn, its friction is anything up to
that, and there is no row.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import torch
from jaxtyping import Float
from torch import Tensor
from torch.nn.functional import pad

from estimators.particles.model import ModelErrors, ParticleModel, cross, direction, rotate
from estimators.particles.windows import LinkedParticles, Observations
from testbed.worlds.setup_errors import SetupErrors

FORCE_ERROR, HINGE_ERROR = 0.002, 0.006
"""Model error of wrenches while links trail, as a part of the whole drag and its torque, and of the torque about a
hinge, as a part of the drag's about it; the windows of a trial share it. By `python bench/physics.py links`."""
UNEVEN = 0.1
"""Part of a point's load that an uneven table shifts, where points of contact are unknown: off a group's center of mass
about hinges, and onto the hand. Ours."""
LEAST_ERROR = 1e-6
"""Least error of a torque about a hinge, N m: where a guess has links without mass, it still is one."""
RESTING = 5e-4
"""Speed at which the drag of a particle that trails has no sure direction, m/s. Ours."""
SLOWEST = 0.01
"""Turn of a hinge against the links' camera below which it may stand, rad/s."""


HINGE_PRIOR = 1.0
"""Friction of a hinge before any trial, one standard deviation, N m: far more than an object on a table has."""


def carried_moment(model: ParticleModel, drag: Float[Tensor, ""], setup: SetupErrors) -> Float[Tensor, ""]:
    """Moment that the hand may carry of an object in links, N m, one standard deviation; 0 of a rigid one.

    The hand is nulled before it moves. Then each link turns, and with it the moment of its weight beside the middle of
    its feet: of even masses, their weight being twice the `drag`, N. On unknown points an uneven table shifts more.
    """
    if not len(model.hinges):
        return torch.zeros((), dtype=torch.float64)
    group = torch.nn.functional.one_hot(model.mass_group).double().T
    material, feet = group * model.fill, group * model.contact
    beside = material @ model.particles / material.sum(1, keepdim=True) - feet @ model.particles / feet.sum(1)[:, None]
    shifted = model.reach * (UNEVEN if setup.contact_points else 0.0)
    return 2 * drag * torch.hypot((group.mean(1) * beside.norm(dim=1)).norm(), shifted)


@dataclass(frozen=True, eq=False)
class HingeTorques:
    """Torques about every hinge of all that trails behind it, in K windows."""

    rows: Float[Tensor, "K H P"]
    """Torque that drags each particle against a friction of 1 N, m; 0 of what does not trail, and of a still hinge."""
    arm: Float[Tensor, "K H P 2"]
    """Mean place of what trails from each hinge, m; 0 of the rest."""
    inertial: Float[Tensor, "K H"]
    """Torque that the motion takes, N m."""
    sign: Float[Tensor, "K H"]
    """Sense in which what trails turns against the link before the hinge; 0 of one that may stand still."""

    @staticmethod
    def of(windows: Observations, model: ParticleModel, mass: Float[Tensor, "P"], still: Tensor) -> HingeTorques:
        """Torques of particles of a `mass`, kg; `still` (K, H) is true of hinges that may stand."""
        moved, links = LinkedParticles.of(windows, model), windows.links
        hinge = torch.arange(len(model.hinges))
        held = model.link[windows.held[:, 0]]
        near, beyond = hinge >= held[:, None], model.link[model.mass_group] > hinge[:, None]  # (K, H), (H, P)
        trails = (beyond == near[..., None]).double() * ~still[..., None]
        first = links[:, :, :-1]
        joint = rotate(first[..., 0], (model.hinges - windows.grasp[:, None])[:, None]) + first[..., 1:3]
        arm = moved.place[:, :, None] - joint[:, :, :, None]
        drag = cross(arm, direction(moved.velocity)[:, :, None])
        force = mass[:, None] * moved.acceleration
        pull = cross(arm, force[:, :, None]) + (moved.slope * mass * model.cell**2 / 6)[:, :, None]
        change = hinge_rates(windows).mean(1)
        sign = torch.where(near, change, -change).sign() * ~still
        mean_arm = arm.mean(1) * trails[..., None]
        return HingeTorques(drag.mean(1) * trails, mean_arm, (pull.mean(1) * trails).sum(-1), sign)


def hinge_rates(windows: Observations) -> Float[Tensor, "K S H"]:
    """Rate of each link less that of the one before, rad/s."""
    return torch.diff(windows.links[..., 5], dim=2)


def standing(windows: Observations) -> Tensor:
    """True of hinges that may stand, or turn back, within a window, (K, H): there friction has no known direction."""
    rates = hinge_rates(windows)
    spread = torch.stack([hinge_rates(each) - rates for each in perturbed(windows)]).square().sum(0).sqrt()
    least = rates.abs() - 3 * spread
    return ((least < SLOWEST) | (rates.sign() != rates[:, :1].sign())).any(1)


def perturbed(windows: Observations) -> list[Observations]:
    """The windows after one standard deviation of each error of the camera; the last is its delay's."""
    return [replace(windows, links=links) for links in windows.links_off.unbind(1)]


def hinge_rows(
    windows: Observations, model: ParticleModel, mass: Float[Tensor, "P"], drag: Float[Tensor, "P"], errors: ModelErrors
) -> tuple[HingeTorques, Float[Tensor, "N N"], Float[Tensor, "N H"]]:
    """Torques about the hinges, and what goes with their rows: N = 3 K + K H, those of the wrenches first.

    Args:
        windows: windows of an articulated object.
        model: its particles.
        mass: their masses, kg.
        drag: friction of each, N.
        errors: errors of the model.

    Returns:
        The torques; the covariance of all rows from the camera's errors and the hinges' own; and the effect of 1 N m
        of friction of each hinge.
    """
    still = standing(windows)
    here = HingeTorques.of(windows, model, mass, still)
    count, hinges = here.sign.shape

    def rows(seen: Observations) -> Float[Tensor, "N"]:
        torques = HingeTorques.of(seen, model, mass, still)
        wrench = seen.drag_rows(model, errors.pivot_error) @ drag + seen.motion_wrench(model, mass)
        return torch.cat([wrench.flatten(), (torques.rows @ drag + torques.inertial).flatten()])

    known = rows(windows)
    effects = torch.stack([rows(each) - known for each in perturbed(windows)], -1)
    window = torch.arange(count)
    window = torch.cat([window.repeat_interleave(3), window.repeat_interleave(hinges)])
    trial = windows.trial[window]
    own, late = effects[:, :-1], effects[:, -1]
    covariance = (own @ own.T) * (window[:, None] == window) + torch.outer(late, late) * (trial[:, None] == trial)
    covariance = covariance + _resting(windows, model, here.arm, drag)
    # windows of a trial are alike, and so are the errors of their drag
    alike = (windows.trial[:, None] == windows.trial).sum(1).double().sqrt()[:, None]
    lever = (drag * windows.lever(model).norm(dim=-1)).sum(-1, keepdim=True)
    force = drag.sum().expand(count, 1)
    wrong = torch.cat([FORCE_ERROR * force.expand(-1, 2), FORCE_ERROR * lever], 1) * alike
    # a hinge that may stand says nothing, and a row of zeros needs some error
    off = HINGE_ERROR * (here.rows.abs() @ drag) * alike + still.double() + LEAST_ERROR
    covariance = covariance + torch.cat([wrong.flatten(), off.flatten()]).square().diag()
    return here, covariance, pad(torch.diag_embed(here.sign).flatten(0, 1), (0, 0, 3 * count, 0))


def _resting(
    windows: Observations, model: ParticleModel, arm: Float[Tensor, "K H P 2"], drag: Float[Tensor, "P"]
) -> Float[Tensor, "N N"]:
    """Covariance of the rows of `hinge_rows` from particles that hardly move: each drags in any direction."""
    moved = LinkedParticles.of(windows, model)
    velocity = moved.velocity.mean(1)
    off = torch.stack([LinkedParticles.of(each, model).velocity.mean(1) - velocity for each in perturbed(windows)])
    slow = RESTING**2 + off.square().sum((0, -1))  # as far as the camera tells: its errors count as linear elsewhere
    resting = slow / (velocity.square().sum(-1) + slow)
    arms = torch.cat([moved.place.mean(1)[:, None], arm], 1)  # of the torque about the grasp, then of the hinges
    along = torch.eye(2, dtype=torch.float64).expand(*drag.shape, 2, 2).transpose(0, 1).expand(len(windows), 2, -1, 2)
    rows = torch.cat([along, torch.stack([-arms[..., 1], arms[..., 0]], -1)], 1) * (resting * drag)[:, None, :, None]
    each = (rows.flatten(2) @ rows.flatten(2).transpose(1, 2)) / 2
    count, hinges = arm.shape[:2]
    place = torch.arange(count * (3 + hinges)).reshape(count, -1)  # window by window
    order = torch.cat([place[:, :3].flatten(), place[:, 3:].flatten()])
    whole = torch.eye(count, dtype=torch.float64)[:, None, :, None] * each[:, :, None]
    return whole.reshape(place.numel(), -1)[order][:, order]
