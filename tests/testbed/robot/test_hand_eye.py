"""Hand-eye calibration: the tracker's frame comes back, with an honest error."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.robot.calibration.hand_eye import align
from testbed.robot.calibration.static_poses import CalibrationError

TURN = Rotation.from_euler("xyz", [170, 5, 40], degrees=True)
PLACE = np.array([0.5, -0.2, 1.1])
CORNERS = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.15, 0.15) for z in (0.9, 1.0)])
"""Points in the tracker's frame [m]."""
LINE = np.linspace(0, 1, 6)[:, None] * np.array([1.0, 2.0, 0.5])


def touched(points: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    return TURN.apply(points) + PLACE + noise * np.random.default_rng(seed).standard_normal(points.shape)


@pytest.mark.parametrize("points", [CORNERS, CORNERS[::2]], ids=["in space", "in a plane"])
def test_without_noise_the_frame_comes_back(points: np.ndarray):
    found = align(points, touched(points))
    assert_allclose(found.tracker_in_base.position, PLACE, atol=1e-9)
    assert (Rotation.from_quat(found.tracker_in_base.orientation, scalar_first=True) * TURN.inv()).magnitude() < 1e-9
    assert found.residual < 1e-12
    assert_allclose(found.to_base(points), touched(points), atol=1e-12)


def test_its_standard_error_near_the_points_is_honest():
    draws = [align(CORNERS, touched(CORNERS, 0.001, seed)) for seed in range(300)]
    off = [np.linalg.norm(d.to_base(CORNERS) - touched(CORNERS), axis=1) for d in draws]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean([d.standard_error for d in draws]), rel=0.15)


@pytest.mark.parametrize(
    ("seen", "count", "error", "word"),
    [
        (LINE, 6, CalibrationError, "within 0 mm of one line"),
        (CORNERS[:3], 3, CalibrationError, "got 3 points"),
        (CORNERS, 7, InvalidValueError, r"hand_eye\.touched: got '7 points'"),
    ],
)
def test_points_that_settle_nothing_are_refused(seen, count, error, word):
    with pytest.raises(error, match=word):
        align(seen, touched(seen)[:count])
