"""Hand-eye alignment: the tracker's frame comes back, and its error is as large as it says."""

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
"""In the tracker's frame, m."""


def touched(points: np.ndarray, noise: float = 0.0, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return TURN.apply(points) + PLACE + noise * rng.standard_normal(points.shape)


@pytest.mark.parametrize("points", [CORNERS, CORNERS[::2]], ids=["in space", "in a plane"])
def test_without_noise_it_comes_back(points: np.ndarray):
    found = align(points, touched(points))
    assert_allclose(found.tracker_in_base.position, PLACE, atol=1e-9)
    assert (Rotation.from_quat(found.tracker_in_base.orientation, scalar_first=True) * TURN.inv()).magnitude() < 1e-9
    assert found.residual < 1e-12
    assert_allclose(found.to_base(points), touched(points), atol=1e-12)


def test_its_error_near_the_points_is_as_large_as_it_says():
    draws = [align(CORNERS, touched(CORNERS, 0.001, seed)) for seed in range(300)]
    off = [np.linalg.norm(d.to_base(CORNERS) - touched(CORNERS), axis=1) for d in draws]
    assert np.sqrt(np.mean(np.square(off))) == pytest.approx(np.mean([d.standard_error for d in draws]), rel=0.15)


def test_a_pose_on_the_table_is_carried_over():
    level = Rotation.from_euler("z", 30, degrees=True)
    points = CORNERS * [1, 1, 0]
    place = np.array([0.4, 0.1, 0.0])
    found = align(points, level.apply(points) + place)
    x, y, yaw = found.planar_to_base(0.1, 0.0, np.radians(20))
    assert_allclose([x, y], (level.apply([0.1, 0, 0]) + place)[:2], atol=1e-9)
    assert yaw == pytest.approx(np.radians(50))


def test_points_that_tell_nothing_are_refused():
    line = np.linspace(0, 1, 6)[:, None] * np.array([1.0, 2.0, 0.5])
    with pytest.raises(CalibrationError, match="within 0 mm of one line; allowed: 20 mm or more"):
        align(line, touched(line))
    with pytest.raises(CalibrationError, match="got 3 points; allowed: 4 or more"):
        align(CORNERS[:3], touched(CORNERS[:3]))
    with pytest.raises(InvalidValueError, match=r"hand_eye\.touched: got '7 points'; allowed: 8"):
        align(CORNERS, touched(CORNERS)[:7])
