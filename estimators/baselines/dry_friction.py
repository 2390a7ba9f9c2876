"""One step of bodies with dry friction on straight sides, in numpy: the numerics of `estimators.baselines.lcp`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int

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


@dataclass(frozen=True, eq=False)
class Bodies:
    """B bodies for one step: F feet of J sides each, L = F J.

    Line j of foot i, by which the body's velocity v makes the side slide, is (e_j, e_j . arm_i).
    """

    mass: Float[np.ndarray, "B 3 3"]
    momentum: Float[np.ndarray, "B 3"]
    arms: Float[np.ndarray, "B F 3"]
    """Velocity of each foot by a unit turn, its place from the center of mass turned by 90 degrees [m]; and 1."""
    sides: Float[np.ndarray, "J 2"]
    bound: Float[np.ndarray, "B L"]
    """Largest impulse of each side [N s]; 0 on a foot without friction."""

    def subset(self, chosen: np.ndarray) -> Bodies:
        """Some of the bodies."""
        return Bodies(self.mass[chosen], self.momentum[chosen], self.arms[chosen], self.sides, self.bound[chosen])

    def sliding(self, velocity: Float[np.ndarray, "B 3"]) -> Float[np.ndarray, "B L"]:
        """Sliding speeds t = lines v."""
        by_arm = np.concatenate([velocity[:, 2:, None] * self.sides.T, (velocity[:, :2] @ self.sides.T)[:, None]], 1)
        return (self.arms @ by_arm).reshape(len(velocity), -1)

    def drag(self, impulse: Float[np.ndarray, "B L"]) -> Float[np.ndarray, "B 3"]:
        """lines^T f."""
        of_side = self.arms.swapaxes(1, 2) @ impulse.reshape(len(impulse), -1, len(self.sides))
        turning = (of_side[:, :2] * self.sides.T).sum((1, 2))
        return np.concatenate([of_side[:, 2] @ self.sides, turning[:, None]], 1)

    def lines(self, body: Int[np.ndarray, "P"], side: Int[np.ndarray, "P"]) -> Float[np.ndarray, "P 3"]:
        """Lines of some sides."""
        foot, which = np.divmod(side, len(self.sides))
        e = self.sides[which]
        return np.concatenate([e, (e * self.arms[body, foot, :2]).sum(1, keepdims=True)], 1)

    @property
    def across(self) -> Float[np.ndarray, "B 3 L"]:
        """lines^T."""
        across = np.empty((len(self.mass), 3, self.arms.shape[1], len(self.sides)))
        across[:, :2] = self.sides.T[:, None]
        across[:, 2] = self.arms[..., :2] @ self.sides.T
        return across.reshape(len(self.mass), 3, -1)

    @property
    def free(self) -> Float[np.ndarray, "B 3"]:
        """Velocity without friction."""
        return np.linalg.solve(self.mass, self.momentum[..., None])[..., 0]

    @property
    def squares(self) -> Float[np.ndarray, "B"]:
        """Sum of |arm|^2 over the feet [m^2]."""
        return np.einsum("bfk,bfk->b", self.arms, self.arms) - self.arms.shape[1]

    @property
    def stiffness(self) -> Float[np.ndarray, "B 1"]:
        """Stiffness of a sticking side [N s per m/s], `STIFFNESS` times the inertia that it holds."""
        feet = self.arms.shape[1]
        squares = np.square(self.sides).mean() * (2 * feet + self.squares)
        return STIFFNESS * (self.mass.trace(axis1=1, axis2=2) / squares * feet)[:, None]

    @property
    def speed(self) -> Float[np.ndarray, "B 1"]:
        """Sliding speed without friction [m/s], at least its root mean square over the sides."""
        v = self.free
        planar, turning = np.hypot(v[:, 0], v[:, 1]), np.abs(v[:, 2]) * np.sqrt(self.squares / self.arms.shape[1])
        return np.sqrt(np.square(self.sides).mean()) * (planar + turning)[:, None]


def solved(bodies: Bodies, guess: np.ndarray | None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Velocity (B, 3), impulses, and impulses over their bounds, both (B, L); `guess` is the last of
    these in a similar step: it saves work if its sticking set is nearly right.

    Raises:
        LcpError: no solution.
    """
    needed = "finite numbers and a positive definite mass"
    with np.errstate(all="ignore"):
        try:
            start = np.sign(bodies.sliding(bodies.free)) if guess is None else guess
            v, f, wrong = _exact(bodies, bodies.bound * start)
            for gap in GAPS:
                if not wrong.any():
                    break
                left = bodies.subset(wrong)
                v[wrong], f[wrong], wrong[wrong] = _exact(left, _interior_point(left, gap))
        except np.linalg.LinAlgError as error:
            raise LcpError("mass", bodies.mass, needed) from error
        used = f / bodies.bound
    if np.isnan(used).any():  # where there is no friction
        used = np.where(bodies.bound > 0, used, np.copysign(1.0, bodies.sliding(v)))
    lost = int((~np.isfinite(v).all(1)).sum())
    if lost:
        raise LcpError("step", f"{lost} of {len(v)} without a velocity", needed)
    return v, f, used


def bounds_of(feet: Float[np.ndarray, "B F"], count: int) -> Float[np.ndarray, "B L"]:
    """Bound of each of `count` sides of every foot; bounds below `IDLE` of the mean are 0."""
    kept = np.where(feet <= IDLE * feet.mean(1, keepdims=True), 0.0, feet)
    return kept.repeat(count, 1)


def _interior_point(bodies: Bodies, least: float) -> np.ndarray:
    """Mehrotra's predictor and corrector on |f| <= b; returns f, on its bound where the side slides.

    t = u - w with u, w >= 0, and (b - f) u and (b + f) w go to zero together; u and w are the two layers of z. Every
    step keeps M v + lines^T f = q and t = lines v, so that v is not needed. A side without friction is a line without
    length, which no bound matters to.
    """
    idle = bodies.bound <= 0
    b = np.where(idle, bodies.bound.mean(1, keepdims=True) + 1e-30, bodies.bound)
    across = np.where(idle[:, None], 0.0, bodies.across)

    def sliding(velocity: np.ndarray) -> np.ndarray:
        return (velocity[:, None] @ across)[:, 0]

    t = sliding(bodies.free)
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
        inverse = np.linalg.inv(bodies.mass + (across * weight[:, None]) @ across.swapaxes(1, 2))
        error = -weight * (z[0] - z[1])
        df = SIGN * (weight * sliding(_times(inverse, _times(across, error))) - error)
        dz = ratio * df - z
        step = _length(dz, df, z, slack)
        ahead = _mean(slack - step * df, z + step * dz) / gap
        centered = (ahead * ahead * ahead * gap + df * dz) / slack
        error = error + weight * (centered[0] - centered[1])
        df = weight * sliding(_times(inverse, _times(across, error))) - error
        change, df = df, SIGN * df
        dz = centered - z + ratio * df
        step = open_ * 0.995 * _length(dz, df, z, slack)
        f, slack, z = f + step * change, slack - step * df, z + step * dz
    return np.where(np.abs(z[0] - z[1]) * b < slack.min(0) * speed, f, np.sign(f) * b) * ~idle


def _mean(slack: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Mean of slack z over both layers of a body, shape (B, 1)."""
    return (slack * z).sum((0, 2))[:, None] / (2 * z.shape[2])


def _length(dz: np.ndarray, df: np.ndarray, z: np.ndarray, slack: np.ndarray) -> np.ndarray:
    """Longest step, at most 1, that keeps z and slack positive, shape (B, 1)."""
    return 1 / np.maximum(np.maximum(-dz / z, df / slack).max((0, 2)), 1.0)[:, None]


def _exact(bodies: Bodies, f: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Solve with the sticking set of f, and correct the set until friction and motion agree on every side.

    Returns velocity, impulse, and True where no agreement was found, shape (B,); f itself is the answer there, since a
    side at rest and at its bound at once has no set that settles.
    """
    first, all_, left = f, bodies, np.arange(len(f))
    velocity, impulse = np.zeros((len(f), 3)), f
    stiff, sticks = bodies.stiffness, np.abs(f) < STICKS * bodies.bound
    rest = -ROUNDING * bodies.speed
    for _ in range(MOST_ROUNDS):
        held = Held.of(bodies, sticks, stiff)
        carried, f = f.reshape(-1)[held.index], f.copy()
        f.reshape(-1)[held.index] = 0.0
        v, carried = held.solve(bodies.momentum - bodies.drag(f), carried)
        f.reshape(-1)[held.index] = carried
        t = bodies.sliding(v)
        t *= f
        off: np.ndarray = t < rest * bodies.bound  # friction that pushes along the motion
        most = bodies.bound.reshape(-1)[held.index]
        over = np.abs(carried) > most * (1 + ROUNDING)
        off.reshape(-1)[held.index] = over
        if len(left) == len(first):
            velocity, impulse = v, f.copy()
        else:
            velocity[left], impulse[left] = v, f
        still = np.asarray(off.any(1))
        left = left[still]
        if not len(left):
            break
        f.reshape(-1)[held.index] = np.where(over, np.copysign(most, carried), carried)
        sticks = sticks ^ off
        if len(left) < len(still):
            bodies, stiff, rest, f, sticks = bodies.subset(still), stiff[still], rest[still], f[still], sticks[still]
    wrong = np.zeros(len(velocity), dtype=bool)
    if len(left):
        wrong[left] = True
        given = all_.subset(wrong)
        impulse[left] = first[left]
        velocity[left] = np.linalg.solve(given.mass, (given.momentum - given.drag(first[left]))[..., None])[..., 0]
    return velocity, impulse, wrong


@dataclass(frozen=True, eq=False)
class Held:
    """B bodies whose sticking sides hold: P sides in all, at most S of one body."""

    index: Int[np.ndarray, "P"]
    """Each side's place among all B L."""
    body: Int[np.ndarray, "P"]
    slot: Int[np.ndarray, "P"]
    """Place of each side among those of its body."""
    lines: Float[np.ndarray, "B S 3"]
    """Lines of the sides; zero where a body has fewer than S."""
    stiff: Float[np.ndarray, "B 1"]
    inverse: Float[np.ndarray, "B 3 3"]
    """Inverse of M + stiff lines^T lines."""

    @staticmethod
    def of(bodies: Bodies, sticks: Bool[np.ndarray, "B L"], stiff: Float[np.ndarray, "B 1"]) -> Held:
        """The bodies with these sides sticking."""
        index = np.flatnonzero(sticks)
        body, side = np.divmod(index, sticks.shape[1])
        count = np.bincount(body, minlength=len(sticks))
        slot = np.arange(len(body)) - (np.cumsum(count) - count)[body]
        lines = np.zeros((len(sticks), int(count.max(initial=0)), 3))
        lines[body, slot] = bodies.lines(body, side)
        inverse = np.linalg.inv(bodies.mass + stiff[..., None] * (lines.swapaxes(1, 2) @ lines))
        return Held(index, body, slot, lines, stiff, inverse)

    def solve(self, push: np.ndarray, first: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """v and impulses (P,) with M v + lines^T impulse = push and lines v = 0, from the impulses `first` (P,).

        Springs on the sides, then the same ones from the impulse that they have reached, and so on.
        """
        impulse = np.zeros(self.lines.shape[:2])
        impulse[self.body, self.slot] = first
        v = push
        for _ in range(ROUNDS):
            v = _times(self.inverse, push - (impulse[:, None] @ self.lines)[:, 0])
            impulse = impulse + self.stiff * _times(self.lines, v)
        return v, impulse[self.body, self.slot]


def _times(matrix: np.ndarray, vector: np.ndarray) -> np.ndarray:
    return (matrix @ vector[..., None])[..., 0]
