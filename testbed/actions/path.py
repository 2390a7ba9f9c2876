"""How far along its path an action is at every moment: ramps, stretches at constant speed or acceleration, pauses."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import ConvexHull

from testbed.actions.base import Accelerate, Rotate, Slide, pivot_of
from testbed.frames import pose_from_point, rotation_2d, transform_point
from testbed.objects.model import ObjectShape

RAMP_TIME = 0.4
"""Time to reach constant speed and to stop, s."""
PAUSE = 0.3
"""Time at constant speed before accelerations begin, s."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Progress of an action at N ticks; the first is one step after its start."""

    step: float
    """Time between ticks, s."""
    distance: Float[np.ndarray, "N"]
    """Along the path since the start, rad (turns) or m (slides)."""
    rate: Float[np.ndarray, "N"]
    """rad/s or m/s."""
    segment: Int[np.ndarray, "N"]
    """Steady stretch that a tick belongs to, from 0; -1 outside."""

    @classmethod
    def of(cls, action: Rotate | Accelerate | Slide, step: float) -> Self:
        """The profile of an action, sampled every `step` s."""
        knots = [(0.0, 0.0)]
        spans: list[tuple[float, float]] = []

        def go(speed: float, seconds: float, *, steady: bool = False) -> None:
            begin, end = knots[-1][0], knots[-1][0] + seconds
            knots.append((end, speed))
            if steady:
                spans.append((begin, end))

        if isinstance(action, Accelerate):
            speed = abs(action.start_speed)
            go(speed, RAMP_TIME)
            go(speed, PAUSE)
            for acceleration in action.accelerations:
                speed += math.copysign(acceleration, acceleration * action.start_speed) * action.hold
                go(speed, action.hold, steady=True)
            go(0.0, RAMP_TIME)
        else:
            there = abs(action.speed)
            for speed in (there, -there) if isinstance(action, Rotate) and action.back else (there,):
                go(speed, RAMP_TIME)
                go(speed, action.duration, steady=True)
                go(0.0, RAMP_TIME)
        times, speeds = np.array(knots).T
        t = np.arange(1, round(times[-1] / step) + 1) * step
        rate = np.interp(t, times, speeds)
        fine = np.interp(np.arange(0, len(t) * 10 + 1) * step / 10, times, speeds)
        distance = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) / 2) * step / 10])[10::10]
        segment = np.full(len(t), -1)
        for i, (begin, end) in enumerate(spans):
            segment[(t > begin + step / 2) & (t < end + step / 2)] = i
        return cls(step, distance, rate, segment)

    @property
    def duration(self) -> float:
        """s."""
        return len(self.distance) * self.step

    @property
    def length(self) -> float:
        """Greatest distance from the start, rad or m."""
        return float(self.distance.max())

    def at(self, time: float) -> tuple[float, float]:
        """Distance and rate at a time since the start, s; at rest before it and after the end."""
        if not 0 < time < self.duration:
            return (0.0 if time <= 0 else float(self.distance[-1])), 0.0
        ticks = np.arange(len(self.distance) + 1) * self.step
        distance, rate = (np.concatenate([[0.0], values]) for values in (self.distance, self.rate))
        return float(np.interp(time, ticks, distance)), float(np.interp(time, ticks, rate))


WORKSPACE = (0.45, 0.0)
"""Where on the table things happen, m from the arm's base."""


@dataclass(frozen=True, eq=False)
class ToolPath:
    """A turn about a pivot, or a straight line; `part` runs over -0.5 to 0.5 from its start to its farthest point."""

    grasp: Float[np.ndarray, "2"]
    """Grasp point, m, object frame."""
    grasp_angle: float
    """Direction along which the pads close, rad, object frame."""
    pivot: Float[np.ndarray, "2"]
    """Point of the object about which it turns, m, object frame; of a slide, the grasp point."""
    centre: Float[np.ndarray, "2"]
    """Where the pivot is at the middle of the path, m, world."""
    yaw: float
    """Yaw of the object at the middle of the path, rad, world."""
    turn: float
    """Angle of the whole path, signed, rad; 0 of a slide."""
    slide: Float[np.ndarray, "2"]
    """Displacement over the whole path, m, world; 0 of a turn."""

    @classmethod
    def centred(
        cls, action: Rotate | Accelerate | Slide, shape: ObjectShape, length: float, middle: tuple[float, float]
    ) -> Self:
        """The path of `length` (rad or m) whose middle has the TCP at `middle` (m, world), the pads closing along x."""
        grasp = shape.grasps[action.grasp]
        path = cls._about(action, shape, length, np.array(middle), -grasp.angle)
        if isinstance(action, Slide):
            return path
        centre = transform_point(pose_from_point(path.centre, path.grasp, np.array(path.yaw)), path.pivot)
        return cls(path.grasp, path.grasp_angle, path.pivot, centre, path.yaw, path.turn, path.slide)

    @classmethod
    def from_object(
        cls,
        action: Rotate | Accelerate | Slide,
        shape: ObjectShape,
        length: float,
        pose: Float[np.ndarray, "3"],
    ) -> Self:
        """The path of `length` (rad or m) that starts where the object lies: planar pose, m and rad, world."""
        path = cls._about(action, shape, length, np.zeros(2), 0.0)
        yaw = float(pose[2]) + path.turn / 2
        slide = rotation_2d(yaw) @ path.slide
        centre = transform_point(np.asarray(pose, dtype=float), path.pivot) + slide / 2
        return cls(path.grasp, path.grasp_angle, path.pivot, centre, yaw, path.turn, slide)

    @classmethod
    def _about(
        cls, action: Rotate | Accelerate | Slide, shape: ObjectShape, length: float, centre: np.ndarray, yaw: float
    ) -> Self:
        grasp = shape.grasps[action.grasp]
        if isinstance(action, Slide):
            along = rotation_2d(yaw) @ [math.cos(action.direction), math.sin(action.direction)]
            return cls(grasp.position, grasp.angle, grasp.position, centre, yaw, 0.0, length * along)
        speed = action.start_speed if isinstance(action, Accelerate) else action.speed
        turn = math.copysign(length, speed)
        return cls(grasp.position, grasp.angle, pivot_of(action, shape), centre, yaw, turn, np.zeros(2))

    def object_pose(self, part: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """Planar pose of the object along the path, (N, 3)."""
        yaw = part * self.turn + self.yaw
        return pose_from_point(self.centre + part[:, None] * self.slide, self.pivot, yaw)

    def tool_pose(self, part: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 3"]:
        """x, y of the TCP, m, and yaw of the closing direction, rad, along the path, (N, 3)."""
        poses = self.object_pose(part)
        return np.column_stack([transform_point(poses, self.grasp), poses[:, 2] + self.grasp_angle])


LOW, HIGH = (-0.30, -0.60), (1.00, 0.60)
"""Two opposite corners of the simulated table's top, m, from the arm's base; a test holds them to its MJCF."""
EDGES = ("far", "left", "near", "right")
"""As the arm faces them: the side of +x, +y, -x and -y."""
OFFSET = np.array([HIGH[0], HIGH[1], -LOW[0], -LOW[1]])
"""Of each edge from the arm's base, outwards, m."""
_WAY = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_HEADING = np.array([0.0, 0.5, 1.0, 1.5]) * math.pi


def outline(shape: ObjectShape) -> Float[np.ndarray, "K 2"]:
    """Corners of the convex hull of all cells, m, object frame."""
    half = shape.cell / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = (shape.particles[:, None] + half).reshape(-1, 2)
    return corners[ConvexHull(corners).vertices]


def overhang(
    corners: Float[np.ndarray, "K 2"],
    pivot: Float[np.ndarray, "N 2"],
    centre: Float[np.ndarray, "N 2"],
    yaw: Float[np.ndarray, "N"],
    turn: Float[np.ndarray, "N"],
    slide: Float[np.ndarray, "N 2"],
) -> Float[np.ndarray, "N 4"]:
    """How far past each edge an object gets anywhere on its way, m; less than 0 where all of it stays inside.

    Exact: of an arc, the farthest point is one of its ends, or where it heads straight for the edge.

    Args:
        corners: of its outline, m, object frame.
        pivot: point of the object about which it turns, m, object frame.
        centre: where that is at the middle of the way, m, world.
        yaw: of the object there, rad.
        turn: angle of the whole way, rad; 0 of a slide.
        slide: displacement over the whole way, m, world; 0 of a turn.
    """
    lever = corners - pivot[:, None]
    radius = np.hypot(lever[..., 0], lever[..., 1])[..., None]
    middle = (np.arctan2(lever[..., 1], lever[..., 0]) + yaw[:, None])[..., None] - _HEADING
    half = np.abs(turn)[:, None, None] / 2
    off = np.abs(np.remainder(middle + math.pi, 2 * math.pi) - math.pi)  # from the heading, at the middle of the way
    reach = (radius * np.cos(np.maximum(off - half, 0.0))).max(axis=1)
    return centre @ _WAY.T + np.abs(slide @ _WAY.T) / 2 + reach - OFFSET


def overhang_of(shape: ObjectShape, path: ToolPath) -> Float[np.ndarray, "4"]:
    """That of one path."""
    each = (path.pivot, path.centre, path.yaw, path.turn, path.slide)
    return overhang(outline(shape), *(np.asarray(value)[None] for value in each))[0]
