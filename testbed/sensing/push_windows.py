"""Windows of a push: short stretches in contact, with the motion of the object by a camera."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from testbed.errors import InvalidValueError
from testbed.frames import perpendicular, rotate_wrench, rotation_2d
from testbed.objects.faces import face_at
from testbed.objects.model import ObjectShape
from testbed.sensing.camera import SPAN, PoseStream
from testbed.sensing.compensation import tare_time
from testbed.sensing.series import runs
from testbed.sensing.windows import (
    BATCH,
    TRIM_END,
    SteadyWindow,
    bias_and_drift,
    noise_of_mean,
    part_means,
    reduced_once,
    sensor_map,
    steady_samples,
)
from testbed.trajectory import Phase, Trajectory

WINDOW = 0.4
"""Least length of a window, at a pace of 1 [s]: short, since the center of rotation moves."""
BEGIN = 0.3
"""Time left out after the start of contact, at a pace of 1 [s]."""
TOUCHING = 0.3
"""Least force in contact, over the usual force of the push."""
NOISE = 2.0
"""Least force of a push, over that of a tare; below it there is no contact."""
_SMOOTH = 5
"""Samples of the moving average of the force."""
_QUIET = 1.63
"""Mean length of `_SMOOTH` vectors in the plane, of unit noise, that nine in ten do not exceed."""


@reduced_once
def push_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of a push, from `BEGIN` after the start of contact to its end, or that of the path.

    Raises:
        InvalidValueError: not a push with status ok, no camera, or no stretch of contact that is long enough and has
            frames.
    """
    if not (trajectory.action.pushes and trajectory.ok):
        raise InvalidValueError("trajectory", f"{trajectory.action}, {trajectory.status}", "a Push with status ok")
    camera = trajectory.camera
    if camera is None:
        raise InvalidValueError("trajectory.camera", None, "poses of the object by a camera: the hand does not hold it")
    contact = touching(trajectory)
    time = trajectory.time_s
    pace = trajectory.action.pace
    kept = contact[within_contact(time[contact], pace)]
    step = float(np.median(np.diff(time)))
    begin, end = float(time[contact[0]]), float(time[contact[-1]])
    if _count(time[kept], pace) < 1:
        allowed = f"{pace * (WINDOW + BEGIN) + TRIM_END:.2g} s or more at this speed"
        raise InvalidValueError("trajectory", f"{end - begin:.2g} s in contact", allowed)
    found = stretches(time[kept], trajectory.tcp_position[kept, :2], camera, (begin + pace * BEGIN / 2, end), pace)
    tared = tare_time(trajectory)
    whole = noise_of_mean(trajectory.wrench_on_object_world[kept], round(BATCH / step))
    windows = []
    for part, yaw, motion in found:
        into_object = np.tile(np.eye(3), (len(part), 1, 1))
        into_object[:, :2, :2] = rotation_2d(-yaw)
        wrench = rotate_wrench(into_object, trajectory.wrench_on_object_world[kept[part]])
        middle = len(part) // 2
        from_sensor = sensor_map(trajectory, (int(kept[part[middle]]), float(yaw[middle])))
        bias, drift = bias_and_drift(trajectory, from_sensor)
        rotation = block_diag(into_object[middle], into_object[middle])
        windows.append(
            SteadyWindow(
                grasp=None,
                wrench=wrench.mean(axis=0),
                covariance=rotation @ whole @ rotation.T * (len(kept) / len(part)),
                tcp_height=float(trajectory.tcp_position[kept[part], 2].mean()),
                from_sensor=from_sensor,
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=time[kept[part[[0, -1]]]] - tared,
                **motion,
            )
        )
    if not windows:
        raise InvalidValueError("trajectory.camera", "too few frames in contact", "frames near every stretch")
    return windows


def contact_path(shape: ObjectShape, trajectory: Trajectory) -> Float[np.ndarray, "W 2"]:
    """Contact point in each window of a push: the point of the outline nearest to the fingertip [m], object frame.

    Raises:
        InvalidValueError: as `push_windows`.
    """
    tips = [window.point for window in push_windows(trajectory) if window.point is not None]
    return np.array([face_at(shape, tip)[0].nearest(tip) for tip in tips]).reshape(-1, 2)


def within_contact(time: Float[np.ndarray, "N"], pace: float) -> Int[np.ndarray, "M"]:
    """Indices of the times in contact [s] that count, without the start and the end of the contact."""
    return np.flatnonzero((time >= time[0] + pace * BEGIN) & (time <= time[-1] - TRIM_END))


class Stretch(NamedTuple):
    """Part of a push, with its motion by a camera."""

    samples: Int[np.ndarray, "N"]
    """Indices of its samples."""
    yaw: Float[np.ndarray, "N"]
    """Yaw of the object at each [rad], world."""
    motion: dict[str, Any]
    """Fields of its `SteadyWindow` that follow from the motion."""


def stretches(
    time: Float[np.ndarray, "N"],
    place: Float[np.ndarray, "N 2"],
    camera: PoseStream,
    within: tuple[float, float],
    pace: float,
) -> list[Stretch]:
    """Stretches of a push of at least `WINDOW` s at its pace; those with lost frames are left out.

    Args:
        time: times in contact that count [s].
        place: positions of the fingertip at these times [m], world.
        camera: poses of the object.
        within: first and last time of its smooth motion [s].
        pace: pace of the push.
    """
    count = _count(time, pace)
    if count < 1:
        return []
    step = float(np.median(np.diff(time)))
    measured = camera.motion(time, within=within, span=None if pace == 1.0 else pace * SPAN)
    yaw = measured.pose[:, 2]
    into = rotation_2d(-yaw)
    point = np.einsum("nij,nj->ni", into, place - measured.pose[:, :2])
    spin, alpha = measured.twist[:, 2:], measured.acceleration[:, 2:]
    linear = np.einsum("nij,nj->ni", into, measured.twist[:, :2]) + spin * perpendicular(point)
    rate = np.einsum("nij,nj->ni", into, measured.acceleration[:, :2]) + alpha * perpendicular(point) - spin**2 * point
    twist, acceleration = np.hstack([linear, spin]), np.hstack([rate, alpha])
    poses = np.column_stack([place, yaw])
    found = []
    for part in np.array_split(np.arange(len(time)), count):
        if np.isnan(twist[part]).any():  # frames were lost
            continue
        middle = part[len(part) // 2]
        shared = pace * SPAN / (len(part) * step)
        into_object = block_diag(*[into[middle], [[1.0]]] * 3)
        motion = {
            "twist": twist[part].mean(axis=0),
            "twists": part_means(twist[part]),
            "acceleration": acceleration[part].mean(axis=0),
            "spin_square": float(np.mean(spin[part] ** 2)),
            "yaw": yaw[part[[0, -1]]],
            "poses": part_means(poses[part]),
            "point": point[part].mean(axis=0),
            "camera_errors": into_object @ camera_errors_of(measured.covariance[middle], measured.late[middle], shared),
        }
        found.append(Stretch(part, yaw[part], motion))
    return found


def push_samples(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples of every window of a push.

    Raises:
        InvalidValueError: as `push_windows`.
    """
    since = trajectory.time_s - tare_time(trajectory)
    ends = [window.since_tare + np.array([-1e-9, 1e-9]) for window in push_windows(trajectory)]
    return [np.flatnonzero((since >= begin) & (since <= end)) for begin, end in ends]


def window_samples(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples for methods: of every window of a push, or every steady stretch of other actions.

    Raises:
        InvalidValueError: as `push_windows` or `steady_samples`.
    """
    return (push_samples if trajectory.action.pushes else steady_samples)(trajectory)


def touching(trajectory: Trajectory) -> Int[np.ndarray, "N"]:
    """Indices of the longest run of samples in which the fingertip pushes, by the measured force.

    Raises:
        InvalidValueError: no steady stretch, or no contact.
    """
    inside = trajectory.segment >= 0
    if inside.sum() < _SMOOTH:
        raise InvalidValueError("trajectory", "no steady stretch", "a push")
    planar = np.linalg.norm(trajectory.wrench_on_object_world[:, :2], axis=1)
    planar = np.convolve(np.pad(planar, _SMOOTH // 2, mode="edge"), np.full(_SMOOTH, 1 / _SMOOTH), "valid")
    force, tare = planar[inside], planar[trajectory.mask(Phase.TARE)]
    if len(tare):
        noise = float(np.quantile(tare, 0.9))
    else:  # that of white noise as large as the scatter from sample to sample
        steps = np.diff(trajectory.wrench_on_object_world[inside, :2], axis=0)
        noise = _QUIET * float(np.sqrt(np.square(steps).mean() / 2))
    usual = np.quantile(force, 0.9)
    if not (force > TOUCHING * usual).any() or usual < NOISE * noise:
        raise InvalidValueError("trajectory", "no force at the fingertip", "a push that meets the object")
    return max(runs(inside & (planar > TOUCHING * usual)), key=len)


def _count(time: Float[np.ndarray, "N"], pace: float) -> int:
    """Number of windows in evenly spaced times [s]."""
    return int(len(time) * float(np.median(np.diff(time))) / (pace * WINDOW) + 1e-6) if len(time) > 1 else 0


def camera_errors_of(
    covariance: Float[np.ndarray, "N N"], late: Float[np.ndarray, "N"], shared: float
) -> Float[np.ndarray, "N M"]:
    """Effects of a camera's errors: N of the window alone, and the effect `late` of the delay, which its trial shares.

    Args:
        covariance: covariance of the motion, delay included.
        late: effect of one standard deviation of the delay.
        shared: number of windows that share a frame; the variance of the noise is multiplied by it.
    """
    values, vectors = np.linalg.eigh(covariance - np.outer(late, late))
    return np.column_stack([vectors * np.sqrt(np.maximum(values, 0.0) * max(shared, 1.0)), late])
