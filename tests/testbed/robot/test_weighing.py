"""Weighing through the sensor, a known mass as a check, and where a held object hangs."""

import re
from typing import Any

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from testbed.objects.model import GRAVITY
from testbed.robot.weighing import Weighing, check_known_mass, held_center, weigh
from tests.helpers.records import coloured_noise

SPREAD = np.array([0.067, 0.083, 0.065, 0.0034, 0.0030, 0.0010])
BIAS = np.array([5.0, -3.0, 8.0, 0.1, 0.2, -0.3])
COVARIANCE = np.diag(np.array([0.01, 0.01, 0.01, 5e-4, 5e-4, 2e-4]) ** 2)
UP = Rotation.from_euler("xyz", [170, 10, 30], degrees=True).as_matrix()[2]
"""World z in the axes of a sensor that points down, not quite."""


def samples(mass: float, seed: int = 0, *, sign: int = 1, noise: float = 1.0, count: int = 200) -> np.ndarray:
    """Two seconds of a hand that holds a mass."""
    rng = np.random.default_rng(seed)
    held = np.concatenate([mass * GRAVITY * UP, np.zeros(3)])
    return BIAS + sign * held + noise * SPREAD * coloured_noise(count, 6, 0.3, rng)


def weighed(mass: float, seed: int = 0, **how: Any) -> Weighing:
    return weigh(samples(0.0, 2 * seed), samples(mass, 2 * seed + 1, **how), UP)


def test_without_noise_it_reads_the_mass():
    for sign in (1, -1):
        empty, loaded = (samples(m, sign=sign, noise=1e-9) for m in (0.0, 1.23))
        assert weigh(empty, loaded, UP).mass == pytest.approx(sign * 1.23, abs=1e-8)
        assert weigh(empty, loaded, None).mass == pytest.approx(1.23, abs=1e-8)


def test_its_error_is_as_large_as_it_says():
    found = [weighed(0.8, seed) for seed in range(300)]
    z = np.array([(w.mass - 0.8) / w.standard_error for w in found])
    assert abs(z.mean()) < 4 / np.sqrt(300)
    assert np.mean(z**2) == pytest.approx(1.0, abs=0.35)
    assert np.mean([w.standard_error for w in found]) < 0.002


def test_drift_between_the_readings_is_in_its_error():
    empty, loaded = samples(0.0), samples(0.5, 1)
    sure, unsure = weigh(empty, loaded, UP), weigh(empty, loaded, UP, drift=0.5)
    assert unsure.mass == sure.mass
    assert unsure.standard_error == pytest.approx(np.hypot(sure.standard_error, 0.5 / GRAVITY))


@pytest.mark.parametrize(
    ("mass", "how", "verdict", "said"),
    [
        (1.0, {}, "agrees", r"9\.8\d \+- 0\.0\d N where 1 kg weighs 9\.81 N: within 2%"),
        (1.0, {"sign": -1}, "negated", "set sign = -1"),
        (1.1, {}, "disagrees", r"off by \+\d+\.\d %: the sensor may hold a stored tool calibration"),
        (0.5, {}, "disagrees", r"off by -(49|50)\.\d %"),
        (1.0, {"noise": 20.0}, "unsure", r"the scatter hides 2%: measure longer, or take \d+\.\d kg or more"),
    ],
)
def test_a_known_mass_tells_a_sensors_faults(mass: float, how: dict[str, Any], verdict: str, said: str):
    check = check_known_mass(weighed(mass, **how), 1.0)
    assert check.verdict == verdict
    assert re.search(said, check.text)


def test_an_honest_sensor_agrees_and_a_dishonest_one_does_not_whatever_the_draw():
    for seed in range(100):
        assert check_known_mass(weighed(1.0, seed), 1.0).verdict == "agrees"
        assert check_known_mass(weighed(1.05, seed), 1.0).verdict == "disagrees"


def test_an_object_hangs_where_its_moment_says():
    center, weight = np.array([0.03, -0.02, -0.05]), np.array([0, 0, 0.6 * GRAVITY])
    held = np.concatenate([weight, np.cross(center, weight)])
    found = held_center(held, COVARIANCE)
    assert_allclose(found.offset, center[:2], atol=1e-12)
    rng = np.random.default_rng(0)
    draws = [held_center(held + rng.multivariate_normal(np.zeros(6), COVARIANCE), COVARIANCE) for _ in range(300)]
    assert_allclose(np.cov([d.offset for d in draws], rowvar=False), found.covariance, rtol=0.3, atol=2e-10)
