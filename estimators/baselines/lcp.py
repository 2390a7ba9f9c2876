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

from estimators.baselines.dry_friction import STICKS, Bodies, Held, bounds_of, solved
from estimators.wrench.model import Inertia, ParticleModel
from testbed.errors import InvalidValueError
from testbed.validation import check_integer


def polygon_sides(directions: int) -> Float[Tensor, "{directions//2} 2"]:
    """Sides of the regular polygon with `directions` corners on the unit circle, one of each parallel pair, halved.

    Raises:
        InvalidValueError: an odd number, or one that is not from 4 to 256.
    """
    if isinstance(directions, bool) or not isinstance(directions, int) or directions % 2 or not 4 <= directions <= 256:
        raise InvalidValueError("directions", directions, "an even integer >= 4 and <= 256")
    angle = torch.arange(directions // 2, dtype=torch.float64) * (2 * math.pi / directions)
    along = angle + math.pi / directions + math.pi / 2
    return math.sin(math.pi / directions) * torch.stack([along.cos(), along.sin()], -1)


class _Advance(torch.autograd.Function):
    """A step of B bodies with F feet, and its gradient: velocity after it, and the impulses over their bounds.

    Where M v - q + lines^T f = 0, and f = +-b on sliding sides while t = 0 on sticking ones, a small change obeys
    M dv + lines^T df = dq - dM v - dlines^T f, df = +-db on sliding sides, lines dv = -dlines v on sticking ones.
    Line j of foot i is (e_j, e_j . arm_i), arm_i its place from the center of mass turned by 90 degrees.
    """

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any,
        inertia: Float[Tensor, "B 3"],
        velocity: Float[Tensor, "B 3"],
        yaw: Float[Tensor, "B"],
        com: Float[Tensor, "B 2"],
        push: Float[Tensor, "B 3"],
        grasp: Float[Tensor, "B 2"],
        bound: Float[Tensor, "B F"],
        feet: Float[Tensor, "F 2"],
        sides: Float[Tensor, "J 2"],
        guess: Float[Tensor, "B F*J"] | None,
    ) -> tuple[Float[Tensor, "B 3"], Float[Tensor, "B F*J"]]:
        m, before, angle, c, u, g, b, x, e = (
            each.numpy() for each in (inertia, velocity, yaw, com, push, grasp, bound, feet, sides)
        )
        turn = np.stack([np.cos(angle), np.sin(angle)])
        held_at = _rotated(turn, g - c)
        momentum = m * before + u
        momentum[:, 2] += held_at[:, 0] * u[:, 1] - held_at[:, 1] * u[:, 0]
        lever = _rotated(turn[..., None], x - c[:, None])
        arms = np.stack([-lever[..., 1], lever[..., 0], np.ones_like(lever[..., 0])], -1)
        bodies = Bodies(m[:, None] * np.eye(3), momentum, arms, e, bounds_of(b, len(e)))
        v, f, used = solved(bodies, None if guess is None else guess.numpy())
        ctx.kept = (bodies, m, before, turn, u, held_at, lever, v, f, used)
        found = torch.from_numpy(used)
        ctx.mark_non_differentiable(found)
        return torch.from_numpy(v), found

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        bodies, m, before, turn, u, held_at, lever, v, f, used = ctx.kept
        sticks = np.abs(used) < STICKS
        held = Held.of(bodies, sticks, bodies.stiffness)
        p, holding = held.solve(gradients[0].numpy(), np.zeros(len(held.index)))
        spin, shape = p[:, 2], (*lever.shape[:2], -1)
        e = bodies.sides
        to_bound = (np.where(sticks, 0.0, -used) * bodies.sliding(p)).reshape(shape) @ np.ones(len(e))
        to_lines = f * p[:, 2:]
        to_lines.reshape(-1)[held.index] += holding * v[held.body, 2]
        to_lever = -(to_lines.reshape(shape) @ np.stack([e[:, 1], -e[:, 0]], 1))
        to_held = np.stack([spin * u[:, 1], -spin * u[:, 0]], 1)
        to_grasp = _rotated(turn * np.array([[1.0], [-1.0]]), to_held)
        to_com = -to_grasp - _rotated(turn * np.array([[1.0], [-1.0]]), np.ones(shape[1]) @ to_lever)
        to_yaw = np.einsum("bfk,bfk->b", to_lever, bodies.arms[..., :2])
        to_yaw += to_held[:, 1] * held_at[:, 0] - to_held[:, 0] * held_at[:, 1]
        to_push = np.stack([p[:, 0] - spin * held_at[:, 1], p[:, 1] + spin * held_at[:, 0], spin], 1)
        found = (p * (before - v), p * m, to_yaw, to_com, to_push, to_grasp, to_bound)
        return *(torch.from_numpy(each) for each in found), None, None, None


def _rotated(turn: np.ndarray, vector: np.ndarray) -> np.ndarray:
    """`vector` (..., 2) rotated by angles of cosine and sine `turn` (2, ...)."""
    (cosine, sine), x, y = turn, vector[..., 0], vector[..., 1]
    return np.stack([cosine * x - sine * y, sine * x + cosine * y], -1)


@dataclass(frozen=True)
class LcpEngine:
    """Time stepping of the particle body on the table, its friction cone a polygon."""

    directions: int = 8
    """Corners of the friction polygon; 4, 8, 16."""
    substeps: int = 4
    """Engine steps per sample of the record; the wrench is interpolated linearly between samples."""

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
        touching, h = model.contact, dt / self.substeps
        diagonal = torch.stack([inertia.mass, inertia.mass, inertia.about_com], -1)
        shapes = (x.shape[:-1] for x in (pose, velocity, friction, diagonal, wrench[0], grasp))
        batch = torch.broadcast_shapes(*shapes)

        def flat(values: Tensor) -> Tensor:
            return values.expand(*batch, -1).reshape(-1, values.shape[-1])

        bound = flat((friction if touching.all() else friction[..., touching]).clamp(min=0.0) * h)
        weight, com, held, place, moved = (flat(x) for x in (diagonal, inertia.com, grasp, pose, velocity))
        first, change = (flat(x * h) for x in (wrench[0], wrench[1] - wrench[0]))
        feet, sides, found = model.particles[touching], polygon_sides(self.directions), []
        for k in range(self.substeps):
            push = first + (k + 1) / self.substeps * change
            guess = guesses[k] if guesses else None
            moved, used = _Advance.apply(weight, moved, place[:, 2], com, push, held, bound, feet, sides, guess)  # pyright: ignore[reportGeneralTypeIssues]
            found.append(used)
            place = place + h * moved
        if guesses is not None:
            guesses[:] = found
        return place.reshape(*batch, 3), moved.reshape(*batch, 3)
