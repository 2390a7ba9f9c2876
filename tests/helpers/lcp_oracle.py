"""The time step of `estimators.baselines.lcp` alone and as the textbook's problem, a solver of the latter, rollouts.

Unknowns: the impulse beta_ik along each corner d_k of each contact's friction polygon, and its sliding speed lambda_i:
z = [beta; lambda] >= 0, w = matrix z + offset >= 0, z . w = 0 (Anitescu and Potra 1997; Cline 2002).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import scipy.linalg
import torch
from jaxtyping import Float
from torch import Tensor

from estimators.baselines.dry_friction import Bodies, bounds_of, solved
from estimators.baselines.lcp import LcpEngine, polygon_sides
from estimators.wrench.model import Inertia, ParticleModel, acceleration, step

MOST_ITERATIONS = 100


@dataclass(frozen=True, eq=False)
class Textbook:
    """One body's step: C contacts, K corners, n = C (K + 1) unknowns."""

    matrix: Float[np.ndarray, "n n"]
    """[[D^T M^-1 D, E], [-E^T, 0]], D the columns J_i^T d_k and E the contact of each."""
    offset: Float[np.ndarray, "n"]
    """[D^T v_free; c]: m/s, then N s."""
    columns: Float[np.ndarray, "3 CK"]
    """D."""
    corners: Float[np.ndarray, "K 2"]
    """d_k."""
    inverse: Float[np.ndarray, "3 3"]
    """M^-1."""
    free: Float[np.ndarray, "3"]
    """Velocity after the step without friction [m/s, rad/s]."""
    jacobians: Float[np.ndarray, "C 2 3"]
    """J_i, from the body's velocity to the contact's."""

    @staticmethod
    def of(
        mass: Float[np.ndarray, "3 3"],
        momentum: Float[np.ndarray, "3"],
        jacobians: Float[np.ndarray, "C 2 3"],
        bound: Float[np.ndarray, "C"],
        directions: int,
    ) -> Textbook:
        """The problem of M, M v_before + h u, contacts, h mu_i N_i and a polygon with `directions` corners."""
        angle = 2 * np.pi * np.arange(directions) / directions
        corners = np.column_stack([np.cos(angle), np.sin(angle)])
        columns = np.einsum("kd,cdn->nck", corners, jacobians).reshape(3, -1)
        inverse = np.linalg.inv(mass)
        owner = np.repeat(np.eye(len(bound)), directions, axis=0)
        matrix = np.block([[columns.T @ inverse @ columns, owner], [-owner.T, np.zeros((len(bound),) * 2)]])
        free = inverse @ momentum
        return Textbook(matrix, np.append(columns.T @ free, bound), columns, corners, inverse, free, jacobians)

    def velocity(self, z: Float[np.ndarray, "n"]) -> Float[np.ndarray, "3"]:
        """v = v_free + M^-1 D beta."""
        return self.free + self.inverse @ self.columns @ z[: self.columns.shape[1]]

    def residual(self, z: Float[np.ndarray, "n"]) -> float:
        """max |min(z, w)|, N s and m/s."""
        return float(np.abs(np.minimum(z, self.matrix @ z + self.offset)).max())

    def unknowns(
        self, velocity: Float[np.ndarray, "3"], impulse: Float[np.ndarray, "CS"], sides: Float[np.ndarray, "S 2"]
    ) -> Float[np.ndarray, "n"]:
        """z of a velocity and of every side's impulse, which acts with -sides^T impulse.

        A contact's impulse lies in the cone of two neighboring corners, so beta has at most two entries a contact.
        """
        count = len(self.corners)
        friction = -impulse.reshape(-1, len(sides)) @ sides
        beta = np.zeros((len(friction), count))
        turn = np.arctan2(friction[:, 1], friction[:, 0]) % (2 * np.pi)
        low = np.floor(turn * count / (2 * np.pi)).astype(int) % count
        for i, k in enumerate(low):
            pair = [k, (k + 1) % count]
            beta[i, pair] = np.maximum(np.linalg.solve(self.corners[pair].T, friction[i]), 0.0)
        speed = -(self.jacobians @ velocity) @ self.corners.T
        return np.append(beta.ravel(), speed.max(axis=1))


def interior_point(problem: Textbook, tolerance: float = 1e-10) -> Float[np.ndarray, "n"]:
    """Solution z by Mehrotra's predictor and corrector, with one dense LU of the n x n Newton matrix per iteration.

    Args:
        problem: step.
        tolerance: of z . w relative to its start, and of |w - matrix z - offset| relative to the offset.

    Raises:
        RuntimeError: no convergence in MOST_ITERATIONS.
    """
    matrix, offset = problem.matrix, problem.offset
    impulses = problem.columns.shape[1]
    push = offset[impulses:].mean() / len(problem.corners)
    speed = np.abs(offset[:impulses]).mean() + push * matrix.diagonal()[:impulses].mean()
    z = np.append(np.full(impulses, push), np.full(len(offset) - impulses, speed))
    w = np.append(np.full(impulses, speed), np.full(len(offset) - impulses, push))
    first = z @ w
    for _ in range(MOST_ITERATIONS):
        miss = matrix @ z + offset - w
        gap = z @ w
        if gap <= tolerance * first and np.abs(miss).max() <= tolerance * np.abs(offset).max():
            return z
        newton = scipy.linalg.lu_factor(matrix + np.diag(w / z), check_finite=False)
        dz = scipy.linalg.lu_solve(newton, -miss - w, check_finite=False)
        dw = matrix @ dz + miss
        reach = _reach(z, dz, w, dw)
        center = ((z + reach * dz) @ (w + reach * dw) / gap) ** 3 * gap / len(z)
        dz = scipy.linalg.lu_solve(newton, -miss - w - (dz * dw - center) / z, check_finite=False)
        dw = matrix @ dz + miss
        reach = 0.995 * _reach(z, dz, w, dw)
        z, w = z + reach * dz, w + reach * dw
    raise RuntimeError(f"the interior point did not end in {MOST_ITERATIONS} iterations")


def _reach(z: np.ndarray, dz: np.ndarray, w: np.ndarray, dw: np.ndarray) -> float:
    """Longest step, at most 1, that keeps z and w positive."""
    return 1 / max(1.0, (-dz / z).max(), (-dw / w).max())


def rollout(engine: LcpEngine, model, inertia, friction, pose, velocity, wrench, grasp, dt: float):
    """Poses and velocities after each of T wrenches in open loop; arguments as in `explicit_rollout`."""
    last, guesses = wrench.shape[-2] - 1, []

    def advance(t: int, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        ends = wrench[..., t, :], wrench[..., min(t + 1, last), :]
        return engine.advance(model, inertia, friction[..., t, :], pose, velocity, ends, grasp, dt, guesses)

    return _open_loop(last + 1, pose, velocity, advance)


def explicit_rollout(
    model: ParticleModel,
    inertia: Inertia,
    friction: Float[Tensor, "... T P"],
    pose: Float[Tensor, "... 3"],
    velocity: Float[Tensor, "... 3"],
    wrench: Float[Tensor, "... T 3"],
    grasp: Float[Tensor, "... 2"],
    dt: float,
) -> tuple[Float[Tensor, "... T 3"], Float[Tensor, "... T 3"]]:
    """Poses and velocities after each of T wrenches in open loop; friction is mu_i N_i at each step [N]."""

    def advance(t: int, pose: Tensor, velocity: Tensor) -> tuple[Tensor, Tensor]:
        a = acceleration(model, inertia, friction[..., t, :], pose, velocity, wrench[..., t, :], grasp)
        return step(pose, velocity, a, dt)

    return _open_loop(wrench.shape[-2], pose, velocity, advance)


def _open_loop(
    count: int, pose: Tensor, velocity: Tensor, advance: Callable[[int, Tensor, Tensor], tuple[Tensor, Tensor]]
) -> tuple[Tensor, Tensor]:
    """Poses and velocities after each of `count` steps."""
    poses, velocities = [], []
    for t in range(count):
        pose, velocity = advance(t, pose, velocity)
        poses.append(pose)
        velocities.append(velocity)
    return torch.stack(poses, -2), torch.stack(velocities, -2)


@dataclass(frozen=True, eq=False)
class Step:
    """A solved step: B bodies, L dry frictions each."""

    velocity: Float[Tensor, "B 3"]
    """v after the step [m/s, rad/s]."""
    impulse: Float[Tensor, "B L"]
    """f of every side [N s]; it acts on the body with -lines^T f."""
    used: Float[Tensor, "B L"]
    """f over its bound, -1 to 1; inside, the side sticks. Serves as guess for a similar step."""


def solve_step(
    mass: Float[Tensor, "B 3 3"],
    momentum: Float[Tensor, "B 3"],
    arms: Float[Tensor, "B F 2"],
    bound: Float[Tensor, "B F"],
    directions: int,
    guess: Float[Tensor, "B F*J"] | None = None,
) -> Step:
    """min_v 1/2 v^T mass v - momentum . v + sum_ij bound_i |line_ij . v|, for B bodies at once, without gradient.

    Args:
        mass: M, positive definite.
        momentum: M v_before + h u [N s, N m s].
        arms: place of each foot from the center of mass, turned by 90 degrees [m]: J_i = [1, arm_i].
        bound: largest impulse c_i of each foot [N s], >= 0.
        directions: corners of the polygon; line_ij = (e_j, e_j . arm_i) for its J sides e_j.
        guess: `used` of a similar step; it saves work if its sticking set is nearly right.

    Raises:
        LcpError: no solution.
    """
    m, q, at, most = (x.detach().numpy() for x in (mass, momentum, arms, bound))
    e = polygon_sides(directions).numpy()
    bodies = Bodies(m, q, np.concatenate([at, np.ones_like(at[..., :1])], -1), e, bounds_of(most, len(e)))
    return Step(*map(torch.from_numpy, solved(bodies, None if guess is None else guess.detach().numpy())))
