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
a third of torch's. The gradient follows from the same 3 x 3 system by implicit differentiation.
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
STIFFNESS = 1e5
"""Stiffness of a sticking side relative to the body's inertia: what each of three rounds of the exact solve gains."""
ROUNDING = 1e-11
"""Tolerance of an impulse relative to its bound, and of a sliding speed relative to those without friction."""
MOST_ITERATIONS, MOST_ROUNDS = 40, 6
SIGN = np.array([1.0, -1.0])[:, None, None]
"""Signs of the two layers, u and w."""
GRADIENT_STIFFNESS = 1e9
"""Stiffness of a sticking side relative to the body's inertia in the gradient, where it stands for infinity."""


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
    most = np.maximum(most, 0.0)
    mean = most.mean(1, keepdims=True) + 1e-30
    idle = most <= IDLE * mean
    bodies = _Bodies.of(m, q, sides, most)
    if idle.any():  # no friction: a line without length
        bodies = _Bodies.of(m, q, np.where(idle[..., None], 0.0, sides), np.where(idle, mean, most))
    needed = "finite numbers and a positive definite mass"
    with np.errstate(all="ignore"):
        try:
            start = np.sign(bodies.sliding(_times(bodies.inverse(), q))) if guess is None else guess.detach().numpy()
            v, f, wrong = _exact(bodies, bodies.bound * start)
            for gap in GAPS:
                if not wrong.any():
                    break
                left = bodies.subset(wrong)
                v[wrong], f[wrong], wrong[wrong] = _exact(left, _interior_point(left, gap))
        except np.linalg.LinAlgError as error:
            raise LcpError("mass", m, needed) from error
        used = f / bodies.bound
    if idle.any():
        used, f = np.where(idle, np.copysign(1.0, _times(sides, v)), used), np.where(idle, 0.0, f)
    lost = int((~np.isfinite(v).all(1)).sum())
    if lost:
        raise LcpError("step", f"{lost} of {len(v)} without a velocity", needed)
    return Step(torch.from_numpy(v), torch.from_numpy(f), torch.from_numpy(used))


@dataclass(frozen=True, eq=False)
class _Bodies:
    """B bodies of L sides each, for one step."""

    mass: Float[np.ndarray, "B 3 3"]
    momentum: Float[np.ndarray, "B 3"]
    across: Float[np.ndarray, "B 3 L"]
    """lines^T, contiguous."""
    squares: Float[np.ndarray, "B 9 L"]
    """l l^T of every line l."""
    bound: Float[np.ndarray, "B L"]

    @staticmethod
    def of(mass: np.ndarray, momentum: np.ndarray, lines: np.ndarray, bound: np.ndarray) -> _Bodies:
        across = np.ascontiguousarray(lines.swapaxes(1, 2))
        squares = (across[:, :, None] * across[:, None]).reshape(len(lines), 9, -1)
        return _Bodies(mass, momentum, across, squares, bound)

    def subset(self, chosen: np.ndarray) -> _Bodies:
        return _Bodies(*(x[chosen] for x in (self.mass, self.momentum, self.across, self.squares, self.bound)))

    def sliding(self, velocity: np.ndarray) -> np.ndarray:
        """Sliding speeds t, shape (B, L)."""
        return (velocity[:, None] @ self.across)[:, 0]

    def moved(self, inverse: np.ndarray, impulse: np.ndarray) -> np.ndarray:
        """inverse (momentum - lines^T impulse), shape (B, 3)."""
        return _times(inverse, self.momentum - _times(self.across, impulse))

    def inverse(self, weight: np.ndarray | None = None) -> np.ndarray:
        """Inverse of M + lines^T weight lines, shape (B, 3, 3)."""
        if weight is None:
            return np.linalg.inv(self.mass)
        return np.linalg.inv(self.mass + _times(self.squares, weight).reshape(-1, 3, 3))


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
    inverse = bodies.inverse()
    velocity, impulse, left = bodies.moved(inverse, f), f.copy(), np.arange(len(f))
    rest = ROUNDING * np.abs(bodies.sliding(_times(inverse, bodies.momentum))).mean(1, keepdims=True)
    stiff, sticks = _stiffness(bodies.mass, bodies.across, STIFFNESS), np.abs(f) < STICKS * bodies.bound
    for _ in range(MOST_ROUNDS):
        weight = sticks * stiff
        inverse = bodies.inverse(weight)
        # springs on the sticking sides, then the same ones from the impulse that they have reached, and once more
        once = bodies.moved(inverse, f)
        f = f + weight * bodies.sliding(once + _times(inverse, _times(bodies.mass, once)))
        v = bodies.moved(inverse, f)
        t = bodies.sliding(v)
        f = f + weight * t
        over = np.abs(f) > bodies.bound * (1 + ROUNDING)  # of sticking sides only: the others are at their bounds
        off: np.ndarray = over | (~sticks & (t * np.sign(f) < -rest))
        still = np.asarray(off.any(1))
        velocity[left[~still]], impulse[left[~still]] = v[~still], f[~still]
        left = left[still]
        if not len(left):
            break
        f, sticks = np.where(over, np.sign(f) * bodies.bound, f), sticks ^ off
        if len(left) < len(still):
            bodies, stiff, rest, f, sticks = bodies.subset(still), stiff[still], rest[still], f[still], sticks[still]
    wrong = np.zeros(len(velocity), dtype=bool)
    wrong[left] = True
    return velocity, impulse, wrong


def _stiffness(mass: np.ndarray, across: np.ndarray, times: float) -> np.ndarray:
    """Stiffness of a sticking side [N s per m/s], `times` the inertia that it holds, shape (B, 1)."""
    inertia = mass.trace(axis1=1, axis2=2)
    return times * (inertia / ((across * across).sum((1, 2)) + 1e-30) * across.shape[2])[:, None]


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]


class _Solve(torch.autograd.Function):
    """`solve_step` with its gradient.

    Where M v - q + lines^T f = 0, and f = +-b on sliding sides while t = 0 on sticking ones, a small change obeys
    (M + lines^T W lines) dv = dq - dM v - dlines^T f - lines^T (W dlines v + df), W infinite on sticking sides.
    """

    @staticmethod
    def forward(  # type: ignore[override]
        ctx: Any, mass: Tensor, momentum: Tensor, lines: Tensor, bound: Tensor, guess: Tensor | None
    ) -> tuple[Tensor, Tensor]:
        step = solve_step(mass, momentum, lines, bound, guess)
        ctx.save_for_backward(mass, lines, step.velocity, step.impulse, step.used)
        ctx.mark_non_differentiable(step.used)
        return step.velocity, step.used

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor) -> tuple[Tensor | None, ...]:  # type: ignore[override]
        mass, lines, v, f, used = ctx.saved_tensors
        sticks = (used.abs() < STICKS)[..., None]
        stiff = _stiffness(mass.numpy(), lines.numpy().swapaxes(1, 2), GRADIENT_STIFFNESS)
        weight = torch.where(sticks, torch.from_numpy(stiff)[..., None], 0.0)
        p = torch.linalg.solve(mass + lines.transpose(-1, -2) @ (weight * lines), gradients[0][..., None])
        along = lines @ p
        to_lines = -(f[..., None] @ p.transpose(-1, -2)) - (weight * along) @ v[:, None]
        to_bound = torch.where(sticks, 0.0, -used[..., None] * along)[..., 0]
        return -p @ v[:, None], p[..., 0], to_lines, to_bound, None


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
        zero = torch.zeros_like(inertia.mass)
        diagonal = torch.stack([inertia.mass, inertia.mass, inertia.about_com], -1)
        batch = torch.broadcast_shapes(
            pose.shape[:-1], velocity.shape[:-1], friction.shape[:-1], zero.shape, wrench[0].shape[:-1]
        )
        bound = (h * friction[..., touching, None]).expand(*batch, -1, len(sides)).flatten(-2)
        bound = bound.clamp(min=0.0).reshape(-1, bound.shape[-1])
        mass = torch.diag_embed(diagonal).expand(*batch, 3, 3).reshape(-1, 3, 3)
        solved = []
        for k in range(self.substeps):
            part = (k + 1) / self.substeps
            u = wrench[0] * (1 - part) + wrench[1] * part
            yaw = pose[..., 2]
            torque = u[..., 2] + cross(rotate(yaw, grasp - inertia.com), u[..., :2])
            push = torch.cat([u[..., :2].expand(*batch, 2), torque[..., None].expand(*batch, 1)], -1)
            momentum = diagonal * velocity + h * push
            arms = turned(rotate(yaw[..., None], levers))
            lines = torch.cat([sides.expand(*arms.shape[:-1], -1, -1), (arms @ sides.T)[..., None]], -1).flatten(-3, -2)
            lines = lines.expand(*batch, -1, -1).reshape(-1, *lines.shape[-2:])
            guess = guesses[k] if guesses else None
            moved, used = _Solve.apply(mass, momentum.expand(*batch, 3).reshape(-1, 3), lines, bound, guess)
            solved.append(used)
            velocity = moved.reshape(*batch, 3)
            pose = pose + h * velocity
        if guesses is not None:
            guesses[:] = solved
        return pose, velocity
