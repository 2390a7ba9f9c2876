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
from jaxtyping import Float, Int
from torch import Tensor
from torch.autograd.function import once_differentiable

from estimators.particles.model import Inertia, ParticleModel, cross, rotate, turned
from testbed.errors import InvalidValueError
from testbed.validation import check_integer

GAPS = (1e-6, 1e-11, 1e-15)
"""Duality gaps at which the interior point hands over to the exact solve, as parts of friction times speed; in turn
until the set settles."""
IDLE = 1e-12
"""Part of the mean bound below which a side has no friction."""
STICKS = 1 - 1e-9
"""Part of its bound below which a side sticks."""
STIFFNESS, ROUNDS = 1e3, 5
"""Stiffness of a sticking side relative to the body's inertia: what each round of the exact solve gains."""
ROUNDING = 1e-11
"""Tolerance of an impulse relative to its bound, and of a sliding speed relative to those without friction."""
MOST_ITERATIONS, MOST_ROUNDS = 40, 6
SIGN = np.array([1.0, -1.0])[:, None, None]
"""Signs of the two layers, u and w."""


class LcpError(InvalidValueError):
    """Step without a solution: inputs that are not finite, or a mass matrix that is not positive."""


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
    v, f, used = _solved(m, q, np.ascontiguousarray(sides.swapaxes(1, 2)), most, known)
    return Step(torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(used))


def _solved(
    mass: np.ndarray, momentum: np.ndarray, across: np.ndarray, bound: np.ndarray, guess: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`solve_step` in numpy; `across` is lines^T, shape (B, 3, L)."""
    most = np.maximum(bound, 0.0)
    mean = most.mean(1, keepdims=True) + 1e-30
    idle = most <= IDLE * mean
    some = bool(idle.any())
    bodies = _Bodies(mass, momentum, across, most)
    if some:  # no friction: a line without length
        bodies = _Bodies(mass, momentum, np.where(idle[:, None], 0.0, across), np.where(idle, mean, most))
    needed = "finite numbers and a positive definite mass"
    with np.errstate(all="ignore"):
        try:
            start = np.sign(bodies.sliding(_times(bodies.inverse(), momentum))) if guess is None else guess
            v, f, wrong = _exact(bodies, bodies.bound * start)
            for gap in GAPS:
                if not wrong.any():
                    break
                left = bodies.subset(wrong)
                v[wrong], f[wrong], wrong[wrong] = _exact(left, _interior_point(left, gap))
        except np.linalg.LinAlgError as error:
            raise LcpError("mass", mass, needed) from error
        used = f / bodies.bound
    if some:
        used, f = np.where(idle, np.copysign(1.0, (v[:, None] @ across)[:, 0]), used), np.where(idle, 0.0, f)
    lost = int((~np.isfinite(v).all(1)).sum())
    if lost:
        raise LcpError("step", f"{lost} of {len(v)} without a velocity", needed)
    return v, f, used


@dataclass(frozen=True, eq=False)
class _Bodies:
    """B bodies of L sides each, for one step."""

    mass: Float[np.ndarray, "B 3 3"]
    momentum: Float[np.ndarray, "B 3"]
    across: Float[np.ndarray, "B 3 L"]
    """lines^T, contiguous."""
    bound: Float[np.ndarray, "B L"]

    def subset(self, chosen: np.ndarray) -> _Bodies:
        return _Bodies(*(x[chosen] for x in (self.mass, self.momentum, self.across, self.bound)))

    def sliding(self, velocity: np.ndarray) -> np.ndarray:
        """Sliding speeds t, shape (B, L)."""
        return (velocity[:, None] @ self.across)[:, 0]

    def inverse(self, weight: np.ndarray | None = None) -> np.ndarray:
        """Inverse of M + lines^T weight lines, shape (B, 3, 3)."""
        if weight is None:
            return np.linalg.inv(self.mass)
        return np.linalg.inv(self.mass + (self.across * weight[:, None]) @ self.across.swapaxes(1, 2))


def _interior_point(bodies: _Bodies, least: float) -> np.ndarray:
    """Mehrotra's predictor and corrector on |f| <= b; returns f, on its bound where the side slides.

    t = u - w with u, w >= 0, and (b - f) u and (b + f) w go to zero together; u and w are the two layers of z. Every
    step keeps M v + lines^T f = q and t = lines v, so that v is not needed.
    """
    b = bodies.bound
    t = bodies.sliding(_times(bodies.inverse(), bodies.momentum))
    speed = np.abs(t).mean(1, keepdims=True) + 1e-30
    f, slack, z = np.zeros_like(b), np.stack([b, b]), np.maximum(SIGN * t, 0.0) + speed
    goal = least * b.mean(1, keepdims=True) * speed
    for _ in range(MOST_ITERATIONS):
        gap = _mean(slack, z)
        open_ = gap > goal
        if not open_.any():
            break
        ratio = z / slack
        weight = 1 / ratio.sum(0)
        inverse = bodies.inverse(weight)
        error = -weight * (z[0] - z[1])
        df = SIGN * (weight * bodies.sliding(_times(inverse, _times(bodies.across, error))) - error)
        dz = ratio * df - z
        step = _length(dz, df, z, slack)
        ahead = _mean(slack - step * df, z + step * dz) / gap
        centred = (ahead * ahead * ahead * gap + df * dz) / slack
        error = error + weight * (centred[0] - centred[1])
        df = weight * bodies.sliding(_times(inverse, _times(bodies.across, error))) - error
        change, df = df, SIGN * df
        dz = centred - z + ratio * df
        step = open_ * 0.995 * _length(dz, df, z, slack)
        f, slack, z = f + step * change, slack - step * df, z + step * dz
    return np.where(np.abs(z[0] - z[1]) * b < slack.min(0) * speed, f, np.sign(f) * b)


def _mean(slack: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Mean of slack z over both layers of a body, shape (B, 1)."""
    return (slack * z).sum((0, 2))[:, None] / (2 * z.shape[2])


def _length(dz: np.ndarray, df: np.ndarray, z: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Longest step, at most 1, that keeps z and slack positive, shape (B, 1)."""
    return 1 / np.maximum(np.maximum(-dz / z, df / slack).max((0, 2)), 1.0)[:, None]


def _exact(bodies: _Bodies, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve with the sticking set of f, and correct the set until friction and motion agree on every side.

    Returns velocity, impulse, and True where no agreement was found, shape (B,); f itself is the answer there, since a
    side at rest and at its bound at once has no set that settles.
    """
    free = _times(bodies.inverse(), np.stack([bodies.momentum, bodies.momentum - _times(bodies.across, f)]))
    velocity, impulse, left = free[1], f.copy(), np.arange(len(f))
    rest = ROUNDING * np.abs(bodies.sliding(free[0])).mean(1, keepdims=True)
    stiff, sticks = _stiffness(bodies.mass, bodies.across), np.abs(f) < STICKS * bodies.bound
    for _ in range(MOST_ROUNDS):
        held = _Held.of(bodies.mass, bodies.across, sticks, stiff)
        slides = np.where(sticks, 0.0, f)
        v, carried = held.solve(bodies.momentum - _times(bodies.across, slides), f)
        f = slides
        f[held.body, held.side] = carried
        off: np.ndarray = bodies.sliding(v) * f < -rest * bodies.bound  # friction that pushes along the motion
        most = bodies.bound[held.body, held.side]
        over = np.abs(carried) > most * (1 + ROUNDING)
        off[held.body, held.side] = over
        still = np.asarray(off.any(1))
        velocity[left[~still]], impulse[left[~still]] = v[~still], f[~still]
        left = left[still]
        if not len(left):
            break
        f[held.body, held.side] = np.where(over, np.copysign(most, carried), carried)
        sticks = sticks ^ off
        if len(left) < len(still):
            bodies, stiff, rest, f, sticks = bodies.subset(still), stiff[still], rest[still], f[still], sticks[still]
    wrong = np.zeros(len(velocity), dtype=bool)
    wrong[left] = True
    return velocity, impulse, wrong


@dataclass(frozen=True, eq=False)
class _Held:
    """B bodies whose sticking sides hold: P sides in all, at most S of one body."""

    body: Int[np.ndarray, "P"]
    side: Int[np.ndarray, "P"]
    slot: Int[np.ndarray, "P"]
    """Place of each side among those of its body."""
    lines: Float[np.ndarray, "B S 3"]
    """Lines of the sides; zero where a body has fewer than S."""
    stiff: Float[np.ndarray, "B 1"]
    inverse: Float[np.ndarray, "B 3 3"]
    """Inverse of M + stiff lines^T lines."""

    @staticmethod
    def of(mass: np.ndarray, across: np.ndarray, sticks: np.ndarray, stiff: np.ndarray) -> _Held:
        body, side = np.nonzero(sticks)
        count = np.bincount(body, minlength=len(sticks))
        slot = np.arange(len(body)) - (np.cumsum(count) - count)[body]
        lines = np.zeros((len(sticks), int(count.max(initial=0)), 3))
        lines[body, slot] = across[body, :, side]
        inverse = np.linalg.inv(mass + stiff[..., None] * (lines.swapaxes(1, 2) @ lines))
        return _Held(body, side, slot, lines, stiff, inverse)

    def solve(self, push: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """v and impulses (P,) with M v + lines^T impulse = push and lines v = 0, from the impulses of `first` (B, L).

        Springs on the sides, then the same ones from the impulse that they have reached, and so on.
        """
        impulse = np.zeros(self.lines.shape[:2])
        impulse[self.body, self.slot] = first[self.body, self.side]
        v = push
        for _ in range(ROUNDS):
            v = _times(self.inverse, push - (impulse[:, None] @ self.lines)[:, 0])
            impulse = impulse + self.stiff * _times(self.lines, v)
        return v, impulse[self.body, self.slot]


def _stiffness(mass: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Stiffness of a sticking side [N s per m/s], `STIFFNESS` times the inertia that it holds, shape (B, 1)."""
    inertia = mass.trace(axis1=1, axis2=2)
    flat = across.reshape(len(across), -1)
    return STIFFNESS * (inertia / (np.einsum("bi,bi->b", flat, flat) + 1e-30) * across.shape[2])[:, None]


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


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
        v, f, used = _solved(mass.numpy(), momentum.numpy(), across, most, None if guess is None else guess.numpy())
        step = Step(torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(used))
        ctx.save_for_backward(mass, torch.from_numpy(across), sides, step.velocity, step.impulse, step.used)
        ctx.mark_non_differentiable(step.used)
        return step.velocity, step.used

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        mass, across, sides, v, f, used = (x.numpy() for x in ctx.saved_tensors)
        sticks = np.abs(used) < STICKS
        held = _Held.of(mass, across, sticks, _stiffness(mass, across))
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
        solved = []
        for k in range(self.substeps):
            part = (k + 1) / self.substeps
            u = wrench[0] * (1 - part) + wrench[1] * part
            yaw = pose[..., 2]
            torque = u[..., 2] + cross(rotate(yaw, grasp - inertia.com), u[..., :2])
            push = torch.cat([u[..., :2].expand(*batch, 2), torque[..., None].expand(*batch, 1)], -1)
            momentum = (diagonal * velocity + h * push).expand(*batch, 3).reshape(-1, 3)
            arms = turned(rotate(yaw[..., None], levers)).expand(*batch, -1, -1).reshape(len(bound), -1, 2)
            moved, used = _Solve.apply(mass, momentum, arms, bound, sides, guesses[k] if guesses else None)
            solved.append(used)
            velocity = moved.reshape(*batch, 3)
            pose = pose + h * velocity
        if guesses is not None:
            guesses[:] = solved
        return pose, velocity
