"""Static poses from a recording, for a calibration: intervals in which the hand rests, or moves slowly."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.ndimage import binary_erosion
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.importers.columns import Columns
from testbed.importers.logs import LogError, Series, read_all
from testbed.importers.phases import RATE, check_sensor_alive, common_base, resampled, resampled_rotation
from testbed.importers.poses import Pose, hand_pose
from testbed.importers.streams import in_sensor_axes, open_log, read_wrench, sensor_log
from testbed.robot.calibration.static_poses import UNKNOWNS, StaticPose, calibrate, residuals
from testbed.sensing.series import runs
from testbed.sensing.windows import mean_covariance
from testbed.toml import load_toml

WITHIN_S = 0.5
"""Window over which the motion of the hand is measured [s]."""
STILL_TURN, STILL_WAY = 0.003, 0.001
"""Largest turn [rad] and displacement [m] within the window of a hand at rest."""
SLOW_TURN, SLOW_WAY = 0.1, 0.05
"""Largest turn [rad] and displacement [m] within the window of a slow motion, whose inertial forces are negligible."""
SETTLED_S = 0.15
"""Time beyond WITHIN_S / 2 that is excluded after a motion and before the next [s]."""
SHORTEST_S = 1.0
"""Shortest rest that is a pose [s]."""
MEASURED = 5
"""Least number of samples of a stream within `SHORTEST_S`."""
ASSUMED_ERROR = 1e-3
"""Error of a reading in the first fit of rows, as a part of the standard deviation of all readings."""
FEWEST = 6
"""Least number of rests; with fewer, slow motion is used."""


def recorded_poses(log: Path, mapping: Path) -> tuple[list[StaticPose], str]:
    """Static poses of a recording, and a description of the samples without a measurement.

    Of the mapping file [time], [sensor] and [hand] are read; the sensor's sign and mount are ignored.

    Each rest of `SHORTEST_S` or more is a pose. With fewer than `FEWEST` rests the poses are half seconds of slow
    motion instead, whose scatter is taken about a parabola. A pose has at least `MEASURED` samples of the sensor and of
    the hand. With `rows = "poses"` each row of a table is a pose; the residuals of a fit then give the error of a
    reading.

    Raises:
        InvalidFileError: the mapping does not fit its schema; one line per error.
        InvalidValueError: an unknown column or topic; the message names the nearest.
        LogError: invalid numbers or times, or too few poses; the message says what to record.
    """
    table = load_toml(mapping, Columns)
    if table.sensor.torque_about != "sensor":
        allowed = "sensor: a calibration finds the tool about the sensor, and knows no TCP"
        raise InvalidValueError("sensor.torque_about", table.sensor.torque_about, allowed, file=mapping)
    source = open_log(log, table)
    other = sensor_log(source, table, mapping.parent)
    (wrench, left_out), pose = read_all(
        lambda: read_wrench(other, table.sensor, table.time),
        lambda: hand_pose(source, table.hand, table.time, mapping.parent, table.longest_gap_s),
    )
    late = (table.sensor.delay_s or 0.0) * (table.rows == "samples")
    wrench = wrench._replace(time_s=wrench.time_s + (other.epoch_s - source.epoch_s) - late)
    check_sensor_alive(wrench, wrench.time_s[[0, 0]], table.sensor.measured)
    wrench = in_sensor_axes(wrench, pose, table.sensor, table.hand)
    if table.rows == "poses":
        return _of_rows(wrench, pose, table.gravity), left_out
    interval = max(float(np.median(np.diff(times))) for times in (wrench.time_s, pose[0].time_s))
    if interval > SHORTEST_S / MEASURED:
        raise LogError(
            f"poses: a sample every {interval:.3g} s; allowed: {MEASURED} or more measured in {SHORTEST_S:g} s; or, "
            'where each row of a table is a still pose, rows = "poses" in the mapping'
        )
    base = common_base([wrench, pose[0]], table.longest_gap_s)
    hand, position = resampled_rotation(pose[0].time_s, pose[1], base).as_quat(), resampled(pose[0], base)
    values = resampled(wrench, base)
    turn, way = _motion(hand, position)
    margin = np.ones(2 * round(SETTLED_S * RATE) + 1)
    measured = _measured(wrench.time_s, base) & _measured(pose[0].time_s, base)
    still = binary_erosion((turn < STILL_TURN) & (way < STILL_WAY) & measured, margin)
    found = [_pose(hand[run], values[run], 0) for run in runs(still) if len(run) >= SHORTEST_S * RATE]
    if len(found) >= FEWEST:
        return found, left_out
    size = round(WITHIN_S * RATE)
    slow = runs((turn < SLOW_TURN) & (way < SLOW_WAY) & measured)
    parts = [run[i : i + size] for run in slow for i in range(0, len(run) - size + 1, size)]
    moving = [_pose(hand[part], values[part], 2) for part in parts]
    if len(moving) < FEWEST:
        raise LogError(
            f"poses: {len(found)} rests of {SHORTEST_S:g} s and {len(moving)} half seconds of slow motion; allowed: "
            f"{FEWEST} or more, each tilted another way"
        )
    return moving, left_out


def _of_rows(wrench: Series, pose: Pose, gravity: float) -> list[StaticPose]:
    """Poses of rows with both wrench and hand; the residuals of a fit, per axis, give the error of a reading."""
    _, of_hand, of_wrench = np.intersect1d(pose[0].time_s, wrench.time_s, return_indices=True)
    if len(of_wrench) < FEWEST:
        raise LogError(f"poses: {len(of_wrench)} rows; allowed: {FEWEST} or more, each tilted another way")
    values = wrench.values[of_wrench]
    # small beside the changes of the readings: calibrate then judges by the scatter of its own residuals
    force, torque = ASSUMED_ERROR * np.maximum(np.sqrt(values.reshape(-1, 2, 3).var(axis=0).sum(axis=1)), 1e-6)
    unit = np.repeat([force, torque], 3)
    pairs = zip(pose[1].as_quat(scalar_first=True)[of_hand], values, strict=True)
    poses = [StaticPose(hand, reading, unit) for hand, reading in pairs]
    left, rows = residuals(calibrate(poses, gravity=gravity), poses), 6 * len(poses)
    scatter = np.sqrt(left.var(axis=0) * rows / (rows - UNKNOWNS))  # less the mean, which a walk of the zero has
    return [replace(each, standard_error=np.maximum(scatter, 1e-9)) for each in poses]


def _measured(time: np.ndarray, base: np.ndarray) -> np.ndarray:
    """Mask of the times around which at least `MEASURED` samples were measured, not interpolated, shape of `base`."""
    first, last = (np.searchsorted(time, base + side * SHORTEST_S / 2) for side in (-1, 1))
    return last - first >= MEASURED


def _motion(hand: np.ndarray, position: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Turn [rad] and displacement [m] of the hand over the window around each of T samples, each (T,).

    Hand: quaternions xyzw, (T, 4); position [m], (T, 3).
    """
    half = round(WITHIN_S * RATE / 2)
    index = np.arange(len(position))
    before, after = np.maximum(index - half, 0), np.minimum(index + half, len(position) - 1)
    turn = (Rotation.from_quat(hand[after]) * Rotation.from_quat(hand[before]).inv()).magnitude()
    return turn, np.linalg.norm(position[after] - position[before], axis=1)


def _pose(hand: np.ndarray, wrench: np.ndarray, degree: int) -> StaticPose:
    """Mean pose (quaternions xyzw) and reading of an interval; scatter is about a polynomial trend of this degree."""
    time = np.linspace(-1, 1, len(wrench))
    trend = np.polynomial.polynomial.polyvander(time, degree)
    detrended = wrench - trend @ np.linalg.lstsq(trend, wrench, rcond=None)[0]
    error = np.sqrt(np.maximum(np.diag(mean_covariance(detrended)), 1e-12))
    return StaticPose(Rotation.from_quat(hand).mean().as_quat(scalar_first=True), wrench.mean(axis=0), error)
