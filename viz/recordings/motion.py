"""The bench in Rerun: arm, sensor, gripper and table, moving as a record has them."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
import rerun as rr
from jaxtyping import Float
from rerun_loader_mjcf import MJCFLogger

from testbed.actions.base import Weigh
from testbed.frames import perpendicular, rotation_2d, transform_point
from testbed.objects.model import Grasp, ObjectShape
from testbed.trajectory import Phase, Trajectory
from viz.recordings.mass_map import Raster
from viz.recordings.page import SIM_TIME, Frames, evenly
from viz.recordings.planar import LINE, MARGIN, Box, Canvas, log_lines, log_texts, log_upright
from viz.style import EDGE, OBJECT_VELOCITY, PADS, TRUTH, VELOCITY, rgb


class Poses(Protocol):
    """Where the B bodies of a model are at each of N samples."""

    @property
    def model(self) -> Any:
        """The compiled MJCF model."""
        ...

    @property
    def position(self) -> Float[np.ndarray, "N B 3"]:
        """m, world."""
        ...

    @property
    def orientation(self) -> Float[np.ndarray, "N B 4"]:
        """wxyz."""
        ...


class _Shapes(MJCFLogger):
    """Logs what bodies look like, and leaves out where they would be at rest."""

    def log_data(self, data: Any, recording: rr.RecordingStream | None = None) -> None:
        """Nothing: the record knows."""


def log_bench(stream: rr.RecordingStream, root: str, poses: Poses, time_s: Float[np.ndarray, "N"]) -> None:
    """Log the shapes once and the bodies' poses on `sim_time`; a body that never moves is static."""
    shapes = _Shapes(poses.model, root)
    shapes.log_model(stream)
    index = [rr.TimeColumn(SIM_TIME, duration=time_s)]
    for body in range(poses.model.nbody):
        entity = shapes.paths.body_path(poses.model.body(body).name)
        place, turn = poses.position[:, body], np.roll(poses.orientation[:, body], -1, axis=1)  # to xyzw
        if np.ptp(place, axis=0).max() + np.ptp(turn, axis=0).max() < 1e-9:
            stream.log(entity, rr.Transform3D(translation=place[0], quaternion=turn[0]), static=True)
        else:
            stream.send_columns(entity, index, rr.Transform3D.columns(translation=place, quaternion=turn))


MOST_ARROWS = 150
"""Particles beyond these have no arrow of their own."""
PAD = 0.006
"""Thickness of a drawn pad, m."""
LONGEST = 0.35
"""Largest arrow over the object's size, at most."""
HORIZONS = (0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0)
"""An arrow is the way of one of these times, s."""
SLOW = 1e-3
"""Below this rate, rad/s, there is no centre of the turn."""


def point_velocity(
    points: Float[np.ndarray, "P 2"], velocity: Float[np.ndarray, "... 3"], yaw: Float[np.ndarray, "..."]
) -> Float[np.ndarray, "... P 2"]:
    """Velocities of points of the object, in object axes, m/s: v + omega x p.

    Args:
        points: m, object frame.
        velocity: of the object frame's origin and yaw rate, world axes, m/s and rad/s.
        yaw: of the object, rad.
    """
    linear = np.einsum("...ji,...j->...i", rotation_2d(yaw), velocity[..., :2])
    return linear[..., None, :] + velocity[..., 2, None, None] * perpendicular(points)


@dataclass(frozen=True, eq=False)
class TurnScene:
    """A trial in which the object moves on the table."""

    shape: ObjectShape
    trajectory: Trajectory
    canvas: Canvas

    @staticmethod
    def shows(trajectory: Trajectory | None) -> bool:
        """Whether there is motion to be shown."""
        return trajectory is not None and not isinstance(trajectory.action, Weigh) and trajectory.time_s.size > 1

    @property
    def frames(self) -> Frames:
        """Evenly spread samples; at rest, the middle of the steady ones."""
        kept = evenly(len(self.trajectory.time_s))
        steady = np.flatnonzero(self.trajectory.mask(Phase.STEADY)[kept])
        rest = steady[len(steady) // 2] if len(steady) else len(kept) // 2
        return Frames(SIM_TIME, self.trajectory.time_s[kept], int(rest))

    @property
    def horizon(self) -> float:
        """Time of which an arrow shows the way, s: the longest round one with which no arrow is too long."""
        speeds = np.linalg.norm(self._velocity(self.shape.particles), axis=-1)
        size = float(np.linalg.norm(np.ptp(self.shape.particles, axis=0) + self.shape.cell))
        fitting = [h for h in HORIZONS if h * float(speeds.max()) <= LONGEST * size]
        return fitting[-1] if fitting else HORIZONS[0]

    @property
    def box(self) -> Box:
        """All places that the object comes to."""
        outline = np.concatenate(Raster.of(self.shape).outlines())
        seen = transform_point(self._pose[:, None], outline[None])
        low, high = seen.reshape(-1, 2).min(axis=0), seen.reshape(-1, 2).max(axis=0)
        reach = 0.5 * LONGEST * float(np.linalg.norm(np.ptp(outline, axis=0)))
        box = Box(float(low[0]), float(low[1]), float(high[0]), float(high[1])).grown(reach, reach, reach, reach)
        return self.canvas.framed(box, 0, LINE + 2 * MARGIN, 0)

    def log(self, stream: rr.RecordingStream, entity: str) -> None:
        """Draw it below `entity`, in the world's axes, seen from above."""
        log_upright(stream, entity)
        frames, body = self.frames, f"{entity}/object"
        pose = self._pose
        half, still = pose[:, 2] / 2, np.zeros(len(pose))
        place, turned = (
            np.column_stack([pose[:, :2], still]),
            np.column_stack([still, still, np.sin(half), np.cos(half)]),
        )
        frames.send(stream, body, lambda k: rr.Transform3D.columns(translation=place[k], quaternion=turned[k]))
        log_lines(stream, f"{body}/outline", Raster.of(self.shape).outlines(), EDGE)
        dots = rr.Points2D(self.shape.particles, radii=0.16 * self.shape.cell, colors=rgb(TRUTH))
        stream.log(f"{body}/particles", dots, static=True, strict=True)
        shown = self.shape.particles[evenly(len(self.shape.particles), MOST_ARROWS)]
        self._log_arrows(stream, f"{body}/velocity", frames, shown, VELOCITY)
        self._log_arrows(stream, f"{body}/object_velocity", frames, np.zeros((1, 2)), OBJECT_VELOCITY)
        self._log_pads(stream, f"{body}/pads")
        self._log_key(stream, f"{entity}/key")

    def _log_arrows(
        self,
        stream: rr.RecordingStream,
        entity: str,
        frames: Frames,
        origins: Float[np.ndarray, "N 2"],
        color: str,
    ) -> None:
        look = rr.Arrows2D.from_fields(origins=origins, colors=rgb(color), radii=rr.Radius.ui_points(1.0))
        stream.log(entity, look, static=True, strict=True)
        ways = self.horizon * self._velocity(origins)
        frames.send(
            stream,
            entity,
            lambda k: rr.Arrows2D.columns(vectors=ways[k].reshape(-1, 2)).partition([len(origins)] * len(k)),
        )

    def _log_pads(self, stream: rr.RecordingStream, entity: str) -> None:
        index = getattr(self.trajectory.action, "grasp", None)
        if index is None or index >= len(self.shape.grasps):
            return
        pads = rr.LineStrips2D(pad_lines(self.shape.grasps[index]), colors=rgb(PADS), radii=PAD / 2)
        stream.log(entity, pads, static=True, strict=True)

    def _log_key(self, stream: rr.RecordingStream, entity: str) -> None:
        """What an arrow stands for."""
        box = self.box
        pixel = self.canvas.pixel(box)
        at = np.array([[(box.left + box.right) / 2, box.top - (LINE / 2 + MARGIN) * pixel]])
        said = f"arrows: the way of {self.horizon:g} s; blue particles, black object, pink pads"
        log_texts(stream, entity, at, [said], pixel)

    @property
    def _pose(self) -> Float[np.ndarray, "F 3"]:
        return self.trajectory.object_pose[evenly(len(self.trajectory.time_s))]

    def _velocity(self, points: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "F N 2"]:
        kept = evenly(len(self.trajectory.time_s))
        return point_velocity(points, self.trajectory.object_velocity[kept], self._pose[:, 2])


def pad_lines(grasp: Grasp) -> Float[np.ndarray, "2 2 2"]:
    """The gripper's two pads in the object frame, as lines as long as the faces they hold, m."""
    close = np.array([np.cos(grasp.angle), np.sin(grasp.angle)])
    along = min(grasp.length, grasp.width) / 2 * perpendicular(close)
    middles = grasp.position + np.outer([-1.0, 1.0], (grasp.width + PAD) / 2 * close)
    return np.stack([middles - along, middles + along], axis=1)
