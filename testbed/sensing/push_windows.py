"""Windows of a push: short stretches while the fingertip touches, with the object's motion as a camera sees it."""

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
"""Least length of a window, at a pace of 1 [s]: the center of rotation moves on meanwhile."""
BEGIN = 0.3
"""Time left out after the fingertip has met the object, at a pace of 1 [s]."""
TOUCHING = 0.3
"""Force by which the fingertip touches, over what it takes to push."""
NOISE = 2.0
"""Ratio of the force of a push to that of a tare, below which the fingertip meets nothing."""
_SMOOTH = 5


@reduced_once
def push_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of a push, from soon after the fingertip meets the object until it leaves it, or the path ends.

    Raises:
        InvalidValueError: no push with status ok, no camera, or no stretch of contact long enough that the camera saw.
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
    met, left = float(time[contact[0]]), float(time[contact[-1]])
    if _count(time[kept], pace) < 1:
        allowed = f"{pace * (WINDOW + BEGIN) + TRIM_END:.2g} s or more at this speed"
        raise InvalidValueError("trajectory", f"{left - met:.2g} s in contact", allowed)
    found = stretches(time[kept], trajectory.tcp_position[kept, :2], camera, (met + pace * BEGIN / 2, left), pace)
    tared = tare_time(trajectory)
    whole = noise_of_mean(trajectory.wrench_on_object_world[kept], round(BATCH / step))
    windows = []
    for part, yaw, motion in found:
        axes = np.tile(np.eye(3), (len(part), 1, 1))
        axes[:, :2, :2] = rotation_2d(-yaw)
        wrench = rotate_wrench(axes, trajectory.wrench_on_object_world[kept[part]])
        middle = len(part) // 2
        from_sensor = sensor_map(trajectory, (int(kept[part[middle]]), float(yaw[middle])))
        bias, drift = bias_and_drift(trajectory, from_sensor)
        turned = block_diag(axes[middle], axes[middle])
        windows.append(
            SteadyWindow(
                grasp=None,
                wrench=wrench.mean(axis=0),
                covariance=turned @ whole @ turned.T * (len(kept) / len(part)),
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
    """Indices of times [s] in contact that count: not as the fingertip meets the object, nor as it leaves."""
    return np.flatnonzero((time >= time[0] + pace * BEGIN) & (time <= time[-1] - TRIM_END))


class Stretch(NamedTuple):
    """A part of a push as a camera sees it."""

    samples: Int[np.ndarray, "N"]
    """Indices of its samples."""
    yaw: Float[np.ndarray, "N"]
    """Yaw of the object at each [rad], world."""
    motion: dict[str, Any]
    """Fields of its `SteadyWindow` that the motion decides."""


def stretches(
    time: Float[np.ndarray, "N"],
    place: Float[np.ndarray, "N 2"],
    camera: PoseStream,
    within: tuple[float, float],
    pace: float,
) -> list[Stretch]:
    """Stretches of a push of at least `WINDOW` s at its pace; those not seen are left out.

    Args:
        time: times in contact that count [s].
        place: places of the fingertip then [m], world.
        camera: poses of the object.
        within: times between which its motion is smooth [s].
        pace: that of the push.
    """
    count = _count(time, pace)
    if count < 1:
        return []
    step = float(np.median(np.diff(time)))
    seen = camera.motion(time, within=within, span=None if pace == 1.0 else pace * SPAN)
    yaw = seen.pose[:, 2]
    into = rotation_2d(-yaw)
    point = np.einsum("nij,nj->ni", into, place - seen.pose[:, :2])
    spin, alpha = seen.twist[:, 2:], seen.acceleration[:, 2:]
    linear = np.einsum("nij,nj->ni", into, seen.twist[:, :2]) + spin * perpendicular(point)
    rate = np.einsum("nij,nj->ni", into, seen.acceleration[:, :2]) + alpha * perpendicular(point) - spin**2 * point
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
            "seen": into_object @ seen_errors(seen.covariance[middle], seen.late[middle], shared),
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
    """Indices of the samples that methods are given: of every window of a push, of every steady stretch of the others.

    Raises:
        InvalidValueError: as `push_windows` or `steady_samples`.
    """
    return (push_samples if trajectory.action.pushes else steady_samples)(trajectory)


def touching(trajectory: Trajectory) -> Int[np.ndarray, "N"]:
    """Indices of the longest run of samples in which the fingertip pushes, by the measured force.

    Raises:
        InvalidValueError: it never touches.
    """
    inside = trajectory.segment >= 0
    if inside.sum() < _SMOOTH:
        raise InvalidValueError("trajectory", "no steady stretch", "a push")
    across = np.linalg.norm(trajectory.wrench_on_object_world[:, :2], axis=1)
    across = np.convolve(np.pad(across, _SMOOTH // 2, mode="edge"), np.full(_SMOOTH, 1 / _SMOOTH), "valid")
    force, free = across[inside], across[trajectory.mask(Phase.TARE)]
    usual = np.quantile(force, 0.9)
    if not (force > TOUCHING * usual).any() or (len(free) and usual < NOISE * np.quantile(free, 0.9)):
        raise InvalidValueError("trajectory", "no force at the fingertip", "a push that meets the object")
    return max(runs(inside & (across > TOUCHING * usual)), key=len)


def _count(time: Float[np.ndarray, "N"], pace: float) -> int:
    """Number of windows in times at even steps [s]."""
    return int(len(time) * float(np.median(np.diff(time))) / (pace * WINDOW) + 1e-6) if len(time) > 1 else 0


def seen_errors(
    covariance: Float[np.ndarray, "N N"], late: Float[np.ndarray, "N"], shared: float
) -> Float[np.ndarray, "N M"]:
    """Effects of a camera's errors: N of a window's own, and one of its trial, of poses that are `late`.

    Neighboring windows share frames: each counts for so many windows, and their errors are widened as much.
    """
    values, vectors = np.linalg.eigh(covariance - np.outer(late, late))
    return np.column_stack([vectors * np.sqrt(np.maximum(values, 0.0) * max(shared, 1.0)), late])
