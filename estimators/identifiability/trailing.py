"""Trailing links: motion of an articulated object whose hand moves one link, the others move by friction and inertia.

Each step finds the turn rates of least power: of Coulomb friction under the particles and in the hinges, and of the
change of their momentum. The power is convex in the rates, so a hinge at rest is no special case.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.actions.base import Action
from testbed.actions.path import Profile
from testbed.frames import perpendicular, rotation_2d
from testbed.objects.chain import Chain, velocities
from testbed.objects.model import ObjectShape

SLOW = 1e-4
"""Speed of a particle at which its friction fades [m/s], and rate of a hinge in tenths of rad/s."""
GUESS = 0.01
"""Friction of a hinge before any trial [N m]. Ours: a hinge of more friction rests sooner and is less observable."""
ROUNDS = 5
"""Iterations for the rates of a step; each weights friction by the speeds of the iteration before."""


class TrailingMotion(NamedTuple):
    """Motion of L links at N times since the hand began to move."""

    profile: Profile
    """Progress of the hand at these times."""
    turned: Float[np.ndarray, "N L 3"]
    """Yaw [rad], rate and slope of every link, from a start at yaw 0."""


def trailing_motions(
    shape: ObjectShape,
    mass: Float[np.ndarray, "P"],
    friction: Float[np.ndarray, "P"],
    actions: Sequence[Action],
    step: float,
    hinge_friction: Sequence[float] | None = None,
) -> list[TrailingMotion]:
    """Motions of an object in links under slides and turns, sampled every `step` s, each from rest.

    Args:
        shape: geometry, with a chain.
        mass: mass of each particle [kg].
        friction: greatest friction of each [N].
        actions: slides and turns.
        step: time between samples [s].
        hinge_friction: torque of friction of each hinge [N m]; `GUESS` if left out.
    """
    chain = shape.chain
    assert chain is not None
    grasps = [shape.grasps[a.grasp] for a in actions if a.grasp is not None]
    held = np.array([chain.link[shape.pressed(grasp)[0]] for grasp in grasps])
    found: dict[int, TrailingMotion] = {}
    torque = np.full(len(chain.hinges), GUESS) if hinge_friction is None else np.array(hinge_friction)
    for link in np.unique(held):
        chosen = np.flatnonzero(held == link)
        links = _Links(shape, chain, int(link), mass, friction, torque)
        for index, motion in zip(
            chosen.tolist(), links.motions([actions[i] for i in chosen.tolist()], step), strict=True
        ):
            found[index] = motion
    return [found[index] for index in range(len(actions))]


class _Links:
    """Mechanics of a chain held by one link, in that link's axes."""

    def __init__(
        self, shape: ObjectShape, chain: Chain, held: int, mass: np.ndarray, friction: np.ndarray, torque: np.ndarray
    ):
        self.shape, self.chain, self.held, self.mass, self.friction = shape, chain, held, mass, friction
        self.torque, self.link = torque, chain.link[shape.mass_group]
        self.free = [link for link in range(chain.links) if link != held]
        self.spin = np.bincount(self.link, mass * shape.cell**2 / 6, chain.links)[self.free]
        self.across = np.diff(np.eye(chain.links), axis=0)  # rates of the hinges from those of the links

    def motions(self, actions: Sequence[Action], step: float) -> list[TrailingMotion]:
        """Motions of trials in grasps of this link, in one batch."""
        profiles = [action.profile(step) for action in actions]
        hands = [self._hand(action, profile) for action, profile in zip(actions, profiles, strict=True)]
        longest = max(map(len, hands))
        hand = np.array([np.pad(each, ((0, longest - len(each)), (0, 0))) for each in hands])
        point = np.array([action.hand(self.shape)[0] for action in actions])
        count = len(actions)
        angle, rate = np.zeros((2, count, len(self.free)))
        yaw, before, momentum = np.zeros(count), np.zeros(count), np.zeros((count, len(self.mass), 2))
        turned = np.zeros((count, longest, self.chain.links, 3))
        for sample in range(longest):
            twist = hand[:, sample]
            yaw = yaw + step * (before + twist[:, 2]) / 2
            ahead = angle + step * (rate - (before + twist[:, 2])[:, None] / 2)
            along, by_rate = self._velocities(point, twist, ahead)
            into = rotation_2d(-yaw)
            found = self._rates(along, by_rate, np.einsum("cij,cpj->cpi", into, momentum), twist[:, 2], rate, step)
            velocity = along + np.einsum("cf,cfpi->cpi", found, by_rate)
            momentum = np.einsum("cji,cpj->cpi", into, velocity)  # of a unit mass, world
            angle = ahead + step * (found - rate) / 2
            now = turned[:, sample]
            now[:, :, 0] = yaw[:, None]
            now[:, self.free, 0] += angle
            now[:, self.held, 1], now[:, self.free, 1] = twist[:, 2], found
            now[:, self.held, 2], now[:, self.free, 2] = (twist[:, 2] - before) / step, (found - rate) / step
            rate, before = found, twist[:, 2]
        return [TrailingMotion(p, each[: len(h)]) for p, each, h in zip(profiles, turned, hands, strict=True)]

    def _hand(self, action: Action, profile: Profile) -> Float[np.ndarray, "N 3"]:
        """Twist of the grasp point, axes of the held link."""
        point = action.hand(self.shape)[0]
        if action.turns:  # the profile is along the path, in both directions of turn
            rate = math.copysign(1.0, action.steady[0].speed) * profile.rate
            return rate[:, None] * np.array([*perpendicular(point - action.center(self.shape)), 1.0])
        return profile.rate[:, None] * np.array([*action.heading, 0.0])

    def _velocities(
        self, point: Float[np.ndarray, "C 2"], twist: Float[np.ndarray, "C 3"], angle: Float[np.ndarray, "C F"]
    ) -> tuple[Float[np.ndarray, "C P 2"], Float[np.ndarray, "C F P 2"]]:
        """Velocity of every particle by the hand alone, and a turn rate of each free link."""
        turned, still = np.zeros((len(point), self.chain.links, 3)), np.zeros(3)
        turned[:, self.free, 0] = angle
        offsets, none = self.shape.particles - point[:, None], np.zeros_like(twist)

        def velocity(twist: np.ndarray, turned: np.ndarray) -> np.ndarray:
            return velocities(self.chain.moved(self.held, point, twist, still, turned)[:, self.link], offsets)

        by_rate = []
        for link in self.free:
            turning = turned.copy()
            turning[:, link, 1] = 1.0
            by_rate.append(velocity(none, turning))
        return velocity(twist, turned), np.stack(by_rate, 1)

    def _rates(
        self,
        along: Float[np.ndarray, "C P 2"],
        by_rate: Float[np.ndarray, "C F P 2"],
        was: Float[np.ndarray, "C P 2"],
        spin: Float[np.ndarray, "C"],
        rate: Float[np.ndarray, "C F"],
        step: float,
    ) -> Float[np.ndarray, "C F"]:
        """Turn rates of the free links after one step [rad/s]: those of least power, by majorization of friction.

        Args:
            along: velocity of every particle by the hand alone [m/s].
            by_rate: its change with each rate [m].
            was: velocities one step before [m/s].
            spin: rate of the link in the hand [rad/s].
            rate: rates of the free links one step before [rad/s].
            step: the step [s].
        """
        hinge, fixed = self.across[:, self.free], spin[:, None] * self.across[:, self.held]
        heavy, turning = self.mass / step, np.diag(self.spin / step)
        found = rate
        for _ in range(ROUNDS):
            velocity = along + np.einsum("cf,cfpi->cpi", found, by_rate)
            drag = self.friction / np.sqrt((velocity**2).sum(axis=-1) + SLOW**2)
            held = self.torque / np.sqrt((found @ hinge.T + fixed) ** 2 + (10 * SLOW) ** 2)
            weighed = by_rate * (heavy + drag)[:, None, :, None]
            system = np.einsum("cfpi,cgpi->cfg", weighed, by_rate) + turning
            system += np.einsum("ch,hf,hg->cfg", held, hinge, hinge)
            wanted = heavy[:, None] * was - (heavy + drag)[..., None] * along
            right = np.einsum("cfpi,cpi->cf", by_rate, wanted) + rate @ turning - (held * fixed) @ hinge
            found = np.linalg.solve(system, right[..., None])[..., 0]
        return found
