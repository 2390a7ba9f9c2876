"""Lifts: hold the object still in the air and rock it; its height and angles at every moment."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import ClassVar, Self

import numpy as np
from jaxtyping import Float, Int

from testbed.actions.base import Action, ActionWords
from testbed.actions.path import LEAST_KNOTS, ToolPath, Way, level, minimum_jerk
from testbed.errors import InvalidValueError
from testbed.frames import rotation_2d, transform_point
from testbed.objects.model import ObjectShape
from testbed.validation import check_integer, check_positive_fields, is_number

STEEPEST = math.radians(30)
"""Greatest tilt in the air [rad]."""
CLEARANCE = 0.010
"""Least distance between table and object in the air [m]."""
RAISE_TIME = 1.5
"""Least time of the way up, and of the way down [s]."""
TILT_TIME = 0.8
"""Least time from level to a tilt, and back [s]."""
TILT_ACCELERATION = 1.0
"""Approximate greatest angular acceleration of such a move [rad/s^2]; a large tilt takes longer."""
LEAST_STRETCH = 0.4
"""Least time of half a move that counts as a stretch [s]: the arm lags behind in a shorter one."""

_RISE, _TILT = 4, math.radians(4)
"""Number of intervals between the knots of the way up, and angle between the knots of a tilt [rad]."""
_UP = np.array([0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0])


@dataclass(frozen=True)
class Lift(Action, kind="lift"):
    """Lift the object clear of the table, hold it still at tilts about its x and y axis, and rock it about all three.

    At rest, the wrench is the weight at the center of mass, without friction; rocking adds the second moments. The
    object rocks about the TCP between tilts of both signs, at one angular acceleration of alternating sign. Without
    swings it moves from tilt to tilt and stops at each.
    """

    in_air: ClassVar[bool] = True

    grasp: int
    """Index into the shape's grasps."""
    tilt: float = math.radians(6)
    """Greatest tilt about x and y, and turn about z, either way [rad]; 0 only holds it still and level."""
    acceleration: float = 2.5
    """Angular acceleration while rocking [rad/s^2]."""
    swings: int = 6
    """Stretches of such acceleration about each axis; 0 holds still at every tilt and does not rock."""
    hold: float = 2.0
    """Time held still, level and at every tilt [s]."""
    height: float = 0.08
    """Height over the table [m]; it goes higher where a tilt would touch it."""
    poses: int = 2
    """Tilts about x and about y at which it is held, evenly from one end to the other; about z, only at the ends."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (is_number(self.tilt) and 0 <= self.tilt <= STEEPEST):
            raise InvalidValueError("Lift.tilt", self.tilt, f"an angle from 0 to {STEEPEST:.2f}, rad")
        check_positive_fields(self, "acceleration", "hold", "height")
        object.__setattr__(self, "swings", check_integer("Lift.swings", self.swings, least=0, most=1000))
        object.__setattr__(self, "poses", check_integer("Lift.poses", self.poses, least=2, most=100))

    @classmethod
    def stop_and_go(cls, grasp: int, tilt: float = math.radians(20), poses: int = 4, hold: float = 2.0) -> Self:
        """Lift that stops at `poses` tilts about x and y, with moves slow enough to be stretches too.

        The stops determine M and c; the moves determine the inertia weakly.
        """
        fast = cls(grasp, tilt, swings=0, hold=hold, poses=poses)
        moved = 2 * fast.tilt / (fast.poses - 1)
        return replace(fast, acceleration=min(fast.acceleration, moved / LEAST_STRETCH**2)) if moved else fast

    @property
    def seconds(self) -> float:
        """Duration of the motion, from rest to rest [s]."""
        return _sampled(self)[0]

    @property
    def tilt_acceleration(self) -> float:
        """Angular acceleration of the rocking [rad/s^2]; 0 without a tilt."""
        return self.acceleration if self.tilt > 0 else 0.0

    def accelerates(self, segment: int) -> bool:
        """True if the object rocks or moves between tilts in a stretch; False at rest."""
        return _sampled(self)[1][segment]

    def clear_height(self, shape: ObjectShape) -> float:
        """Height over the table at which no tilt touches it [m]: `height`, or more."""
        reach = np.abs(shape.particles - shape.grasps[self.grasp].position).max() + shape.cell / 2
        return max(self.height, float(reach) * math.sin(self.tilt) + CLEARANCE)

    def sampled(self, step: float, height: float | None = None, speed: float = math.inf) -> LiftProfile:
        """Height and angles, sampled every `step` s.

        Args:
            step: time between ticks, s.
            height: height to lift to, such as `clear_height`, m; that of the action if left out.
            speed: greatest speed up and down, m/s.
        """
        return LiftProfile.of(self, step, self.height if height is None else height, speed)

    def tool_path(
        self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float, speed: float = math.inf
    ) -> ToolPath:
        """Path of the tool over an object that starts at a planar pose [m, m, rad], world: up, then about each axis.

        Every axis has a way of its own, since a redundant arm could return to a pose with other joint angles.
        """
        up = self.clear_height(shape)
        profile, (place, angle) = self.sampled(step, up, speed), self.hand(shape)
        hold = level(np.append(transform_point(pose, place), pose[2] + angle)[None])
        axes = np.eye(3)
        axes[:2, :2] = rotation_2d(pose[2]).T  # rows: the object's axes, world
        ways = [_straight(hold[0], _UP, np.linspace(0.0, up, _RISE + 1), profile.height, profile.height_rate)]
        count = max(LEAST_KNOTS, math.ceil(self.tilt / _TILT))
        angles = np.linspace(0.0, self.tilt, count + 1)
        knots = np.concatenate([-angles[:0:-1], angles])
        for axis, turned, rate in zip(axes if self.tilt > 0 else (), profile.angle.T, profile.rate.T, strict=False):
            ways.append(_straight(np.zeros(7), np.append(np.zeros(4), axis), knots, turned, rate))
        return ToolPath(step, profile.segment, tuple(ways))

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        tilts = f"{self.poses} tilts to {math.degrees(self.tilt):.0f} deg, " if self.poses > 2 else ""
        return ActionWords("lift", manner=f"{tilts}{self.swings} swings, held {self.hold:g} s")


def _straight(start: np.ndarray, along: np.ndarray, knots: np.ndarray, parameter: np.ndarray, rate: np.ndarray) -> Way:
    """Way with a constant derivative of the pose."""
    return Way(lambda p: start + np.outer(p, along), lambda p: np.tile(along, (len(p), 1)), knots, parameter, rate)


@lru_cache(maxsize=1024)
def _sampled(action: Lift) -> tuple[float, tuple[bool, ...]]:
    """Duration [s], and True for each stretch with acceleration."""
    step = 0.01
    profile = action.sampled(step)
    first = np.unique(profile.segment[profile.segment >= 0], return_index=True)[1]
    moving = (profile.acceleration[profile.segment >= 0][first] != 0).any(axis=1)
    return len(profile.height) * step, tuple(moving.tolist())


@dataclass(frozen=True, eq=False)
class LiftProfile:
    """Height and angles of a lift at N ticks; the first is one step after its start."""

    height: Float[np.ndarray, "N"]
    """Height over the pose on the table [m]."""
    height_rate: Float[np.ndarray, "N"]
    """Rate of `height` [m/s]."""
    angle: Float[np.ndarray, "N 3"]
    """Angle about the object's own x, y and z axis [rad]: one at a time, the others at 0."""
    rate: Float[np.ndarray, "N 3"]
    """Rate of `angle` [rad/s]."""
    acceleration: Float[np.ndarray, "N 3"]
    """Rate of `rate` [rad/s^2]."""
    segment: Int[np.ndarray, "N"]
    """Index of the stretch at rest or at constant acceleration that a tick belongs to; -1 outside."""

    @classmethod
    def of(cls, action: Lift, step: float, up: float, speed: float) -> Self:
        """Profile of a lift up to a height [m], sampled every `step` s, at no more than `speed` [m/s]."""
        parts: list[tuple[np.ndarray, np.ndarray, bool]] = []
        level = np.zeros(3)

        def still(height: float, angle: np.ndarray) -> None:
            n = max(round(action.hold / step), 1)
            parts.append(
                (np.full((n, 2), [height, 0.0]), np.stack([np.tile(angle, (n, 1))] + [np.zeros((n, 3))] * 2), True)
            )

        def move(seconds: float, height: tuple[float, float], begin: np.ndarray, end: np.ndarray) -> None:
            n = max(round(seconds / step), 1)
            x = np.arange(1, n + 1) / n
            done, rate = minimum_jerk(x)
            rate /= n * step
            way = height[1] - height[0]
            turned = np.stack([begin + np.outer(done, end - begin), np.outer(rate, end - begin), np.zeros((n, 3))])
            parts.append((np.column_stack([height[0] + done * way, rate * way]), turned, False))

        way_time = max(RAISE_TIME, 1.875 * up / speed)

        def tilt(begin: np.ndarray, end: np.ndarray) -> None:
            least = math.sqrt(5.77 * float(np.abs(end - begin).max()) / TILT_ACCELERATION)
            move(max(TILT_TIME, least), (up, up), begin, end)

        def go(axis: np.ndarray, begin: float, end: float, swings: int) -> float:
            for angle, rate, slope, steady in _swings(begin, end, swings, action.acceleration, step):
                flat = np.zeros(len(angle))
                turned = np.stack([np.outer(v, axis) for v in (angle, rate, flat + slope)])
                parts.append((np.column_stack([flat + up, flat]), turned, steady))
            return float(parts[-1][1][0, -1] @ axis)

        move(way_time, (0.0, up), level, level)
        still(up, level)
        angles = np.linspace(-action.tilt, action.tilt, action.poses).tolist()
        for index, axis in enumerate(np.eye(3) if action.tilt > 0 else ()):
            tilt(level, angles[0] * axis)
            still(up, angles[0] * axis)
            at, left = angles[0], angles[1:]
            if action.swings:
                at = go(axis, at, angles[-1], action.swings)
                still(up, at * axis)
                left = angles[1:] if action.swings % 2 else angles[-2:0:-1]
            for angle in left:
                at = go(axis, at, angle, 0)
                if index < 2 or abs(angle) == action.tilt:  # about z the wrench at rest does not change
                    still(up, at * axis)
            tilt(at * axis, level)
        move(way_time, (up, 0.0), level, level)

        numbers = np.cumsum([steady for _, _, steady in parts]) - 1
        segment = [
            np.full(len(h), number if steady else -1) for (h, _, steady), number in zip(parts, numbers, strict=True)
        ]
        heights, turns = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts], axis=1)
        return cls(heights[:, 0], heights[:, 1], turns[0], turns[1], turns[2], np.concatenate(segment))


def _swings(
    begin: float, end: float, swings: int, acceleration: float, step: float
) -> list[tuple[np.ndarray, np.ndarray, float, bool]]:
    """Angle, rate, acceleration and steadiness of each stretch of one sign, from rest at `begin` to rest.

    The first and the last stretch are half as long; they are not steady if there are swings between them.
    """
    stretch = math.sqrt(abs(end - begin) / acceleration)
    half = max(round(stretch / step), 1)
    slope = (end - begin) / (half * step) ** 2  # the acceleration that fits whole ticks
    counts = [half, *[2 * half] * swings, half]
    angle, rate, found = begin, 0.0, []
    for i, count in enumerate(counts):
        sign = slope * (-1) ** i
        t = np.arange(1, count + 1) * step
        steady = 0 < i <= swings or (not swings and stretch >= LEAST_STRETCH - 1e-9)
        found.append((angle + rate * t + sign * t**2 / 2, rate + sign * t, sign, steady))
        angle, rate = found[-1][0][-1], found[-1][1][-1]
    return found
