"""Steps of a body with dry friction on many sides: min over v of 1/2 v^T M v - q . v + sum_l b_l |l . v|, batched.

In numpy, since a call on a few numbers costs a third of torch's. Exact solves, each with one 3 x 3 system, correct the
set of sticking sides until all agree; if they cycle, an interior-point method on the box of the impulses finds the set.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError

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


class LcpError(InvalidValueError):
    """Step without a solution: inputs that are not finite, or a mass matrix that is not positive."""


def solve(
    mass: np.ndarray, momentum: np.ndarray, lines: np.ndarray, bound: np.ndarray, guess: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity, impulse, and impulse over bound; arguments and errors of `lcp.solve_step`, in numpy."""
    bound = np.maximum(bound, 0.0)
    mean = bound.mean(1, keepdims=True) + 1e-30
    idle = bound <= IDLE * mean
    bodies = _Bodies.of(mass, momentum, lines, bound)
    if idle.any():  # no friction: a line without length
        bodies = _Bodies.of(mass, momentum, np.where(idle[..., None], 0.0, lines), np.where(idle, mean, bound))
    needed = "finite numbers and a positive definite mass"
    with np.errstate(all="ignore"):
        try:
            start = guess if guess is not None else np.sign(bodies.sliding(_times(bodies.inverse(), momentum)))
            v, f, wrong = _exact(bodies, bodies.bound * start)
            for gap in GAPS:
                if not wrong.any():
                    break
                left = bodies.subset(wrong)
                v[wrong], f[wrong], wrong[wrong] = _exact(left, _interior_point(left, gap))
        except np.linalg.LinAlgError as error:
            raise LcpError("mass", mass, needed) from error
        used = f / bodies.bound
    if idle.any():
        used, f = np.where(idle, np.copysign(1.0, _times(lines, v)), used), np.where(idle, 0.0, f)
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
    stiff, sticks = stiffness(bodies.mass, bodies.across, STIFFNESS), np.abs(f) < STICKS * bodies.bound
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


def stiffness(mass: np.ndarray, across: np.ndarray, times: float) -> np.ndarray:
    """Stiffness of a sticking side [N s per m/s], `times` the inertia that it holds, shape (B, 1)."""
    inertia = mass.trace(axis1=1, axis2=2)
    return times * (inertia / ((across * across).sum((1, 2)) + 1e-30) * across.shape[2])[:, None]


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]
