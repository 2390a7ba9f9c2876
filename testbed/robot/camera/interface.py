"""Camera of the real robot: a stream of poses of an object that is not held, or of trailing links."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float

from testbed.robot.interfaces import Clock, Device, RobotError
from testbed.sensing.camera import Camera, PoseStream
from testbed.validation import frozen_array

LOOK = 1.0
"""Time over which the object's pose is averaged before a trial [s]."""
FARTHEST = 10.0, 10.0, 1e3
"""Largest coordinates [m] and yaw [rad] of an object on a table."""
LEAST_SEEN = 5
"""Least number of frames that determine the object's pose."""
BLIND = 0.4
"""Longest time without a pose of the object in a valid trial [s]: half of the gap that the smoother bridges."""


class CameraLostError(RobotError):
    """The camera is disconnected, or its data cannot be read or are implausible."""


@dataclass(frozen=True, eq=False)
class SeenFrame:
    """One frame of a camera."""

    time_s: float
    """Time stamp [s]: the exposure, or later by the delay that the robot file states."""
    poses: Float[np.ndarray, "parts 3"]
    """Planar pose of each part's object frame [m, m, rad], the arm's base frame; NaN where it was not seen."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses", frozen_array("SeenFrame.poses", self.poses, (None, 3), finite=False))


@runtime_checkable
class ObjectCamera(Device, Protocol):
    """A camera that streams poses of the object's parts. Entering opens it and starts the stream."""

    def drain(self) -> Sequence[SeenFrame]:
        """Every frame since the last drain, in order. An empty sequence is no error.

        Raises:
            CameraLostError: the camera is disconnected, or its data cannot be read.
        """
        ...


def seen_stream(frames: Sequence[SeenFrame], camera: Camera, begin: float, parts: int) -> PoseStream:
    """Pose stream of a trial from the frames of its camera. Frames whose stamp does not increase are dropped.

    Args:
        frames: all frames of the trial.
        camera: stated errors of the camera; its mean delay is subtracted.
        begin: time at which the record begins [s].
        parts: number of the object's parts.

    Raises:
        CameraLostError: a frame has another number of parts.
    """
    for frame in frames:
        check_frame(frame, parts)
    time = np.array([frame.time_s for frame in frames]) - begin - sum(camera.delay) / 2
    kept = np.flatnonzero(time > np.maximum.accumulate(np.concatenate([[-np.inf], time[:-1]])))
    poses = np.array([frames[i].poses for i in kept.tolist()]).reshape(-1, parts, 3)
    return PoseStream(time[kept], poses, camera.position, camera.angle, camera.delay_std)


def check_frame(frame: SeenFrame, parts: int) -> None:
    """Check the number of poses in a frame, and their size.

    Raises:
        CameraLostError: wrong number of parts, or a pose beyond `FARTHEST` or known in part.
    """
    if len(frame.poses) != parts:
        raise CameraLostError(f"camera: it sends poses of {len(frame.poses)} parts; the object has {parts}")
    for pose in frame.poses[~np.isnan(frame.poses).all(axis=1)]:
        if not (np.abs(pose) <= FARTHEST).all():
            raise CameraLostError(
                f"camera: got a pose of {np.array2string(pose, precision=3)}; allowed: at most {FARTHEST[0]:g} m and "
                f"{FARTHEST[2]:g} rad"
            )


@dataclass(frozen=True)
class SeenPose:
    """An `ObjectPose`: median pose of a part of the object at rest, by a camera that has been entered."""

    camera: ObjectCamera
    clock: Clock
    parts: int = 1
    """Number of the object's parts."""
    part: int = 0
    """Index of the part whose pose is read."""

    def read(self) -> tuple[float, float, float]:
        """Planar pose: x, y [m] and yaw [rad].

        Raises:
            CameraLostError: too few frames show the part.
        """
        self.camera.drain()  # frames from before
        begin, poses = self.clock.now(), []
        while self.clock.now() - begin < LOOK:
            self.clock.sleep(0.05)
            for frame in self.camera.drain():
                check_frame(frame, self.parts)
                poses.append(frame.poses[self.part])
        seen = np.array([pose for pose in poses if not np.isnan(pose).any()]).reshape(-1, 3)
        if len(seen) < LEAST_SEEN:
            raise CameraLostError(
                f"camera: it saw part {self.part} of the object in {len(seen)} frames within {LOOK:g} s; needed: "
                f"{LEAST_SEEN}; clear its view, and look whether it streams"
            )
        x, y = np.median(seen[:, :2], axis=0)
        reference = math.atan2(np.sin(seen[:, 2]).sum(), np.cos(seen[:, 2]).sum())  # yaw wraps at 2 pi
        turn = np.median(np.remainder(seen[:, 2] - reference + math.pi, math.tau)) - math.pi
        return float(x), float(y), float(reference + turn)
