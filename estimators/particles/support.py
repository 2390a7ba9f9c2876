"""Support models: normal load of every particle on the table from the particle masses and the gripper's load.

All are batched over K windows and differentiable. Loads are not clipped: a negative one means a lifted particle, and
the caller can see it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.gripper_load import GripperLoad
from estimators.particles.model import ParticleModel
from testbed.objects.model import GRAVITY


@dataclass(frozen=True, eq=False)
class OwnWeight:
    """Own-weight loads: N_i = share_i g + lean_i, plus a linear response to the gripper's load."""

    share: Float[Tensor, "P"]
    """Part of its mass group's mass that each particle carries, kg; 0 without contact."""
    lean: Float[Tensor, "P"]
    """Load of each particle from weight beside the middle of its group's feet, N; sums to 0 over a group."""
    response: Float[Tensor, "K P 3"]
    """Change of each particle's load with the gripper's lift (N per N) and moment (N per N m)."""

    def loads(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """N_i, N."""
        return self.share * GRAVITY + self.lean + self.change(load)

    def change(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """Change of N_i with the gripper's load, N."""
        return (self.response @ load.carried[..., None])[..., 0]


def own_weight(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> OwnWeight:
    """Every mass group on its own weight: N_i = m_i g, plus the gripper's load.

    fz lightens the held group's weight, or by half of it each that of two under the pads. All groups share one tilt on
    a foundation of even stiffness, so each takes a part of the moment that is affine over its own feet: the gripper's,
    and that of a weight beside its feet. An object that does not stand in groups, since one has no foot or it rests on
    points of contact, is one group: its loads are then `rigid_loads`.

    Args:
        model: particles of the object.
        mass: mass of each particle, kg.
        load: the gripper's load; only where it holds the object counts here.
    """
    particles, contact = model.particles, model.contact
    apart = model.stands_in_groups
    group, held = (
        (model.mass_group, load.held) if apart else (torch.zeros_like(each) for each in (model.mass_group, load.held))
    )
    count = int(group.max()) + 1
    zeros, pairs = torch.zeros(count, dtype=torch.float64), torch.zeros(count, 2, dtype=torch.float64)
    feet = zeros.index_add(0, group, contact.double())
    whole = zeros.index_add(0, group, mass)
    share = torch.where(contact, (whole / feet)[group], 0.0)
    center = pairs.index_add(0, group, particles * contact[:, None]) / feet[:, None]
    offset = (particles - center[group]) * contact[:, None]
    tilt = offset @ torch.linalg.pinv(offset.T @ offset, hermitian=True)
    weight = whole * GRAVITY
    middle = pairs.index_add(0, group, particles * mass[:, None]) * GRAVITY
    lean = tilt @ (middle - weight[:, None] * center).sum(0)
    gripped = ((group == held[..., None]) & contact).double()
    lift = (gripped / gripped.sum(-1, keepdim=True).clamp(min=1)).mean(-2)
    # fz acts at the grasp point: what lies beside the middle of the held groups' feet tilts
    aside = tilt @ (center[held].mean(-2) - load.point).T
    return OwnWeight(share, lean, torch.cat([aside.T[..., None] - lift[..., None], tilt.expand(len(lift), -1, -1)], -1))


def own_weight_loads(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> Float[Tensor, "K P"]:
    """N_i with every mass group on its own weight, N."""
    return own_weight(model, mass, load).loads(load)


def rigid_loads(model: ParticleModel, mass: Float[Tensor, "P"], load: GripperLoad) -> Float[Tensor, "K P"]:
    """One rigid body: N_i = a + b x_i + c y_i over the particles in contact, from the balance of force and moments."""
    from_grasp = model.particles[None] - load.point[:, None]
    total = mass.sum() * GRAVITY
    moment = GRAVITY * torch.einsum("p,kpd->kd", mass, from_grasp) + load.moment
    wanted = torch.cat([(total - load.lift)[:, None], moment], dim=1)
    basis = torch.cat([torch.ones_like(from_grasp[..., :1]), from_grasp], dim=2) * model.contact[None, :, None]
    gram = basis.transpose(1, 2) @ basis
    # a straight row of points carries no moment across itself: the least-norm solution leaves that part out
    coefficients = torch.linalg.pinv(gram, rtol=1e-9, hermitian=True) @ wanted[..., None]
    return (basis @ coefficients)[..., 0]


def contact_spread(model: ParticleModel, mass: Float[Tensor, "P"]) -> Float[Tensor, "P w"]:
    """Standard deviations by which loads on points of contact may differ from `rigid_loads`, N: a column a direction.

    Balance decides the loads of three points. A rigid body on more rests on three of them, and nobody knows on which:
    every three with the center of mass between them are as likely, about the even foundation's loads. Shape (P, 0) for
    three points, and for feet under cells, which give way.
    """
    points = torch.nonzero(model.is_contact).flatten()
    none = torch.zeros(len(mass), 0, dtype=torch.float64)
    if len(points) <= 3:
        return none
    basis = torch.cat([torch.ones(len(points), 1, dtype=torch.float64), model.particles[points]], 1)
    weight = mass * GRAVITY
    wanted = torch.cat([weight.sum()[None], weight @ model.particles])
    middle = rigid_loads(model, mass, GripperLoad.none())[0, points]
    size = (basis[:, 1:].amax(0) - basis[:, 1:].amin(0)).prod()
    apart = []
    for three in combinations(range(len(points)), 3):
        corners = basis[list(three)]
        if torch.linalg.det(corners).abs() > 1e-6 * size:
            loads = torch.zeros_like(middle)
            loads[list(three)] = torch.linalg.solve(corners.T, wanted)
            apart += [loads - middle] if bool((loads >= 0).all()) else []
    if not apart:  # the weight acts outside them: the estimate is on its way
        return none
    _, strength, ways = torch.linalg.svd(torch.stack(apart) / len(apart) ** 0.5, full_matrices=False)
    spread = torch.zeros(len(mass), len(strength), dtype=torch.float64)
    spread[points] = ways.T * strength
    return spread


SupportModel = Literal["own_weight", "rigid"]
LoadsOf = Callable[[ParticleModel, Tensor, GripperLoad], Tensor]
"""Loads [N], (K, P), from particle masses [kg], (P,), and the gripper's load."""
ASSUMPTION = {"own_weight": "every mass group rests on its own weight", "rigid": "the object is one rigid body"}
"""Assumption of each support model, in words."""
LOADS: dict[str, LoadsOf] = {"own_weight": own_weight_loads, "rigid": rigid_loads}
