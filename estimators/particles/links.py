"""Errors of an articulated object's rows: wrenches while links trail, and torques about hinges without any sensor.

The torque about a hinge of all that trails behind it, friction and inertia, is the hinge's own friction against its
turn: an unknown of its own, and no wrench is needed for it. Where a hinge does not turn, its friction is anything up to
that, and its row is none.
"""

from __future__ import annotations

from collections.abc import Iterable

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.windows import Observations
from estimators.wrench.model import ParticleModel
from estimators.wrench.table import Table
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
HINGE_PRIOR = 1.0
"""Friction of a hinge before any trial, one standard deviation, N m: far more than an object on a table has."""


def carried_moment(model: ParticleModel, drag: Float[Tensor, ""], setup: SetupErrors) -> Float[Tensor, ""]:
    """Moment that the hand may carry of weights beside the middles of their feet, N m, one standard deviation.

    Of even masses, their weight being twice the `drag`, N. A hand that grips such a group holds its moment, and where
    links turn, their moments turn with them; an uneven table under unknown points shifts more.
    """
    if not model.stands_in_groups:
        return torch.zeros((), dtype=torch.float64)
    group = torch.nn.functional.one_hot(model.mass_group).double().T
    material, feet = group * model.fill, group * model.contact
    beside = material @ model.particles / material.sum(1, keepdim=True) - feet @ model.particles / feet.sum(1)[:, None]
    shifted = model.reach * (UNEVEN if setup.contact_points and len(model.hinges) else 0.0)
    return 2 * drag * torch.hypot((group.mean(1) * beside.norm(dim=1)).norm(), shifted)


def link_errors(windows: Observations, sum_of_drag: Float[Tensor, "K 3+H"]) -> Float[Tensor, "K 3+H"]:
    """Standard deviations of the model's own error of each row, N and N m.

    Args:
        windows: windows of an articulated object.
        sum_of_drag: sum over particles of the magnitudes of their drag along each row, N, N and N m, and N m about
            hinges.
    """
    # windows of a trial are alike, and so are the errors of their drag
    alike = windows.together.sum(1).sqrt()[:, None]
    wrench, hinge = sum_of_drag[:, :3], sum_of_drag[:, 3:]
    # a hinge that may stand says nothing, and a row of zeros needs some error
    off = HINGE_ERROR * hinge * alike + windows.standing.double() + LEAST_ERROR
    return torch.cat([FORCE_ERROR * wrench * alike, off], 1)


def hinge_frictions(torque: Iterable[float], std: Iterable[float], widening: float) -> tuple[dict[str, float], str]:
    """Friction of every hinge that was seen to turn, with its widened error, N m; and the others, in words."""
    named: dict[str, float] = {}
    unseen: list[str] = []
    for index, (each, error) in enumerate(zip(torque, std, strict=True)):
        if error > HINGE_PRIOR / 2:
            unseen.append(f"hinge {index} stands in every window: its friction is not observed")
        else:
            named |= {f"hinge_{index}_Nm": float(each), f"hinge_{index}_std_Nm": widening * float(error)}
    return named, "; ".join(unseen)


def resting(windows: Observations, table: Table) -> Float[Tensor, "K P"]:
    """Part of the drag of each particle that may act any way as it hardly moves, one standard deviation along an axis.

    As far as the camera shows it: its errors count as linear elsewhere.
    """
    known = table.velocity
    ways = torch.eye(windows.links_off.shape[1], dtype=torch.float64)
    off = torch.stack([table.moved({"links_seen": way}).velocity.mean(1) - known for way in ways])
    slow = RESTING**2 + off.square().sum((0, -1))
    return slow / (known.square().sum(-1) + slow) / 2**0.5
