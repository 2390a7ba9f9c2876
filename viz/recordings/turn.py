"""A trial from above in Rerun: the object's outline as it moves, and the velocities of its particles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float

from testbed.frames import perpendicular, rotation_2d, transform_point
from testbed.objects.model import Grasp, ObjectShape
from testbed.trajectory import Phase, Trajectory
from viz.recordings.mass_map import Raster
from viz.recordings.page import SIM_TIME, Frames, Node
from viz.recordings.planar import LINE, MARGIN, Bounds, Canvas, log_lines, log_texts, log_upright
from viz.style import EDGE, OBJECT_VELOCITY, PADS, TRUTH, VELOCITY, rgb
from viz.values import evenly

MOST_ARROWS = 150
"""Largest number of particles with an arrow."""
PAD = 0.006
"""Thickness of a drawn pad [m]."""
LONGEST = 0.35
"""Largest arrow over the object's size."""
HORIZONS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""Times [s] of which an arrow may show the way."""


def moves_on_table(trajectory: Trajectory | None) -> bool:
    """True if there is motion to draw."""
    return trajectory is not None and trajectory.action.moves and trajectory.time_s.size > 1


@dataclass(frozen=True, eq=False)
class TurnScene:
    """A trial in which the object moves on the table."""

    shape: ObjectShape
    """Geometry of the object."""
    trajectory: Trajectory
    """Trajectory of the trial."""
    canvas: Canvas
    """Size of the view."""

    @property
    def horizon(self) -> float:
        """Time [s] of which an arrow shows the way: the longest round one with which no arrow is too long."""
        speeds = np.linalg.norm(self._velocity(self.shape.particles), axis=-1)
        size = float(np.linalg.norm(np.ptp(self.shape.particles, axis=0) + self.shape.cell))
        fitting = [h for h in HORIZONS if h * float(speeds.max()) <= LONGEST * size]
        return fitting[-1] if fitting else HORIZONS[0]

    @property
    def box(self) -> Bounds:
        """Bounds around all places of the object."""
        outline = np.concatenate(Raster.of(self.shape).outlines())
        reach = 0.5 * LONGEST * float(np.linalg.norm(np.ptp(outline, axis=0)))
        box = Bounds.around(transform_point(self._pose[:, None], outline[None])).grown(reach, reach, reach)
        return self.canvas.framed(box, 0, LINE + 2 * MARGIN, 0)

    def log(self, node: Node) -> None:
        """Log it below `node`, in the world's axes."""
        log_upright(node)
        frames, body, pose = self._frames, node / "object", self._pose
        half, still = pose[:, 2] / 2, np.zeros(len(pose))
        place = np.column_stack([pose[:, :2], still])
        turned = np.column_stack([still, still, np.sin(half), np.cos(half)])
        frames.send(body, lambda k: rr.Transform3D.columns(translation=place[k], quaternion=turned[k]))
        log_lines(body / "outline", Raster.of(self.shape).outlines(), EDGE)
        dots = rr.Points2D(self.shape.particles, radii=0.16 * self.shape.cell, colors=rgb(TRUTH))
        (body / "particles").log(dots)
        particles = self.shape.particles[evenly(len(self.shape.particles), MOST_ARROWS)]
        self._log_arrows(body / "velocity", frames, particles, VELOCITY)
        self._log_arrows(body / "object_velocity", frames, np.zeros((1, 2)), OBJECT_VELOCITY)
        index = self.trajectory.action.grasp
        if index is not None and index < len(self.shape.grasps):
            pads = rr.LineStrips2D(pad_lines(self.shape.grasps[index]), colors=rgb(PADS), radii=PAD / 2)
            (body / "pads").log(pads)
        box = self.box
        pixel = self.canvas.pixel(box)
        at = np.array([[box.middle[0], box.top - (LINE / 2 + MARGIN) * pixel]])
        key = f"arrows: the way of {self.horizon:g} s; blue particles, black object, pink pads"
        log_texts(node / "key", at, [key], pixel)

    def _log_arrows(self, node: Node, frames: Frames, origins: Float[np.ndarray, "N 2"], color: str) -> None:
        look = rr.Arrows2D.from_fields(origins=origins, colors=rgb(color), radii=rr.Radius.ui_points(1.0))
        node.log(look)
        ways = self.horizon * self._velocity(origins)
        frames.send(
            node, lambda k: rr.Arrows2D.columns(vectors=ways[k].reshape(-1, 2)).partition([len(origins)] * len(k))
        )

    @property
    def _kept(self) -> np.ndarray:
        return evenly(len(self.trajectory.time_s))

    @property
    def _frames(self) -> Frames:
        """Evenly spread samples; at rest, the middle of the steady ones."""
        kept = self._kept
        steady = np.flatnonzero(self.trajectory.mask(Phase.STEADY)[kept])
        rest = steady[len(steady) // 2] if len(steady) else len(kept) // 2
        return Frames(SIM_TIME, self.trajectory.time_s[kept], int(rest))

    @property
    def _pose(self) -> Float[np.ndarray, "F 3"]:
        return self.trajectory.object_pose[self._kept]

    def _velocity(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "F N 2"]:
        """Velocities of points of the object [m/s], object axes: v + omega x p."""
        velocity = self.trajectory.object_velocity[self._kept]
        linear = np.einsum("nji,nj->ni", rotation_2d(self._pose[:, 2]), velocity[:, :2])
        return linear[:, None, :] + velocity[:, 2, None, None] * perpendicular(points)


def pad_lines(grasp: Grasp) -> Float[np.ndarray, "2 2 2"]:
    """The gripper's two pads as lines as long as the faces that they hold [m], object frame."""
    close = np.array([np.cos(grasp.angle), np.sin(grasp.angle)])
    along = min(grasp.length, grasp.width) / 2 * perpendicular(close)
    middles = grasp.position + np.outer([-1.0, 1.0], (grasp.width + PAD) / 2 * close)
    return np.stack([middles - along, middles + along], axis=1)
