"""Camera: streams of object poses, errors by preset, and the motion between frames.

In a push no part of the object is in the hand, and of an articulated object only one is: a camera measures the motion
of the others.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.sensing.series import interpolated, unwrapped
from testbed.validation import check_integer, freeze_arrays, frozen_array, is_number

DEGREE = 3
"""Degree of the polynomial through the frames nearby."""
SPAN = 0.8
"""Time span of a polynomial's frames [s]: errors of 1 mm and 0.5 deg at 30 Hz become some 1 mm/s and 0.5 deg/s."""
LEAST_FRAMES = 7
"""Least number of frames of a polynomial, and its number of frames of an exact camera."""
NEXT = 1.5
"""Distance of two frames, over the median, below which no frame between them was lost."""
LOST = 2.5
"""Time between two frames, as a multiple of the median, from which frames were lost. Ours."""


@dataclass(frozen=True)
class Camera:
    """Errors of a camera that measures poses, as stated."""

    name: str
    """Preset name."""
    rate: float = 0.0
    """Frame rate [Hz]; 0 for a frame at every sample of the record."""
    position: float = 0.0
    """Standard deviation of a position, per frame and axis [m]."""
    angle: float = 0.0
    """Standard deviation of a yaw, per frame [rad]."""
    delay: tuple[float, float] = (0.0, 0.0)
    """Least and greatest delay of the time stamps [s]; one draw per trial."""
    dropout: float = 0.0
    """Share of lost frames."""

    def __post_init__(self) -> None:
        for name in ("rate", "position", "angle", "dropout"):
            if not (is_number(value := getattr(self, name)) and value >= 0):
                raise InvalidValueError(f"Camera.{name}", value, "a finite number >= 0")
        if not self.dropout < 1:
            raise InvalidValueError("Camera.dropout", self.dropout, "a share below 1")
        least, most = frozen_array("Camera.delay", self.delay, (2,))
        if not 0 <= least <= most:
            raise InvalidValueError("Camera.delay", self.delay, "two times >= 0, the least first, s")

    @property
    def delay_std(self) -> float:
        """Standard deviation of the delay in a trial about its known mean [s]."""
        return (self.delay[1] - self.delay[0]) / math.sqrt(12)

    @property
    def is_exact(self) -> bool:
        """True if it measures the true pose at every sample."""
        return replace(self, name="exact") == Camera("exact")


CAMERAS: dict[str, Camera] = {
    camera.name: camera
    for camera in (
        Camera("exact"),
        Camera("30hz", 30.0, 0.001, math.radians(0.5), (0.01, 0.05), 0.03),
    )
}
"""Cameras by name: `exact`, and `30hz` with 1 mm, 0.5 deg, stamps 10 to 50 ms late and 3 % of its frames lost."""


@dataclass(frozen=True, eq=False)
class PoseStream:
    """Frames of a camera: F poses of each part of an object; a rigid object has one part."""

    time_s: Float[np.ndarray, "F"]
    """Time of each frame [s], on the record's clock: its stamp less the mean delay."""
    poses: Float[np.ndarray, "F parts 3"]
    """Planar pose of each part's frame [m, m, rad], world; NaN where it was not measured. Yaws are unwrapped on
    construction."""
    position_std: float = 0.0
    """Standard deviation of a position as stated, per frame and axis [m]."""
    angle_std: float = 0.0
    """Standard deviation of a yaw as stated, per frame [rad]."""
    delay_std: float = 0.0
    """Standard deviation of the delay that all frames of a trial share, as stated [s]."""

    def __post_init__(self) -> None:
        freeze_arrays(self, time_s=(None,))
        poses = frozen_array("PoseStream.poses", self.poses, (len(self.time_s), None, 3), finite=False)
        if (np.diff(self.time_s) <= 0).any():
            raise InvalidValueError("PoseStream.time_s", f"{len(self.time_s)} times", "strictly increasing times, s")
        if np.isinf(poses).any() or (np.isnan(poses).any(axis=2) != np.isnan(poses).all(axis=2)).any():
            raise InvalidValueError("PoseStream.poses", "infinite or half-seen poses", "whole poses, or NaN for one")
        object.__setattr__(self, "poses", unwrapped(poses))
        for name in ("position_std", "angle_std", "delay_std"):
            if not (is_number(value := getattr(self, name)) and value >= 0):
                raise InvalidValueError(f"PoseStream.{name}", value, "a finite number >= 0")

    @property
    def parts(self) -> int:
        """Number of parts."""
        return self.poses.shape[1]

    @property
    def joint_angles(self) -> Float[np.ndarray, "F joints"]:
        """Yaw of each part less that of the one before [rad], 0 in the stated shape; NaN where one was not measured.

        Parts may have stamps of their own: each is interpolated between neighboring frames.
        """
        yaw = self.at(self.time_s)[..., 2]
        for part, measured in enumerate(~np.isnan(self.poses[..., 2]).T):
            own, seen = self.time_s[measured], measured
            if len(own) > 1:
                after = np.searchsorted(own, self.time_s).clip(1, len(own) - 1)
                inside = (self.time_s >= own[0]) & (self.time_s <= own[-1])
                near = inside & (own[after] - own[after - 1] < NEXT * np.median(np.diff(own)))
                seen = measured | near
            yaw[~seen, part] = math.nan
        angle = np.diff(yaw, axis=1)
        for joint in range(self.parts - 1):  # each yaw may have whole turns of its own
            if (measured := ~np.isnan(angle[:, joint])).any():
                angle[:, joint] -= math.tau * round(angle[measured, joint][0] / math.tau)
        return angle

    def at(self, times: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N parts 3"]:
        """Poses at given times [s], for drawing: linear between the frames of each part; NaN without frames."""
        found = np.full((len(times), self.parts, 3), math.nan)
        for part, poses in enumerate(self.poses.transpose(1, 0, 2)):
            if (measured := ~np.isnan(poses[:, 0])).any():
                found[:, part] = interpolated(times, self.time_s[measured], poses[measured])
        return found

    def motion(
        self,
        times: Float[np.ndarray, "N"],
        part: int = 0,
        within: tuple[float, float] = (-math.inf, math.inf),
        span: float | None = None,
    ) -> CameraMotion:
        """Motion of a part at given times, by local polynomials of degree `DEGREE` through the nearest frames.

        Rows are NaN if the stream has fewer than `LEAST_FRAMES` frames, outside the stream, and where frames were lost:
        between two frames whose distance exceeds half of `SPAN` and `LOST` times the median.

        Args:
            times: times [s].
            part: index of the part.
            within: first and last time of the smooth motion [s]; frames outside are left out.
            span: time span of the frames of a polynomial [s]; None for `SPAN`, or for the nearest `LEAST_FRAMES` frames
                of an exact stream.
        """
        check_integer("part", part, least=0, most=self.parts - 1)
        std = np.array([self.position_std, self.position_std, self.angle_std])
        visible = ~np.isnan(self.poses[:, part, 0]) & (self.time_s >= within[0]) & (self.time_s <= within[1])
        time, pose = self.time_s[visible], self.poses[visible, part]
        span = span or (SPAN if std.any() else 0.0)
        count, steps = len(times), np.diff(time)
        lost = max(SPAN / 2, LOST * float(np.median(steps))) if len(steps) else 0.0
        value, noise = np.full((count, 3, 3), math.nan), np.full((count, 3, 3), math.nan)
        for index, at in enumerate(np.asarray(times, dtype=float)):
            near = _nearest(time, at, span, lost)
            if len(near) < LEAST_FRAMES:
                continue
            unit = max(float(np.abs(time[near] - at).max()), 1e-9)
            basis = np.vander((time[near] - at) / unit, DEGREE + 1, increasing=True)
            fit = np.linalg.pinv(basis)[:3] * np.array([1.0, 1.0, 2.0])[:, None] / unit ** np.arange(3)[:, None]
            value[index], noise[index] = fit @ pose[near], fit @ fit.T
        flat = value.reshape(count, 9)
        covariance = np.einsum("nab,ij->naibj", noise, np.diag(std**2)).reshape(count, 9, 9)
        # A delay shared by all frames changes each derivative by the next one
        late = self.delay_std * np.concatenate([flat[:, 3:], np.zeros((count, 3))], axis=1)
        covariance += late[:, :, None] * late[:, None, :]
        return CameraMotion(value[:, 0], value[:, 1], value[:, 2], covariance, late)


@dataclass(frozen=True, eq=False)
class CameraMotion:
    """Motion of a part at N times by a camera, world axes; NaN where it was not measured."""

    pose: Float[np.ndarray, "N 3"]
    """Planar pose of its frame [m, m, rad]."""
    twist: Float[np.ndarray, "N 3"]
    """Velocity of the frame's origin and yaw rate [m/s, m/s, rad/s]."""
    acceleration: Float[np.ndarray, "N 3"]
    """Rate of `twist` [m/s^2, m/s^2, rad/s^2]."""
    covariance: Float[np.ndarray, "N 9 9"]
    """Covariance of pose, twist and acceleration, in this order, from the frames' noise and the delay's error."""
    late: Float[np.ndarray, "N 9"]
    """Effect of one standard deviation of the delay, which all rows share; included in `covariance`."""


def _nearest(time: np.ndarray, at: float, span: float, lost: float) -> np.ndarray:
    """Indices of the frames within half a `span` of a time, or of the nearest `LEAST_FRAMES` if these are too few.

    Empty more than half of `SPAN` before the first or after the last frame, and between two frames that are more than
    `lost` apart.
    """
    after, none = int(np.searchsorted(time, at)), np.empty(0, dtype=np.int64)
    if len(time) == 0 or not time[0] - SPAN / 2 <= at <= time[-1] + SPAN / 2:
        return none
    if 0 < after < len(time) and time[after] - time[after - 1] > lost:
        return none
    away = np.abs(time - at)
    near = np.flatnonzero(away <= span / 2)
    return near if len(near) >= LEAST_FRAMES else np.sort(np.argsort(away, kind="stable")[:LEAST_FRAMES])


def draw_camera(true: PoseStream, camera: Camera, seed: int) -> PoseStream:
    """Draw the frames of a camera with errors from the true poses of a clean record.

    The result states the camera's errors, not their draw.

    Args:
        true: poses at the record's samples.
        camera: errors of the camera.
        seed: seed of the draw; it may be that of the force sensor, whose random numbers are independent.
    """
    if camera.is_exact:
        return true
    stated = camera.position, camera.angle, camera.delay_std
    if len(true.time_s) == 0:
        return PoseStream(true.time_s, true.poses, *stated)
    rng = np.random.default_rng((seed, 1))
    least, most = camera.delay
    late = rng.uniform(least, most)
    first, last = true.time_s[[0, -1]]
    step = 1 / camera.rate if camera.rate else float(np.median(np.diff(true.time_s)))
    at = np.arange(first + rng.uniform(0, step), last, step)
    poses = interpolated(at, true.time_s, true.poses.reshape(len(true.time_s), -1))
    noise = np.array([camera.position, camera.position, camera.angle]) * rng.standard_normal((len(at), true.parts, 3))
    found = poses.reshape(noise.shape) + noise
    found[rng.random(len(at)) < camera.dropout] = math.nan
    return PoseStream(at + late - (least + most) / 2, found, *stated)
