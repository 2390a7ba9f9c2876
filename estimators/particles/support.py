"""Support models: normal load of every particle on the table from the particle masses and the gripper's load.

All are batched over K windows and differentiable. Loads are not clipped: a negative one means a lifted particle, and
the caller can see it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import torch
from jaxtyping import Float
from torch import Tensor

from estimators.particles.gripper_load import GripperLoad
from estimators.particles.model import ParticleModel
from testbed.errors import InvalidValueError
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
    and that of a weight beside its feet.

    Args:
        model: particles of the object.
        mass: mass of each particle, kg.
        load: the gripper's load; only where it holds the object counts here.

    Raises:
        InvalidValueError: a group without feet.
    """
    particles, group, contact = model.particles, model.mass_group, model.contact
    count = int(group.max()) + 1
    zeros, pairs = torch.zeros(count, dtype=torch.float64), torch.zeros(count, 2, dtype=torch.float64)
    feet = zeros.index_add(0, group, contact.double())
    if (feet == 0).any():
        clear = torch.nonzero(feet == 0).flatten().tolist()
        given = f"no foot under mass group {clear}"
        raise InvalidValueError("friction_group", given, "a foot under each, on its own weight")
    whole = zeros.index_add(0, group, mass)
    share = torch.where(contact, (whole / feet)[group], 0.0)
    center = pairs.index_add(0, group, particles * contact[:, None]) / feet[:, None]
    offset = (particles - center[group]) * contact[:, None]
    tilt = offset @ torch.linalg.pinv(offset.T @ offset, hermitian=True)
    weight = whole * GRAVITY
    middle = pairs.index_add(0, group, particles * mass[:, None]) * GRAVITY
    lean = tilt @ (middle - weight[:, None] * center).sum(0)
    gripped = ((group == load.held[..., None]) & contact).double()
    lift = (gripped / gripped.sum(-1, keepdim=True).clamp(min=1)).mean(-2)
    # fz acts at the grasp point: what lies beside the middle of the held groups' feet tilts
    aside = tilt @ (center[load.held].mean(-2) - load.point).T
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


SupportModel = Literal["own_weight", "rigid"]
LoadsOf = Callable[[ParticleModel, Tensor, GripperLoad], Tensor]
"""Loads [N], (K, P), from particle masses [kg], (P,), and the gripper's load."""
ASSUMPTION = {"own_weight": "every mass group rests on its own weight", "rigid": "the object is one rigid body"}
"""Assumption of each support model, in words."""
LOADS: dict[str, LoadsOf] = {"own_weight": own_weight_loads, "rigid": rigid_loads}
