"""Windows of a push: short stretches while the fingertip touches, with the object's motion as a camera sees it."""

from __future__ import annotations

from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int
from scipy.linalg import block_diag

from testbed.actions.push import Push
from testbed.errors import InvalidValueError
from testbed.frames import perpendicular, rotate_wrench, rotation_2d
from testbed.sensing.camera import SPAN
from testbed.sensing.compensation import tare_time
from testbed.sensing.windows import BATCH, PARTS, TRIM_END, SteadyWindow, bias_and_drift, noise_of_mean
from testbed.trajectory import Trajectory

WINDOW = 0.4
"""Least length of a window [s]: the center of rotation moves on meanwhile."""
BEGIN = 0.3
"""Time left out after the fingertip has met the object [s]."""
TOUCHING = 0.3
"""Force by which the fingertip touches, over what it takes to push."""
_SMOOTH = 5


_REDUCED: WeakKeyDictionary[Trajectory, list[SteadyWindow]] = WeakKeyDictionary()
"""Windows of each record, which never changes."""


def push_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of a push, from soon after the fingertip meets the object until it leaves it, or the path ends.

    Raises:
        InvalidValueError: no push with status ok, no camera, or no stretch of contact long enough that the camera saw.
    """
    if not (isinstance(trajectory.action, Push) and trajectory.ok):
        raise InvalidValueError("trajectory", f"{trajectory.action}, {trajectory.status}", "a Push with status ok")
    if trajectory not in _REDUCED:
        _REDUCED[trajectory] = _reduced(trajectory)
    return list(_REDUCED[trajectory])


def _reduced(trajectory: Trajectory) -> list[SteadyWindow]:
    camera = trajectory.camera
    if camera is None:
        raise InvalidValueError("trajectory.camera", None, "poses of the object by a camera: the hand does not hold it")
    contact = touching(trajectory)
    time = trajectory.time_s
    within = (float(time[contact[0]]) + BEGIN / 2, float(time[contact[-1]]))
    kept = contact[(time[contact] >= time[contact[0]] + BEGIN) & (time[contact] <= time[contact[-1]] - TRIM_END)]
    step = float(np.median(np.diff(time)))
    count = int(len(kept) * step / WINDOW + 1e-6)
    if count < 1:
        raise InvalidValueError("trajectory", f"{len(kept)} samples in contact", f"at least {WINDOW:g} s of them")
    seen = camera.motion(time[kept], within=within)
    yaw = seen.pose[:, 2]
    into = rotation_2d(-yaw)
    place = trajectory.tcp_position[kept, :2]
    point = np.einsum("nij,nj->ni", into, place - seen.pose[:, :2])
    spin, alpha = seen.twist[:, 2:], seen.acceleration[:, 2:]
    linear = np.einsum("nij,nj->ni", into, seen.twist[:, :2]) + spin * perpendicular(point)
    rate = np.einsum("nij,nj->ni", into, seen.acceleration[:, :2]) + alpha * perpendicular(point) - spin**2 * point
    twist, acceleration = np.hstack([linear, spin]), np.hstack([rate, alpha])
    poses = np.column_stack([place, yaw])
    axes = np.tile(np.eye(3), (len(kept), 1, 1))
    axes[:, :2, :2] = into
    wrench = rotate_wrench(axes, trajectory.wrench_on_object_world[kept])
    tared = tare_time(trajectory)
    whole = noise_of_mean(trajectory.wrench_on_object_world[kept], round(BATCH / step))
    windows = []
    for part in np.array_split(np.arange(len(kept)), count):
        if np.isnan(twist[part]).any():  # frames were lost
            continue
        middle = part[len(part) // 2]
        from_sensor, bias, drift = bias_and_drift(trajectory, (int(kept[middle]), float(yaw[middle])))
        turned = block_diag(into[middle], 1.0, into[middle], 1.0)
        windows.append(
            SteadyWindow(
                grasp=None,
                wrench=wrench[part].mean(axis=0),
                covariance=turned @ whole @ turned.T * (len(kept) / len(part)),
                twist=twist[part].mean(axis=0),
                twists=_by_part(twist[part]),
                acceleration=acceleration[part].mean(axis=0),
                spin_square=float(np.mean(spin[part] ** 2)),
                tcp_height=float(trajectory.tcp_position[kept[part], 2].mean()),
                yaw=yaw[part[[0, -1]]],
                poses=_by_part(poses[part]),
                from_sensor=from_sensor,
                bias_covariance=bias,
                drift_covariance=drift,
                since_tare=time[kept[part[[0, -1]]]] - tared,
                point=point[part].mean(axis=0),
                seen=_errors(seen.covariance[middle], seen.late[middle], into[middle], SPAN / (len(part) * step)),
            )
        )
    if not windows:
        raise InvalidValueError("trajectory.camera", "too few frames in contact", "frames near every stretch")
    return windows


def push_samples(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples of every window of a push.

    Raises:
        InvalidValueError: as `push_windows`.
    """
    since = trajectory.time_s - tare_time(trajectory)
    ends = [window.since_tare + np.array([-1e-9, 1e-9]) for window in push_windows(trajectory)]
    return [np.flatnonzero((since >= begin) & (since <= end)) for begin, end in ends]


def touching(trajectory: Trajectory) -> Int[np.ndarray, "N"]:
    """Indices of the longest run of samples in which the fingertip pushes, by the measured force.

    Raises:
        InvalidValueError: it never touches.
    """
    inside = np.flatnonzero(trajectory.segment >= 0)
    if len(inside) < _SMOOTH:
        raise InvalidValueError("trajectory", "no steady stretch", "a push")
    force = np.linalg.norm(trajectory.wrench_on_object_world[inside, :2], axis=1)
    force = np.convolve(np.pad(force, _SMOOTH // 2, mode="edge"), np.full(_SMOOTH, 1 / _SMOOTH), "valid")
    touches = force > TOUCHING * np.quantile(force, 0.9)
    if not touches.any():
        raise InvalidValueError("trajectory", "no force at the fingertip", "a push that meets the object")
    runs = np.split(inside[touches], np.flatnonzero(np.diff(inside[touches]) > 1) + 1)
    return max(runs, key=len)


def _by_part(values: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "S 3"]:
    return np.array([part.mean(axis=0) for part in np.array_split(values, PARTS)])


def _errors(
    covariance: Float[np.ndarray, "9 9"], late: Float[np.ndarray, "9"], into: Float[np.ndarray, "2 2"], shared: float
) -> Float[np.ndarray, "9 10"]:
    """Effects of the camera's errors on pose, twist and acceleration, along the object's axes.

    Neighboring windows share frames: each counts for so many windows, and their errors are widened as much.
    """
    values, vectors = np.linalg.eigh(covariance - np.outer(late, late))
    own = vectors * np.sqrt(np.maximum(values, 0.0) * max(shared, 1.0))
    return block_diag(*[into, [[1.0]]] * 3) @ np.column_stack([own, late])
