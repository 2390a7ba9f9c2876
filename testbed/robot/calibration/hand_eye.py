"""Hand-eye calibration: a tracker's frame from points measured by the tracker and touched by the TCP."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.frames import rotation_matrix
from testbed.robot.calibration.static_poses import CalibrationError
from testbed.robot.interfaces import ObjectPose, Pose
from testbed.validation import frozen_array

SPREAD = 0.02
"""Least distance of the points from one line, root mean square [m]."""


@dataclass(frozen=True, eq=False)
class HandEye:
    """Calibration of a tracker."""

    tracker_in_base: Pose
    """Pose of the tracker's frame."""
    residual: float
    """Root mean square distance between the aligned points [m]."""
    standard_error: float
    """Standard error of a converted position near the points [m]."""

    def to_base(self, points: Float[np.ndarray, "N 3"]) -> Float[np.ndarray, "N 3"]:
        """Transform points [m] from the tracker's frame to the base frame."""
        return points @ rotation_matrix(self.tracker_in_base.orientation).T + self.tracker_in_base.position


@dataclass(frozen=True, eq=False)
class TrackedPose:
    """An `ObjectPose` from a calibrated tracker."""

    tracker: ObjectPose
    """Pose of the object in the tracker's x-y plane."""
    hand_eye: HandEye

    def read(self) -> tuple[float, float, float]:
        """Planar pose of the object in the arm's base frame: x, y [m] and yaw [rad]."""
        x, y, yaw = self.tracker.read()
        here, ahead = self.hand_eye.to_base(np.array([[x, y, 0.0], [x + np.cos(yaw), y + np.sin(yaw), 0.0]]))
        along = ahead - here
        return float(here[0]), float(here[1]), float(np.arctan2(along[1], along[0]))


def align(seen: Float[np.ndarray, "N 3"], touched: Float[np.ndarray, "N 3"]) -> HandEye:
    """Calibration by the rigid motion between two sets of points (Kabsch's algorithm).

    Args:
        seen: points in the tracker's frame [m].
        touched: positions of the TCP at the same points [m], base frame.

    Raises:
        InvalidValueError: the sets differ in length, or a point has not three coordinates.
        CalibrationError: fewer than 4 points, or collinear points.
    """
    a = frozen_array("hand_eye.seen", seen, (None, 3))
    b = frozen_array("hand_eye.touched", touched, (None, 3))
    if len(a) != len(b):
        raise InvalidValueError("hand_eye.touched", f"{len(b)} points", f"{len(a)}, one for each seen point")
    if len(a) < 4:
        raise CalibrationError(f"hand-eye: got {len(a)} points; allowed: 4 or more, not on one line")
    middle_a, middle_b = a.mean(axis=0), b.mean(axis=0)
    off_line = np.linalg.svd(b - middle_b, compute_uv=False)[1] / np.sqrt(len(b))
    if off_line < SPREAD:
        raise CalibrationError(
            f"hand-eye: the points lie within {1e3 * off_line:.0f} mm of one line; allowed: {1e3 * SPREAD:.0f} mm or "
            "more off it: spread them over the table"
        )
    rotation = Rotation.align_vectors(b - middle_b, a - middle_a)[0]
    turn = rotation.as_matrix()
    position = middle_b - turn @ middle_a
    left = b - (a @ turn.T + position)
    scatter = float(np.sqrt(np.sum(left**2) / (3 * len(a) - 6)))
    return HandEye(
        Pose(position, rotation.as_quat(scalar_first=True)),
        residual=float(np.sqrt(np.mean(np.sum(left**2, axis=1)))),
        standard_error=scatter * float(np.sqrt(3 * 2 / len(a))),
    )
