"""Errors of an articulated object's rows: wrenches while links trail, and torques about hinges.

The torque of friction and inertia of all links beyond a hinge equals the hinge's own friction, which is an unknown; it
needs no sensor. The friction of a hinge at rest may have any value up to that, so it has no row.
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
"""Model error of wrenches while links trail, relative to the total drag and its torque, and of the torque about a
hinge, relative to that of the drag; the windows of a trial share it. By `python bench/physics.py links`."""
UNEVEN = 0.1
"""Part of the load that an uneven table shifts, where points of contact are unknown: off a group's center of mass about
hinges, and onto the hand. Ours."""
LEAST_ERROR = 1e-6
"""Least error of a torque about a hinge, N m, for guesses with links without mass."""
RESTING = 5e-4
"""Speed at which the drag of a trailing particle has no known direction, m/s. Ours."""
HINGE_PRIOR = 1.0
"""Friction of a hinge before any trial, one standard deviation, N m: far more than an object on a table has."""


def carried_moment(model: ParticleModel, drag: Float[Tensor, ""], setup: SetupErrors) -> Float[Tensor, ""]:
    """Moment of weights beside the middles of their feet that the hand may carry, one standard deviation, N m.

    For even masses of a weight of twice the `drag`, N. A hand holds the moment of the group that it grips; moments of
    links turn with them; an uneven table under unknown points adds to it.
    """
    if not model.stands_in_groups:
        return torch.zeros((), dtype=torch.float64)
    group = torch.nn.functional.one_hot(model.mass_group).double().T
    material, feet = group * model.fill, group * model.contact
    beside = material @ model.particles / material.sum(1, keepdim=True) - feet @ model.particles / feet.sum(1)[:, None]
    shifted = model.reach * (UNEVEN if setup.contact_points and len(model.hinges) else 0.0)
    return 2 * drag * torch.hypot((group.mean(1) * beside.norm(dim=1)).norm(), shifted)


def link_errors(windows: Observations, sum_of_drag: Float[Tensor, "K 3+H"]) -> Float[Tensor, "K 3+H"]:
    """Standard deviations of the model error of each row, N and N m.

    Args:
        windows: windows of an articulated object.
        sum_of_drag: sum over particles of the magnitudes of their drag along each row, N, N and N m, and N m about
            hinges.
    """
    # windows of a trial share the error of their drag
    alike = windows.same_trial.sum(1).sqrt()[:, None]
    wrench, hinge = sum_of_drag[:, :3], sum_of_drag[:, 3:]
    # a hinge that may be at rest has a row of zeros, which needs some error
    off = HINGE_ERROR * hinge * alike + windows.standing.double() + LEAST_ERROR
    return torch.cat([FORCE_ERROR * wrench * alike, off], 1)


def hinge_frictions(torque: Iterable[float], std: Iterable[float], widening: float) -> tuple[dict[str, float], str]:
    """Friction of every hinge that turned, with its widened error, N m; and a message that names the others."""
    named: dict[str, float] = {}
    unseen: list[str] = []
    for index, (each, error) in enumerate(zip(torque, std, strict=True)):
        if error > HINGE_PRIOR / 2:
            unseen.append(f"hinge {index} stands in every window: its friction is not observed")
        else:
            named |= {f"hinge_{index}_Nm": float(each), f"hinge_{index}_std_Nm": widening * float(error)}
    return named, "; ".join(unseen)


def resting(windows: Observations, table: Table) -> Float[Tensor, "K P"]:
    """Standard deviation of each particle's drag along each axis, as a part of it, where its direction is unknown.

    For particles slower than `RESTING` or than the camera's error of their speed; that of faster ones has a linear
    effect.
    """
    known = table.velocity
    errors = torch.eye(windows.links_with_errors.shape[1], dtype=torch.float64)
    off = torch.stack([table.moved({"link_camera": error}).velocity.mean(1) - known for error in errors])
    slow = RESTING**2 + off.square().sum((0, -1))
    return slow / (known.square().sum(-1) + slow) / 2**0.5
