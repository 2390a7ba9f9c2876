"""Weighing through the sensor: mass and center of a held object, and a known mass as a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY
from testbed.sensing.windows import mean_covariance
from testbed.validation import check_positive, frozen_array

GAIN_ERROR = 0.02
"""Allowed relative error of a known mass; chosen here, since the manufacturer states no figure."""
SIGNIFICANT = 3
"""Standard errors within which two values agree."""


@dataclass(frozen=True)
class Weighing:
    """A mass from the change of the sensor's reading."""

    mass: float
    """Mass [kg]."""
    standard_error: float
    """Standard error [kg], from the scatter of both readings and any given drift between them."""


def weigh(
    empty: Float[np.ndarray, "T 6"],
    loaded: Float[np.ndarray, "T 6"],
    up: Float[np.ndarray, "3"] | None,
    drift: float = 0.0,
) -> Weighing:
    """Weigh by two readings with the hand in one orientation, so that tool and bias cancel.

    Args:
        empty: samples with nothing held [N, N m], as the sensor reports them.
        loaded: samples with the object hanging free.
        up: upward unit vector, sensor axes, shape (3,). None: the direction of the force is used, and the sensor's
            sign remains undetermined.
        drift: standard deviation of the change in bias between the two readings [N per axis].

    Raises:
        InvalidValueError: too few samples, or `up` no unit vector.
    """
    means, covariances = [], []
    for name, samples in (("empty", empty), ("loaded", loaded)):
        given = frozen_array(f"weigh.{name}", samples, (None, 6))[:, :3]
        if len(given) < 10:
            raise InvalidValueError(f"weigh.{name}", len(given), "10 or more samples")
        means.append(given.mean(axis=0))
        covariances.append(mean_covariance(given))
    force = means[1] - means[0]
    covariance = covariances[0] + covariances[1] + drift**2 * np.eye(3)
    length = float(np.linalg.norm(force))
    direction = force / max(length, 1e-12) if up is None else frozen_array("weigh.up", up, (3,))
    if abs(np.linalg.norm(direction) - 1) > 1e-3:
        raise InvalidValueError("weigh.up", direction.tolist(), "a unit vector, sensor axes")
    error = float(np.sqrt(direction @ covariance @ direction))
    return Weighing(float(force @ direction) / GRAVITY, error / GRAVITY)


Verdict = Literal["agrees", "disagrees", "negated", "unsure"]
"""Verdict of a known mass on a sensor. Disagrees: a wrong gain or a stored tool calibration; negated: the opposite
sign; unsure: the scatter exceeds the allowed error."""


def check_known_mass(weighing: Weighing, mass: float) -> tuple[Verdict, str]:
    """Verdict on a weighing of a known mass [kg], which may be off by `GAIN_ERROR`; and the verdict in a sentence."""
    check_positive("known mass", mass)
    ratio, error = weighing.mass / mass, weighing.standard_error / mass
    measured = (
        f"{weighing.mass * GRAVITY:.2f} +- {weighing.standard_error * GRAVITY:.2f} N where {mass:g} kg weighs "
        f"{mass * GRAVITY:.2f} N"
    )
    uncertainty = SIGNIFICANT * error
    if uncertainty > GAIN_ERROR:
        more = f"measure longer, or take {mass * uncertainty / GAIN_ERROR:.1f} kg or more"
        return "unsure", f"{measured}: the scatter hides {GAIN_ERROR:.0%}: {more}"
    if abs(ratio + 1) <= GAIN_ERROR + uncertainty:
        return "negated", f"{measured}: the sensor reports what the tool does to the arm: set sign = -1"
    if abs(ratio - 1) <= GAIN_ERROR + uncertainty:
        return "agrees", f"{measured}: within {GAIN_ERROR:.0%}"
    return "disagrees", (
        f"{measured}: off by {100 * (ratio - 1):+.1f} %: the sensor may hold a stored tool calibration, something may "
        "touch the load, or `up` is not up"
    )


def held_center(
    wrench: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"]
) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2 2"]]:
    """Center of mass of an object that hangs free, from the TCP [m], world x and y, and its covariance [m^2].

    Args:
        wrench: wrench of the gripper on the object about the TCP [N, N m], world axes.
        covariance: covariance of that wrench, shape (6, 6).

    Raises:
        InvalidValueError: no object is held: the upward force does not exceed `SIGNIFICANT` standard errors.
    """
    w = frozen_array("held_center.wrench", wrench, (6,))
    spread = frozen_array("held_center.covariance", covariance, (6, 6))
    if not w[2] > SIGNIFICANT * np.sqrt(spread[2, 2]):
        raise InvalidValueError("held_center.wrench", w[:3].tolist(), "a force that points up: an object that is held")
    offset = np.array([-w[4], w[3]]) / w[2]
    slopes = np.zeros((2, 6))
    slopes[:, 2] = -offset / w[2]
    slopes[0, 4], slopes[1, 3] = -1 / w[2], 1 / w[2]
    return offset, slopes @ spread @ slopes.T
