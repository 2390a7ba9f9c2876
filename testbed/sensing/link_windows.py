"""Windows of an articulated object: short stretches of constant speed of the hand, in which the other links trail."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from weakref import WeakKeyDictionary

import numpy as np
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError
from testbed.sensing.camera import SPAN, PoseStream
from testbed.sensing.push_windows import WINDOW
from testbed.sensing.windows import PARTS, SteadyWindow, part_means, steady_samples, windows_of
from testbed.trajectory import Trajectory

_REDUCED: WeakKeyDictionary[Trajectory, list[SteadyWindow]] = WeakKeyDictionary()
"""Windows of each record, which never changes."""


def link_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of every steady stretch, each with the angle, rate and slope of every link as a camera sees them.

    Raises:
        InvalidValueError: not a turn or slide with status ok, a stretch too short, or no camera that sees the links.
    """
    if not (trajectory.action.dragged and trajectory.ok):
        raise InvalidValueError("trajectory", f"{trajectory.action}, {trajectory.status}", "a turn or slide, status ok")
    if trajectory.camera is None or trajectory.camera.parts < 2:
        raise InvalidValueError("trajectory.camera", None, "poses of every link by a camera: the hand holds one alone")
    if trajectory not in _REDUCED:
        _REDUCED[trajectory] = _reduced(trajectory, trajectory.camera)
    return list(_REDUCED[trajectory])


def _reduced(trajectory: Trajectory, camera: PoseStream) -> list[SteadyWindow]:
    step = float(np.median(np.diff(trajectory.time_s)))
    stretches, more = [], list[dict[str, np.ndarray]]()
    for stretch in steady_samples(trajectory):
        time = trajectory.time_s[stretch]
        within = float(time[0]) - SPAN / 4, float(time[-1]) + SPAN / 4
        seen = [camera.motion(time, part, within) for part in range(camera.parts)]
        turned = np.stack([np.column_stack([m.pose[:, 2], m.twist[:, 2], m.acceleration[:, 2]]) for m in seen], 1)
        for part in parts_of(len(stretch), step):
            if np.isnan(turned[part]).any():  # frames were lost
                continue
            middle = part[len(part) // 2]
            shared = SPAN / (len(part) * step)
            stretches.append((stretch[part], stretch))
            more.append(
                {
                    "turned": part_means(turned[part]),
                    "turned_errors": np.array(
                        [turned_errors(m.covariance[middle], m.late[middle], shared) for m in seen]
                    ),
                }
            )
    if not stretches:
        raise InvalidValueError("trajectory.camera", "too few frames", "frames near every stretch")
    return [replace(window, **of) for window, of in zip(windows_of(trajectory, stretches), more, strict=True)]


def parts_of(count: int, step: float) -> Iterator[Int[np.ndarray, "N"]]:
    """Indices of the samples of each window of a stretch of `count` samples, `step` s apart."""
    for whole in np.array_split(np.arange(count), max(int(count * step / WINDOW + 1e-6), 1)):
        yield whole[: len(whole) // PARTS * PARTS]  # no part ends within a sample


def turned_errors(
    covariance: Float[np.ndarray, "9 9"], late: Float[np.ndarray, "9"], shared: float
) -> Float[np.ndarray, "3 4"]:
    """Effects of the camera's errors on angle, rate and slope: three of the window's own, and one of its trial.

    Neighboring windows share frames: each counts for so many windows, and their errors are widened as much.
    """
    yaw = [2, 5, 8]
    values, vectors = np.linalg.eigh((covariance - np.outer(late, late))[np.ix_(yaw, yaw)])
    return np.column_stack([vectors * np.sqrt(np.maximum(values, 0.0) * max(shared, 1.0)), late[yaw]])
