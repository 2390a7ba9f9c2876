"""Support models: the place where mass becomes normal load on the table.

Each takes the particle masses and what the gripper was measured to carry, and gives the load on every particle. All are
batched over K windows and differentiable. Loads are not clipped: a negative one means a lifted particle, and the caller
can see it.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from jaxtyping import Float, Int
from torch import Tensor

from estimators.particles.gripper_load import GripperLoad
from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY


@dataclass(frozen=True, eq=False)
class OwnWeight:
    """Own-weight loads: N_i = share_i g + lean_i, plus a linear response to what the gripper carries."""

    share: Float[Tensor, "P"]
    """Part of its mass group's mass that each particle carries, kg; 0 without contact."""
    lean: Float[Tensor, "P"]
    """What a weight beside the middle of its own feet adds to each particle's load, N; sums to 0 over a group."""
    response: Float[Tensor, "K P 3"]
    """Change of each particle's load with the gripper's lift (N per N) and moment (N per N m)."""

    def loads(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """N_i, N."""
        return self.share * GRAVITY + self.lean + self.change(load)

    def change(self, load: GripperLoad) -> Float[Tensor, "K P"]:
        """What the gripper adds to each particle's load, N."""
        return (self.response @ load.carried[..., None])[..., 0]


def own_weight(
    particles: Float[Tensor, "P 2"],
    group: Int[Tensor, "P"],
    contact: Tensor,
    mass: Float[Tensor, "P"],
    load: GripperLoad,
) -> OwnWeight:
    """Every mass group on its own weight: N_i = m_i g, plus what the gripper adds.

    The held group's weight is lightened by fz. All groups share one tilt on a foundation of even stiffness, so
    each takes a part of the moment that is affine over its own feet: the gripper's, and that of a weight beside
    its feet.

    Args:
        particles: m, object frame.
        group: mass group of each particle.
        contact: which particles touch, (P,) bool.
        mass: of each particle, kg.
        load: what the gripper carries; only where it holds the object counts here.

    Raises:
        InvalidValueError: a group without feet.
    """
    count = int(group.max()) + 1
    zeros = torch.zeros(count, dtype=torch.float64)
    feet = zeros.index_add(0, group, contact.double())
    if (feet == 0).any():
        clear = torch.nonzero(feet == 0).flatten().tolist()
        raise InvalidValueError(
            "friction_group", f"no foot under mass group {clear}", "a foot under each, on its own weight"
        )
    share = torch.where(contact, (zeros.index_add(0, group, mass) / feet)[group], 0.0)
    centre = (
        torch.zeros(count, 2, dtype=torch.float64).index_add(0, group, particles * contact[:, None]) / feet[:, None]
    )
    offset = (particles - centre[group]) * contact[:, None]
    tilt = offset @ torch.linalg.pinv(offset.T @ offset, hermitian=True)
    weight = zeros.index_add(0, group, mass) * GRAVITY
    middle = torch.zeros(count, 2, dtype=torch.float64).index_add(0, group, particles * mass[:, None]) * GRAVITY
    lean = tilt @ (middle - weight[:, None] * centre).sum(0)
    gripped = (group == load.held[:, None]) & contact
    lift = gripped / gripped.sum(-1, keepdim=True).clamp(min=1)
    # fz acts at the grasp point: what lies beside the middle of the held group's feet tilts
    aside = tilt @ (centre[load.held] - load.point).T
    return OwnWeight(share, lean, torch.cat([aside.T[..., None] - lift[..., None], tilt.expand(len(lift), -1, -1)], -1))


def rigid_loads(
    particles: Float[Tensor, "P 2"], contact: Tensor, mass: Float[Tensor, "P"], load: GripperLoad
) -> Float[Tensor, "K P"]:
    """One rigid body: N_i = a + b x_i + c y_i over the particles in contact, from the balance of force and moments."""
    from_grasp = particles[None] - load.point[:, None]
    total = mass.sum() * GRAVITY
    moment = GRAVITY * torch.einsum("p,kpd->kd", mass, from_grasp) + load.moment
    wanted = torch.cat([(total - load.lift)[:, None], moment], dim=1)
    basis = torch.cat([torch.ones_like(from_grasp[..., :1]), from_grasp], dim=2) * contact[None, :, None]
    gram = basis.transpose(1, 2) @ basis
    # a straight row of points carries no moment across itself: the least-norm solution leaves that part out
    coefficients = torch.linalg.pinv(gram, rtol=1e-9, hermitian=True) @ wanted[..., None]
    return (basis @ coefficients)[..., 0]
