"""Weighing through the sensor: a held object's mass, where it hangs in the hand, and a known mass as a check."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY
from testbed.sensing.windows import mean_covariance
from testbed.validation import check_positive, frozen_array, is_number

GAIN_ERROR = 0.02
"""Part of a known mass by which a sensor may be off; a choice of ours, the maker states no figure."""
TOO_UNSURE = 3
"""Standard errors within which two values are the same."""


@dataclass(frozen=True, eq=False)
class Weighing:
    """A mass from the change of the sensor's reading."""

    mass: float
    """kg."""
    standard_error: float
    """kg, from the scatter of both readings and, where given, the drift between them."""
    force: Float[np.ndarray, "3"]
    """Change of force, N, sensor axes."""
    covariance: Float[np.ndarray, "3 3"]
    """Of that change."""
    tilt: float
    """Angle between that change and the vertical, rad: what the mount's rotation is off, or something touches."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "force", frozen_array("Weighing.force", self.force, (3,)))
        object.__setattr__(self, "covariance", frozen_array("Weighing.covariance", self.covariance, (3, 3)))

    @property
    def tilt_standard_error(self) -> float:
        """rad."""
        return float(np.sqrt(np.linalg.eigvalsh(self.covariance)[-1]) / max(np.linalg.norm(self.force), 1e-9))


def weigh(
    empty: Float[np.ndarray, "T 6"],
    loaded: Float[np.ndarray, "T 6"],
    up: Float[np.ndarray, "3"] | None,
    sign: int = 1,
    drift: float = 0.0,
) -> Weighing:
    """Weigh by two readings with the hand in one orientation, so that tool and bias cancel.

    Args:
        empty: samples with nothing held, as the sensor reports them, N, N m.
        loaded: samples with the object hanging free.
        up: unit vector that points up, sensor axes; None where it is not known: then the force's own direction is
            taken, and the sensor's sign stays open.
        sign: the sensor's, from its calibration.
        drift: standard deviation of what the bias moves between the two, N an axis.

    Raises:
        InvalidValueError: too few samples, or `up` no unit vector.
    """
    means, covariances = [], []
    for name, samples in (("empty", empty), ("loaded", loaded)):
        given = frozen_array(f"weigh.{name}", samples, (None, 6))[:, :3]
        if len(given) < 10:
            raise InvalidValueError(f"weigh.{name}", len(given), "10 or more samples")
        means.append(sign * given.mean(axis=0))
        covariances.append(mean_covariance(given))
    force = means[1] - means[0]
    covariance = covariances[0] + covariances[1] + drift**2 * np.eye(3)
    length = float(np.linalg.norm(force))
    direction = force / max(length, 1e-12) if up is None else frozen_array("weigh.up", up, (3,))
    if abs(np.linalg.norm(direction) - 1) > 1e-3:
        raise InvalidValueError("weigh.up", direction.tolist(), "a unit vector, sensor axes")
    along = float(force @ direction)
    return Weighing(
        mass=along / GRAVITY,
        standard_error=float(np.sqrt(direction @ covariance @ direction)) / GRAVITY,
        force=force,
        covariance=covariance,
        tilt=float(np.arctan2(np.linalg.norm(force - along * direction), abs(along))),
    )


Verdict = Literal["agrees", "disagrees", "negated", "unsure"]


@dataclass(frozen=True)
class MassCheck:
    """What a known mass says about a sensor."""

    verdict: Verdict
    """agrees; disagrees: gain or a stored tool calibration; negated: it reports the other sign; unsure: too noisy."""
    ratio: float
    """Measured over known mass."""
    standard_error: float
    """Of the ratio."""
    said: str
    """In a sentence."""


def check_known_mass(weighing: Weighing, mass: float, allowed: float = GAIN_ERROR) -> MassCheck:
    """Compare a weighing with a mass that is known.

    Args:
        weighing: the measured one.
        mass: the known one, kg.
        allowed: part of it by which the sensor may be off.
    """
    check_positive("known mass", mass)
    if not (is_number(allowed) and 0 < allowed < 1):
        raise InvalidValueError("allowed", allowed, "a number between 0 and 1")
    ratio, error = weighing.mass / mass, weighing.standard_error / mass
    measured = (
        f"{weighing.mass * GRAVITY:.2f} +- {weighing.standard_error * GRAVITY:.2f} N where {mass:g} kg weighs "
        f"{mass * GRAVITY:.2f} N"
    )
    verdict: Verdict
    if TOO_UNSURE * error > allowed:
        need = mass * TOO_UNSURE * error / allowed
        verdict, why = "unsure", f"the scatter hides {allowed:.0%}: measure longer, or take {need:.1f} kg or more"
    elif abs(ratio + 1) <= allowed + TOO_UNSURE * error:
        verdict, why = "negated", "the sensor reports what the tool does to the arm: set sign = -1"
    elif abs(ratio - 1) <= allowed + TOO_UNSURE * error:
        verdict, why = "agrees", f"within {allowed:.0%}"
    else:
        verdict = "disagrees"
        why = (
            f"off by {100 * (ratio - 1):+.1f} %: the sensor may hold a stored tool calibration, something may touch "
            "the load, or `up` is not up"
        )
    return MassCheck(verdict, ratio, error, f"{measured}: {why}")


@dataclass(frozen=True, eq=False)
class HeldCentre:
    """Where a held object's centre of mass is, seen from the TCP."""

    offset: Float[np.ndarray, "2"]
    """World x and y, m."""
    covariance: Float[np.ndarray, "2 2"]
    """m^2."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "offset", frozen_array("HeldCentre.offset", self.offset, (2,)))
        object.__setattr__(self, "covariance", frozen_array("HeldCentre.covariance", self.covariance, (2, 2)))


def held_centre(wrench: Float[np.ndarray, "6"], covariance: Float[np.ndarray, "6 6"]) -> HeldCentre:
    """The grasp offset, from the static moment of an object that hangs free.

    Args:
        wrench: what the gripper does to it, about the TCP, world axes, N and N m.
        covariance: of that wrench.

    Raises:
        InvalidValueError: nothing hangs there: the force does not point up by more than its scatter.
    """
    w = frozen_array("held_centre.wrench", wrench, (6,))
    spread = frozen_array("held_centre.covariance", covariance, (6, 6))
    if not w[2] > TOO_UNSURE * np.sqrt(spread[2, 2]):
        raise InvalidValueError("held_centre.wrench", w[:3].tolist(), "a force that points up: an object that is held")
    offset = np.array([-w[4], w[3]]) / w[2]
    slopes = np.zeros((2, 6))
    slopes[:, 2] = -offset / w[2]
    slopes[0, 4], slopes[1, 3] = -1 / w[2], 1 / w[2]
    return HeldCentre(offset, slopes @ spread @ slopes.T)
