"""One step of bodies with dry friction on straight sides, in numpy: the numerics of `estimators.baselines.lcp`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError

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


def solved(
    mass: np.ndarray, momentum: np.ndarray, across: np.ndarray, bound: np.ndarray, guess: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """`solve_step` in numpy: velocity, impulses, and impulses over their bounds; `across` is lines^T, shape (B, 3, L).

    Raises:
        LcpError: no solution.
    """
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
    stiff, sticks = stiffness(bodies.mass, bodies.across), np.abs(f) < STICKS * bodies.bound
    for _ in range(MOST_ROUNDS):
        held = Held.of(bodies.mass, bodies.across, sticks, stiff)
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
class Held:
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
    def of(mass: np.ndarray, across: np.ndarray, sticks: np.ndarray, stiff: np.ndarray) -> Held:
        body, side = np.nonzero(sticks)
        count = np.bincount(body, minlength=len(sticks))
        slot = np.arange(len(body)) - (np.cumsum(count) - count)[body]
        lines = np.zeros((len(sticks), int(count.max(initial=0)), 3))
        lines[body, slot] = across[body, :, side]
        inverse = np.linalg.inv(mass + stiff[..., None] * (lines.swapaxes(1, 2) @ lines))
        return Held(body, side, slot, lines, stiff, inverse)

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


def stiffness(mass: np.ndarray, across: np.ndarray) -> np.ndarray:
    """Stiffness of a sticking side [N s per m/s], `STIFFNESS` times the inertia that it holds, shape (B, 1)."""
    inertia = mass.trace(axis1=1, axis2=2)
    flat = across.reshape(len(across), -1)
    return STIFFNESS * (inertia / (np.einsum("bi,bi->b", flat, flat) + 1e-30) * across.shape[2])[:, None]


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]
