"""Time stepping of the planar particle body with Coulomb friction by linear complementarity, batched with gradient.

Velocity level (Cline 2002; de Avila Belbute-Peres et al. 2018; Song and Boularias 2020): over a step h the impulse of
particle i lies in a polygon with corners c_i d_k, c_i = h mu_i N_i, and the velocity v after it obeys

    M (v - v_before) = h u + sum_i J_i^T sum_k d_k beta_ik,
    0 <= beta_ik  _|_  lambda_i + d_k . J_i v >= 0,     0 <= lambda_i  _|_  c_i - sum_k beta_ik >= 0.

With the normal loads fixed these are the optimality conditions of a convex problem in the body's three velocities,

    min_v  1/2 (v - v_free)^T M (v - v_free) + sum_i c_i max_k d_k . J_i v.

A regular polygon with an even number of corners is a sum of segments, so that maximum is a sum of |e_j . J_i v| over
the directions e_j of its sides, and each side is a dry friction of its own: f_ij in [-b_ij, b_ij] against t_ij =
e_j . J_i v. Exact solves, each with one 3 x 3 system, correct the set of sticking sides until all agree; if they cycle,
an interior-point method on the box of the impulses finds the set. That is in numpy, since a call on a few numbers costs
a third of torch's, and bodies do not mix: each gets the answer that it gets alone. The gradient follows from the same
3 x 3 system by implicit differentiation.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from torch import Tensor
from torch.autograd.function import once_differentiable

from estimators.baselines.dry_friction import STICKS, Held, solved, stiffness
from estimators.particles.model import Inertia, ParticleModel, cross, rotate, turned
from testbed.errors import InvalidValueError
from testbed.validation import check_integer


@dataclass(frozen=True, eq=False)
class Step:
    """A solved step: B bodies, L dry frictions each."""

    velocity: Float[Tensor, "B 3"]
    """v after the step [m/s, rad/s]."""
    impulse: Float[Tensor, "B L"]
    """f of every side [N s]; it acts on the body with -lines^T f."""
    used: Float[Tensor, "B L"]
    """f over its bound, -1 to 1; inside, the side sticks. Serves as guess for a similar step."""


def polygon_sides(directions: int) -> Float[Tensor, "{directions//2} 2"]:
    """Sides of the regular polygon with `directions` corners on the unit circle, one of each parallel pair, halved.

    Raises:
        InvalidValueError: an odd number, or less than 4.
    """
    if isinstance(directions, bool) or not isinstance(directions, int) or directions < 4 or directions % 2:
        raise InvalidValueError("directions", directions, "an even integer >= 4")
    angle = torch.arange(directions // 2, dtype=torch.float64) * (2 * math.pi / directions)
    along = angle + math.pi / directions + math.pi / 2
    return math.sin(math.pi / directions) * torch.stack([along.cos(), along.sin()], -1)


def solve_step(
    mass: Float[Tensor, "B 3 3"],
    momentum: Float[Tensor, "B 3"],
    lines: Float[Tensor, "B L 3"],
    bound: Float[Tensor, "B L"],
    guess: Float[Tensor, "B L"] | None = None,
) -> Step:
    """min_v 1/2 v^T mass v - momentum . v + sum_l bound_l |lines_l . v|, for B bodies at once, without gradient.

    Args:
        mass: M, positive definite.
        momentum: M v_before + h u [N s, N m s].
        lines: one row per dry friction; t = lines v is its sliding speed.
        bound: largest impulse of each [N s], >= 0.
        guess: `used` of a similar step; it saves work if its sticking set is nearly right.

    Raises:
        LcpError: no solution.
    """
    m, q, sides, most = (x.detach().numpy() for x in (mass, momentum, lines, bound))
    known = None if guess is None else guess.detach().numpy()
    v, f, used = solved(m, q, np.ascontiguousarray(sides.swapaxes(1, 2)), most, known)
    return Step(torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(used))


class _Solve(torch.autograd.Function):
    """`solve_step` for bodies on F feet, with its gradient: line j of foot i is (e_j, e_j . arm_i), bound_i its own.

    Where M v - q + lines^T f = 0, and f = +-b on sliding sides while t = 0 on sticking ones, a small change obeys
    M dv + lines^T df = dq - dM v - dlines^T f, df = +-db on sliding sides, lines dv = -dlines v on sticking ones.
    """

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        mass: Float[Tensor, "B 3 3"],
        momentum: Float[Tensor, "B 3"],
        arms: Float[Tensor, "B F 2"],
        bound: Float[Tensor, "B F"],
        sides: Float[Tensor, "J 2"],
        guess: Float[Tensor, "B F*J"] | None,
    ) -> tuple[Float[Tensor, "B 3"], Float[Tensor, "B F*J"]]:
        (bodies, feet), e = bound.shape, sides.numpy()
        across = np.empty((bodies, 3, feet, len(e)))
        across[:, :2] = e.T[:, None]
        np.matmul(arms.numpy(), e.T, out=across[:, 2])
        across, most = across.reshape(bodies, 3, -1), bound.numpy().repeat(len(e), 1)
        v, f, used = solved(mass.numpy(), momentum.numpy(), across, most, None if guess is None else guess.numpy())
        step = Step(torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(used))
        ctx.save_for_backward(mass, torch.from_numpy(across), sides, step.velocity, step.impulse, step.used)
        ctx.mark_non_differentiable(step.used)
        return step.velocity, step.used

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        mass, across, sides, v, f, used = (x.numpy() for x in ctx.saved_tensors)
        sticks = np.abs(used) < STICKS
        held = Held.of(mass, across, sticks, stiffness(mass, across))
        p, holding = held.solve(gradients[0].numpy(), np.zeros_like(f))
        to_bound = np.where(sticks, 0.0, used) * (p[:, None] @ across)[:, 0]
        to_lines = f * p[:, 2:]
        to_lines[held.body, held.side] += holding * v[held.body, 2]
        shape = (len(v), -1, len(sides))
        found = (-p[..., None] * v[:, None], p, -to_lines.reshape(shape) @ sides, -to_bound.reshape(shape).sum(-1))
        return *(torch.from_numpy(x) for x in found), None, None


@dataclass(frozen=True)
class LcpEngine:
    """Time stepping of the particle body on the table, its friction cone a polygon."""

    directions: int = 8
    """Corners of the friction polygon; 4, 8, 16."""
    substeps: int = 4
    """Engine steps per sample of the record; the wrench goes linearly from one sample to the next."""

    def __post_init__(self) -> None:
        polygon_sides(self.directions)
        check_integer("LcpEngine.substeps", self.substeps)

    def advance(
        self,
        model: ParticleModel,
        inertia: Inertia,
        friction: Float[Tensor, "... P"],
        pose: Float[Tensor, "... 3"],
        velocity: Float[Tensor, "... 3"],
        wrench: tuple[Float[Tensor, "... 3"], Float[Tensor, "... 3"]],
        grasp: Float[Tensor, "... 2"],
        dt: float,
        guesses: list[Tensor] | None = None,
    ) -> tuple[Float[Tensor, "... 3"], Float[Tensor, "... 3"]]:
        """Pose and velocity of the center of mass after one step of the record; other arguments as in `acceleration`.

        Args:
            wrench: planar wrench about the grasped point at the beginning and at the end of the step.
            dt: step of the record [s].
            guesses: one guess per substep, or empty; receives this step's.
        """
        touching = model.contact
        levers = model.particles[touching] - inertia.com[..., None, :]
        sides = polygon_sides(self.directions)
        h = dt / self.substeps
        diagonal = torch.stack([inertia.mass, inertia.mass, inertia.about_com], -1)
        batch = torch.broadcast_shapes(
            pose.shape[:-1], velocity.shape[:-1], friction.shape[:-1], inertia.mass.shape, wrench[0].shape[:-1]
        )
        bound = (h * friction[..., touching]).clamp(min=0.0).expand(*batch, -1).reshape(-1, levers.shape[-2])
        mass = torch.diag_embed(diagonal).expand(*batch, 3, 3).reshape(-1, 3, 3)
        found = []
        for k in range(self.substeps):
            part = (k + 1) / self.substeps
            u = wrench[0] * (1 - part) + wrench[1] * part
            yaw = pose[..., 2]
            torque = u[..., 2] + cross(rotate(yaw, grasp - inertia.com), u[..., :2])
            push = torch.cat([u[..., :2].expand(*batch, 2), torque[..., None].expand(*batch, 1)], -1)
            momentum = (diagonal * velocity + h * push).expand(*batch, 3).reshape(-1, 3)
            arms = turned(rotate(yaw[..., None], levers)).expand(*batch, -1, -1).reshape(len(bound), -1, 2)
            moved, used = _Solve.apply(mass, momentum, arms, bound, sides, guesses[k] if guesses else None)
            found.append(used)
            velocity = moved.reshape(*batch, 3)
            pose = pose + h * velocity
        if guesses is not None:
            guesses[:] = found
        return pose, velocity
