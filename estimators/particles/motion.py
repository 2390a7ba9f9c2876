"""Motion of an object in windows of its trials, measured or planned."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from testbed.objects.chain import velocities
from testbed.objects.model import ObjectShape
from testbed.sensing.windows import PARTS, SteadyWindow

STANDING, MOST_STANDING = 0.002, 0.2
"""Speed below which a particle of a link is at rest, m/s, and the largest part of a link's particles that are at rest
in a steady window: those near the center of its turn."""
ERROR_FACTOR = 2.0
"""Standard deviations of the camera's errors within which a whole link may be at rest, or start or stop."""
MAX_ACCELERATION = 0.8
"""Angular acceleration above which a link starts or stops, rad/s^2: its drag is not that of the mean motion."""


class Planned(NamedTuple):
    """Window of a planned action, over any number of parts; fields as in `SteadyWindow`."""

    trial: int
    accelerated: bool
    grasp: int | None
    point: np.ndarray | None
    since_tare: np.ndarray
    twists: np.ndarray
    acceleration: np.ndarray
    spin_square: float
    poses: np.ndarray
    begun: float = math.nan
    """Yaw of the object at the start of the action, rad; NaN of a push, in which the hand does not turn."""
    camera_errors: np.ndarray = np.zeros((9, 0))
    turned: np.ndarray = np.zeros((PARTS, 0, 3))
    turned_errors: np.ndarray = np.zeros((0, 3, 4))

    @property
    def twist(self) -> np.ndarray:
        """Mean twist, m/s and rad/s."""
        return self.twists.mean(axis=0)

    @property
    def yaw(self) -> np.ndarray:
        """Yaw of the object over the first part and the last, rad."""
        return self.poses[[0, -1], 2]


@dataclass(frozen=True, eq=False, kw_only=True)
class Motion:
    """Motion of an object in K windows of constant speed or constant acceleration, object axes."""

    since_tare: Float[Tensor, "K 2"]
    """Time from the tare to a window's first and last sample, s."""
    twist: Float[Tensor, "K 3"]
    """Velocity of the grasp point, m/s, and turn rate, rad/s."""
    twists: Float[Tensor, "K S 3"]
    """Twist over each of S equal parts of a window."""
    acceleration: Float[Tensor, "K 3"]
    """Acceleration of the grasp point, m/s^2, and angular acceleration, rad/s^2."""
    spin_square: Float[Tensor, "K"]
    """Mean square of the turn rate, rad^2/s^2."""
    grasp: Float[Tensor, "K 2"]
    """Grasp point, or mean position of a push's fingertip, m, object frame."""
    yaw: Float[Tensor, "K 2"]
    """Yaw of the object at a window's first and last sample, rad."""
    poses: Float[Tensor, "K S 3"]
    """Position of the TCP, m, and yaw of the object, rad, over each of the parts, world."""
    held: Int[Tensor, "K 2"]
    """Mass groups under the two pads; for a fingertip twice the group under it."""
    trial: Int[Tensor, "K"]
    """Index of each window's trajectory."""
    accelerated: Tensor
    """True for windows of constant acceleration, (K,) bool."""
    pushed: Tensor
    """True for windows of a push, whose motion is measured by a camera, not by the hand, (K,) bool."""
    camera_errors: Float[Tensor, "K 9 E"]
    """Errors of the object's pose, twist and acceleration, as `SteadyWindow.camera_errors`; (K, 9, 0) if no window
    is of a push."""
    links: Float[Tensor, "K S L 9"]
    """Motion of each link of an articulated object over each of the parts, as `Chain.moved`; L = 0 of a rigid one."""
    links_with_errors: Float[Tensor, "K E S L 9"]
    """`links` after one standard deviation of each error of their camera; the last is that of its delay."""

    def __len__(self) -> int:
        return len(self.grasp)

    @staticmethod
    def of(
        shape: ObjectShape, windows: Sequence[SteadyWindow | Planned], trial: Sequence[int], accelerated: Sequence[bool]
    ) -> Motion:
        """Motion in some windows.

        Args:
            shape: geometry and grasps.
            windows: the windows.
            trial: number of each one's trial.
            accelerated: True for those of constant acceleration.
        """
        held, moved = [_held(shape, each) for each in windows], [LinkMotion(shape, each) for each in windows]
        same = ("since_tare", "twist", "twists", "acceleration", "spin_square", "yaw", "poses", "camera_errors")
        values = {name: torch.tensor(np.array([getattr(each, name) for each in windows])) for name in same}
        pushed = torch.tensor([each.grasp is None for each in windows])
        values["camera_errors"] = values["camera_errors"] if pushed.any() else values["camera_errors"][..., :0]
        return Motion(
            **{name: value.double() for name, value in values.items()},
            grasp=torch.tensor(np.array([point for point, _ in held])),
            held=torch.tensor([groups for _, groups in held]),
            trial=torch.tensor(list(trial)),
            accelerated=torch.tensor(list(accelerated)),
            pushed=pushed,
            links=torch.tensor(np.array([each.links() for each in moved])),
            links_with_errors=torch.tensor(np.array([each.links_with_errors() for each in moved])),
        )


@dataclass(frozen=True, eq=False)
class LinkMotion:
    """Motion of the links in one window of an articulated object, measured or predicted."""

    shape: ObjectShape
    """Geometry; a rigid one has no links."""
    window: SteadyWindow | Planned
    """Measured or planned window."""

    @property
    def may_rest(self) -> bool:
        """True if part of a link is at rest, where friction is indeterminate, or if a link starts or stops."""
        chain = self.shape.chain
        assert chain is not None and self.window.grasp is not None
        margin = ERROR_FACTOR * np.linalg.norm(self.window.turned_errors[:, 2], axis=1)
        if (np.abs(self.window.turned[..., 2]) - margin > MAX_ACCELERATION).any():
            return True
        offsets = self.shape.particles - self.shape.grasps[self.window.grasp].position
        of = chain.link[self.shape.mass_group]
        links, off = self.links(), self.links_with_errors()
        each = ((links[:, k, None], off[:, :, k, None], offsets[of == k]) for k in range(chain.links))
        return any(self._at_rest(*link) for link in each)

    @staticmethod
    def _at_rest(
        link: Float[np.ndarray, "S 1 9"], link_off: Float[np.ndarray, "E S 1 9"], offsets: Float[np.ndarray, "P 2"]
    ) -> bool:
        """True if part of a link is at rest, or all of it may be; `offsets` are its particles', from the grasp, m."""
        moving, off = velocities(link, offsets), velocities(link_off, offsets)
        speed, errors = np.linalg.norm(moving, axis=-1).mean(0), np.linalg.norm((off - moving).mean(1), axis=(0, -1))
        return bool((speed < STANDING).mean() > MOST_STANDING or (speed < STANDING + ERROR_FACTOR * errors).all())

    def links(self) -> Float[np.ndarray, "S L 9"]:
        """Motion of every link as `Chain.moved`."""
        return self._moved(self.window.turned)

    def links_with_errors(self) -> Float[np.ndarray, "E S L 9"]:
        """`links` after each error of the camera: three of each link, and one of its delay for all."""
        turned, errors = self.window.turned, self.window.turned_errors
        links = np.eye(len(errors))[:, :, None]
        own = [link * errors[index, :, each] for index, link in enumerate(links) for each in range(3)]
        off = np.array([*own, errors[:, :, 3]])[:, None]
        moved = self._moved((turned + off).reshape(len(off) * PARTS, *turned.shape[1:]))
        return moved.reshape(len(off), *turned.shape[:2], 9)

    def _moved(self, turned: Float[np.ndarray, "R L 3"]) -> Float[np.ndarray, "R L 9"]:
        """Motion of every link by yaw, rate and slope, in rows of S parts each."""
        chain = self.shape.chain
        if chain is None or self.window.grasp is None:
            return np.zeros((len(turned), 0, 9))
        grasp = self.shape.grasps[self.window.grasp]
        held = int(chain.link[self.shape.pressed(grasp)[0]])
        # the hand's pose is known; the camera measures links relative to each other
        turned = turned - turned[:, held, None] * [1, 0, 0]
        twists = np.tile(self.window.twists, (len(turned) // PARTS, 1))
        return chain.moved(held, grasp.position, twists, self.window.acceleration, turned)


def _held(shape: ObjectShape, window: SteadyWindow | Planned) -> tuple[np.ndarray, tuple[int, int]]:
    """Reference point of moments, and the mass groups under the pads or the fingertip."""
    if window.grasp is not None:
        return shape.grasps[window.grasp].position, shape.pressed(shape.grasps[window.grasp])
    assert window.point is not None
    return window.point, touched(shape, window.point)


def touched(shape: ObjectShape, point: np.ndarray) -> tuple[int, int]:
    """Mass group that a fingertip touches at a point [m, object frame], twice: one for each of two pads."""
    group = int(shape.mass_group[np.linalg.norm(shape.particles - point, axis=1).argmin()])
    return group, group
