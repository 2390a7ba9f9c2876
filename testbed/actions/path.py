"""Paths of object and tool in an action: progress in time, poses in space, and the table's edges."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any, NamedTuple, Self

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from testbed.frames import perpendicular, pose_from_point, rotation_2d, transform_point
from testbed.objects.model import ObjectShape

RAMP_TIME = 0.4
"""Time to reach constant speed and to stop [s]."""
PAUSE = 0.3
"""Time at constant speed before accelerations begin [s]."""
LEAST_KNOTS = 4
"""Least number of stretches between the knots of a way."""
WORKSPACE = (0.45, 0.0)
"""Middle of the workspace on the table [m], arm's base frame."""


def minimum_jerk(x: Any) -> tuple[Any, Any]:
    """Smooth progress from 0 to 1 at `x`, a number or an array from 0 to 1, and its derivative in `x`."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2


class Steady(NamedTuple):
    """A stretch of constant speed or constant acceleration along the path."""

    speed: float
    """Signed speed at its start [rad/s or m/s]."""
    acceleration: float
    """Signed acceleration [rad/s^2 or m/s^2]."""
    seconds: float
    """Duration [s]."""

    @property
    def end_speed(self) -> float:
        """Signed speed at its end [rad/s or m/s]."""
        return self.speed + self.acceleration * self.seconds


@dataclass(frozen=True, eq=False)
class Profile:
    """Progress of an action at N ticks; the first is one step after its start."""

    distance: Float[np.ndarray, "N"]
    """Distance along the path since the start [rad or m]."""
    rate: Float[np.ndarray, "N"]
    """Rate of `distance` [rad/s or m/s]."""
    segment: Int[np.ndarray, "N"]
    """Index of the steady stretch that a tick belongs to; -1 outside."""

    @classmethod
    def through(cls, stretches: Sequence[Steady], step: float) -> Self:
        """Profile through steady stretches, with ramps from and to rest wherever the speed would jump.

        Args:
            stretches: one or more; the sign of the first one's speed is the direction of the path.
            step: time between ticks [s].
        """
        knots, steady = _knots(stretches)
        times, speeds = np.array(knots).T
        t = np.arange(1, round(times[-1] / step) + 1) * step
        rate = np.interp(t, times, speeds)
        fine = np.interp(np.arange(0, len(t) * 10 + 1) * step / 10, times, speeds)
        distance = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) / 2) * step / 10])[10::10]
        segment = np.full(len(t), -1)
        for i, (begin, end) in enumerate(steady):
            segment[(t > begin + step / 2) & (t < end + step / 2)] = i
        return cls(distance, rate, segment)

    @property
    def length(self) -> float:
        """Greatest distance from the start [rad or m]."""
        return float(self.distance.max())


def motion_time(stretches: Sequence[Steady]) -> float:
    """Duration of a path through steady stretches, ramps and pauses included [s]; 0 without any."""
    return _knots(stretches)[0][-1][0] if stretches else 0.0


def _knots(stretches: Sequence[Steady]) -> tuple[list[tuple[float, float]], list[tuple[float, float]]]:
    """Corners (time, speed) of the speed along the path, and the begin and end of every steady stretch."""
    sign, knots, steady = math.copysign(1.0, stretches[0].speed), [(0.0, 0.0)], []

    def go(speed: float, seconds: float) -> None:
        knots.append((knots[-1][0] + seconds, sign * speed))

    go(stretches[0].speed, RAMP_TIME)
    if any(stretch.acceleration for stretch in stretches):
        go(stretches[0].speed, PAUSE)
    for stretch, following in pairwise([*stretches, None]):
        assert stretch is not None
        go(stretch.end_speed, stretch.seconds)
        steady.append((knots[-2][0], knots[-1][0]))
        if following is None or following.speed != stretch.end_speed:
            go(0.0, RAMP_TIME)
        if following is not None and following.speed != stretch.end_speed:
            go(following.speed, RAMP_TIME)
    return knots, steady


@dataclass(frozen=True, eq=False)
class PlanarPath:
    """Object on a turn about a point or a straight line; `part` runs from -0.5 at the start to 0.5 at the far end."""

    grasp: Float[np.ndarray, "2"]
    """Grasp point [m], object frame."""
    grasp_angle: float
    """Direction along which the pads close [rad], object frame."""
    pivot: Float[np.ndarray, "2"]
    """Center of the turn [m], object frame; of a slide, the grasp point."""
    center: Float[np.ndarray, "2"]
    """Position of the pivot at the middle of the path [m], world."""
    yaw: float
    """Yaw of the object at the middle of the path [rad], world."""
    turn: float
    """Angle of the whole path, signed [rad]; 0 of a slide."""
    slide: Float[np.ndarray, "2"]
    """Displacement over the whole path [m], world; 0 of a turn."""

    def object_pose(self, part: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """Planar pose of the object along the path [m, m, rad], world, shape (N, 3)."""
        yaw = part * self.turn + self.yaw
        return pose_from_point(self.center + part[:, None] * self.slide, self.pivot, yaw)

    def tool_pose(self, part: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """TCP position and yaw of the closing direction along the path [m, m, rad], world, shape (N, 3)."""
        poses = self.object_pose(part)
        return np.column_stack([transform_point(poses, self.grasp), poses[:, 2] + self.grasp_angle])

    def way(self, profile: Profile, spacing: float) -> Way:
        """Way of the tool along the path, its parameter from 0 to 1; knots at most `spacing` [rad or m] apart."""

        def slope(parameter: np.ndarray) -> np.ndarray:
            lever = self.tool_pose(parameter - 0.5)[:, :2] - self.center
            velocity = self.slide + self.turn * perpendicular(lever)
            return level(np.column_stack([velocity, np.full(len(parameter), self.turn)]))

        count = max(math.ceil(profile.length / spacing), LEAST_KNOTS)
        return Way(
            lambda parameter: level(self.tool_pose(parameter - 0.5)),
            slope,
            np.linspace(0.0, 1.0, count + 1),
            profile.distance / profile.length,
            profile.rate / profile.length,
        )

    def shifted(self, shift: tuple[float, float, float], about: tuple[float, float]) -> PlanarPath:
        """The path turned about a point [m, world] and then moved, by `shift` [m, m, rad]."""
        if not any(shift):
            return self
        turn, fixed = rotation_2d(shift[2]), np.array(about)
        center = fixed + turn @ (self.center - fixed) + shift[:2]
        return replace(self, center=center, yaw=self.yaw + shift[2], slide=turn @ self.slide)


@dataclass(frozen=True, eq=False)
class Way:
    """Curve of tool poses in one parameter, which starts at 0, and the parameter at N ticks.

    A pose is the position of the TCP [m], the yaw of the closing direction [rad], and the rotation vector that tilts
    the tool from straight down [rad].
    """

    pose: Callable[[Float[np.ndarray, "M"]], Float[np.ndarray, "M 7"]]
    """Poses at values of the parameter."""
    slope: Callable[[Float[np.ndarray, "M"]], Float[np.ndarray, "M 7"]]
    """Derivatives of the poses in the parameter."""
    knots: Float[np.ndarray, "K"]
    """Parameters between which joint angles are interpolated, 0 among them."""
    parameter: Float[np.ndarray, "N"]
    """Parameter at each tick."""
    rate: Float[np.ndarray, "N"]
    """Rate of `parameter` [1/s]."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """Path of the tool in an action, at N ticks of which the first is one step after its start.

    The poses are the sum of all ways. The first way has whole poses, with height 0 at the grip; the others have offsets
    from them, and move one after the other while the first is at its last knot.
    """

    step: float
    """Time between ticks [s]."""
    segment: Int[np.ndarray, "N"]
    """Index of the steady stretch that a tick belongs to; -1 outside."""
    ways: tuple[Way, ...]
    """Ways of the tool."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return len(self.segment) * self.step

    @property
    def start(self) -> Float[np.ndarray, "7"]:
        """First pose."""
        return self.ways[0].pose(np.zeros(1))[0]

    def at(self, time: float) -> tuple[Float[np.ndarray, "7"], Float[np.ndarray, "7"]]:
        """Pose and its rate at a time since the start [s], between ticks too; at rest before it and after the end."""
        tick = min(max(time / self.step, 0.0), len(self.segment))
        before, part = math.floor(tick), tick % 1
        pose, rate = np.zeros(7), np.zeros(7)
        for way in self.ways:
            ends = [(way.parameter[i - 1], way.rate[i - 1]) if i else (0.0, 0.0) for i in (before, math.ceil(tick))]
            parameter, speed = (1 - part) * np.array(ends[0]) + part * np.array(ends[1])
            pose += way.pose(np.array([parameter]))[0]
            if 0 < time < self.duration:
                rate += speed * way.slope(np.array([parameter]))[0]
        return pose, rate


def level(planar: Float[np.ndarray, "M 3"]) -> Float[np.ndarray, "M 7"]:
    """Poses (or derivatives) of a tool that points down at the height of the grip, from planar ones, (M, 7)."""
    found = np.zeros((len(planar), 7))
    found[:, [0, 1, 3]] = planar
    return found


LOW, HIGH = (-0.30, -0.60), (1.00, 0.60)
"""Opposite corners of the simulated table's top [m], arm's base frame; a test compares them with its MJCF."""
EDGES = ("far", "left", "near", "right")
"""Names of the table's edges as the arm faces them: the sides of +x, +y, -x and -y."""
OFFSET = np.array([HIGH[0], HIGH[1], -LOW[0], -LOW[1]])
"""Distance of each edge from the arm's base, outwards [m]."""
_OUTWARDS = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_HEADING = np.array([0.0, 0.5, 1.0, 1.5]) * math.pi


def outline(shape: ObjectShape) -> Float[np.ndarray, "K 2"]:
    """Corners of the convex hull of all particle cells [m], object frame, shape (K, 2)."""
    half = shape.cell / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = (shape.particles[:, None] + half).reshape(-1, 2)
    return corners[ConvexHull(corners).vertices]


def overhang(
    corners: Float[np.ndarray, "K 2"],
    pivot: Float[np.ndarray, "N 2"],
    center: Float[np.ndarray, "N 2"],
    yaw: Float[np.ndarray, "N"],
    turn: Float[np.ndarray, "N"],
    slide: Float[np.ndarray, "N 2"],
) -> Float[np.ndarray, "N 4"]:
    """Farthest reach of an object past each edge on its path [m], shape (N, 4); negative inside the table.

    Exact: the farthest point of an arc is one of its ends, or the point that heads straight for the edge.

    Args:
        corners: outline of the object [m], object frame.
        pivot: center of the turn [m], object frame.
        center: position of the pivot at the middle of the path [m], world.
        yaw: yaw of the object there [rad].
        turn: angle of the whole path [rad]; 0 of a slide.
        slide: displacement over the whole path [m], world; 0 of a turn.
    """
    lever = corners - pivot[:, None]
    radius = np.hypot(lever[..., 0], lever[..., 1])[..., None]
    middle = (np.arctan2(lever[..., 1], lever[..., 0]) + yaw[:, None])[..., None] - _HEADING
    half = np.abs(turn)[:, None, None] / 2
    off = np.abs(np.remainder(middle + math.pi, 2 * math.pi) - math.pi)  # angle from the heading at mid-path
    reach = (radius * np.cos(np.maximum(off - half, 0.0))).max(axis=1)
    return center @ _OUTWARDS.T + np.abs(slide @ _OUTWARDS.T) / 2 + reach - OFFSET


def overhang_of(shape: ObjectShape, path: PlanarPath) -> Float[np.ndarray, "4"]:
    """`overhang` of one path [m], shape (4,)."""
    each = (path.pivot, path.center, path.yaw, path.turn, path.slide)
    return overhang(outline(shape), *(np.asarray(value)[None] for value in each))[0]
