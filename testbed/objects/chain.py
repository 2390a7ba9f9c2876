"""Chain: links of an articulated object, each joined to the next by a vertical hinge, and how they move."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError
from testbed.frames import perpendicular
from testbed.validation import ReadOnlyArrays, freeze_arrays

MOST_LINKS = 3
"""Most links of a chain."""


@dataclass(frozen=True, eq=False)
class Chain(ReadOnlyArrays):
    """Links of an object and the geometry of its hinges, which methods know; the friction of the hinges is hidden.

    The layout of the object is that of the chain before a trial.
    """

    link: Int[np.ndarray, "n_m"]
    """Link of each mass group, 0 to n_links - 1, (n_m,)."""
    hinges: Float[np.ndarray, "H 2"]
    """Place of the hinge between each link and the next [m], object frame, (n_links - 1, 2)."""

    def __post_init__(self) -> None:
        freeze_arrays(self, hinges=(None, 2))
        link = np.array(self.link)
        if link.ndim != 1 or sorted(set(link.tolist())) != list(range(len(self.hinges) + 1)):
            allowed = f"links 0 to {len(self.hinges)}, each with a mass group, for {len(self.hinges)} hinges"
            raise InvalidValueError("Chain.link", link.tolist(), allowed)
        if not 1 <= len(self.hinges) < MOST_LINKS:
            raise InvalidValueError("Chain.hinges", f"{len(self.hinges)} hinges", f"1 to {MOST_LINKS - 1}")
        link.flags.writeable = False
        object.__setattr__(self, "link", link)

    @property
    def links(self) -> int:
        """Number of links."""
        return len(self.hinges) + 1

    def beyond(self, hinge: int, held: int) -> list[int]:
        """Links that trail behind a hinge where the hand holds link `held`, the nearest first."""
        return list(range(hinge + 1, self.links)) if held <= hinge else list(range(hinge, -1, -1))

    def outward(self, held: int) -> Iterator[tuple[int, int, int]]:
        """Links other than the held one, each with its neighbor toward the hand and the hinge between them."""
        for step in (1, -1):
            for link in range(held + step, self.links if step > 0 else -1, step):
                yield link, link - step, min(link, link - step)

    def moved(
        self,
        held: int,
        point: Float[np.ndarray, "2"],
        twist: Float[np.ndarray, "S 3"],
        acceleration: Float[np.ndarray, "3"],
        turned: Float[np.ndarray, "S L 3"],
    ) -> Float[np.ndarray, "S L 9"]:
        """Motion of every link relative to the grasp point, in the axes of the held link.

        A particle at p in the object frame is at R(angle) (p - point) + shift from the point; its velocity there is
        (u, v) + rate x place, and its acceleration (a, b) + slope x place - rate^2 place.

        Args:
            held: link in the hand.
            point: grasp point [m], object frame.
            twist: velocity of that point and turn rate of that link [m/s, rad/s], over S parts of a window.
            acceleration: its acceleration [m/s^2, rad/s^2].
            turned: angle of each link relative to the held one [rad], and its own angular velocity [rad/s] and
                acceleration [rad/s^2].

        Returns:
            (angle, shift x, y; u, v, rate; a, b, slope) [rad, m; m/s, rad/s; m/s^2, rad/s^2].
        """
        found = np.zeros((len(twist), self.links, 9))
        found[:, held, 3:6], found[:, held, 6:] = twist, acceleration
        for link, nearer, index in self.outward(held):
            near, here, hinge = found[:, nearer], found[:, link], self.hinges[index] - point
            angle, rate, slope = turned[:, link].T
            joint = _turn(near[:, 0], hinge) + near[:, 1:3]
            here[:, 0], here[:, 5], here[:, 8] = angle, rate, slope
            here[:, 1:3] = joint - _turn(angle, hinge)
            side = perpendicular(joint)
            here[:, 3:5] = near[:, 3:5] + (near[:, 5] - rate)[:, None] * side
            squares = (near[:, 5] ** 2 - rate**2)[:, None]
            here[:, 6:8] = near[:, 6:8] + (near[:, 8] - slope)[:, None] * side - squares * joint
        return found


def checked_torques(name: str, torques: Iterable[float], chain: Chain | None) -> tuple[float, ...]:
    """Torque of Coulomb friction of each hinge of a chain [N m]; zeros if left out, none without a chain.

    Raises:
        InvalidValueError: another number of torques, or one out of range.
    """
    hinges = 0 if chain is None else len(chain.hinges)
    given = tuple(torques)
    checked = given or (0.0,) * hinges
    if len(checked) != hinges or any(not 0 <= torque < 100 for torque in checked):
        raise InvalidValueError(name, given, f"{hinges} torques >= 0, < 100 N m")
    return checked


def velocities(own: Float[np.ndarray, "S P 9"], offsets: Float[np.ndarray, "... P 2"]) -> Float[np.ndarray, "S P 2"]:
    """Velocities of particles [m/s] by the motions `own` of their links.

    Args:
        own: motion of the link of each particle.
        offsets: place of each particle from the grasp point in the object's layout [m].
    """
    place = _turn(own[..., 0], offsets) + own[..., 1:3]
    return own[..., 3:5] + own[..., 5:6] * perpendicular(place)


def _turn(angle: Float[np.ndarray, "..."], vector: Float[np.ndarray, "... 2"]) -> Float[np.ndarray, "... 2"]:
    return np.cos(angle)[..., None] * vector + np.sin(angle)[..., None] * perpendicular(vector)
