"""The way of the tool over the table: where an action takes the TCP, whatever arm carries it."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Self

import numpy as np
from jaxtyping import Float

from testbed.actions import Accelerate, Rotate, Slide, pivot_of
from testbed.frames import pose_from_point, rotation_2d, transform_point
from testbed.objects import ObjectShape

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
