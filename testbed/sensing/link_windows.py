"""Windows of an articulated object: short stretches in which the hand has constant speed and the other links trail."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError
from testbed.sensing.camera import SPAN
from testbed.sensing.push_windows import WINDOW, camera_errors_of
from testbed.sensing.windows import PARTS, SteadyWindow, part_means, reduced_once, steady_samples, windows_of
from testbed.trajectory import Trajectory


@reduced_once
def link_windows(trajectory: Trajectory) -> list[SteadyWindow]:
    """Windows of every steady stretch, with yaw, yaw rate and angular acceleration of every link by a camera.

    Raises:
        InvalidValueError: not a turn or slide with status ok, a stretch that is too short, or no poses of the links.
    """
    if not (trajectory.action.dragged and trajectory.ok):
        raise InvalidValueError("trajectory", f"{trajectory.action}, {trajectory.status}", "a turn or slide, status ok")
    camera = trajectory.camera
    if camera is None or camera.parts < 2:
        raise InvalidValueError("trajectory.camera", None, "poses of every link by a camera: the hand holds one alone")
    step = float(np.median(np.diff(trajectory.time_s)))
    stretches, more = [], list[dict[str, np.ndarray]]()
    for stretch in steady_samples(trajectory):
        time = trajectory.time_s[stretch]
        within = float(time[0]) - SPAN / 4, float(time[-1]) + SPAN / 4
        motions = [camera.motion(time, part, within) for part in range(camera.parts)]
        turned = np.stack([np.column_stack([m.pose[:, 2], m.twist[:, 2], m.acceleration[:, 2]]) for m in motions], 1)
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
                        [turned_errors(m.covariance[middle], m.late[middle], shared) for m in motions]
                    ),
                }
            )
    if not stretches:
        raise InvalidValueError("trajectory.camera", "too few frames", "frames near every stretch")
    return [replace(window, **of) for window, of in zip(windows_of(trajectory, stretches), more, strict=True)]


def parts_of(count: int, step: float) -> Iterator[Int[np.ndarray, "N"]]:
    """Indices of the samples of each window of a stretch of `count` samples, `step` s apart."""
    for whole in np.array_split(np.arange(count), max(int(count * step / WINDOW + 1e-6), 1)):
        yield whole[: len(whole) // PARTS * PARTS or None]  # whole samples in every part, where there are as many


def turned_errors(
    covariance: Float[np.ndarray, "9 9"], late: Float[np.ndarray, "9"], shared: float
) -> Float[np.ndarray, "3 4"]:
    """Effects of the camera's errors on yaw and its two derivatives: three of the window, and one of its trial."""
    yaw = [2, 5, 8]
    return camera_errors_of(covariance[np.ix_(yaw, yaw)], late[yaw], shared)
