"""Checks of a calibration by trials: lift an object, turn it there and back, slide it.

For any mass distribution gravity points down and friction dissipates power: the force that holds a hanging object
points up, and force times velocity plus torque times turn rate is positive in every steady stretch. In a slide all
points have the same velocity, so the force points along the motion; and friction reverses with the motion, while bias
does not.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.frames import cross_2d
from testbed.objects.model import GRAVITY
from testbed.robot.weighing import SIGNIFICANT, held_center
from testbed.sensing.windows import SteadyWindow
from testbed.validation import check_positive, frozen_array
from testbed.worlds.setup_errors import EXACT_SETUP, SetupErrors

PLANAR = [0, 1, 5]
"""Indices of the force in the table's plane and of the torque about its normal."""
SLIDING = 0.02
"""Turn rate below which a stretch is a slide [rad/s]."""
TILT_ALLOWED = np.radians(2.0)
"""Allowed error of the mount about a horizontal axis [rad]."""
TURN_ALLOWED = np.radians(3.0)
"""Allowed error of the mount about the vertical [rad]."""
_AGAINST = np.radians(150.0)
"""Angle between a slide and its force from which a wrong sign is likelier than a wrong rotation [rad]; chosen here."""
LEVER_ALLOWED = 0.003
"""Allowed error of the TCP [m]."""
BIAS_ALLOWED = 0.1
"""Allowed ratio of a turn's constant torque to the torque that reverses with the motion."""
MASS_ALLOWED = 0.03
"""Allowed relative error of the object's mass."""
LEAST_FRICTION = 0.2
"""Coefficient of friction for the deflection of a slide's force by a stated tilt of the table; chosen here."""


@dataclass(frozen=True)
class Finding:
    """Result of one check."""

    what: str
    """Subject: weight, mass, vertical, lever arm, friction, there and back, direction."""
    ok: bool
    """True if the check passed."""
    value: float
    """Measured value; its unit is in `text`."""
    text: str
    """Result in a sentence, with a remedy if the check failed."""
    decided: bool = True
    """False if it failed since the errors are larger than what is checked."""


def judged(what: str, ok: bool | np.bool_, value: float, text: str, remedy: str) -> Finding:
    """Finding whose sentence ends with the remedy if the check failed."""
    return Finding(what, bool(ok), value, text if ok else f"{text}: {remedy}")


def check_trial(
    lift: Float[np.ndarray, "6"] | None,
    lift_covariance: Float[np.ndarray, "6 6"] | None,
    windows: Sequence[SteadyWindow],
    *,
    mass: float | None = None,
    center: Float[np.ndarray, "2"] | None = None,
    setup: SetupErrors = EXACT_SETUP,
) -> list[Finding]:
    """Findings on sign, rotation and lever arm from a lift, turns and slides.

    Args:
        lift: mean wrench of the gripper on the hanging object about the TCP [N, N m], world axes; None without a lift.
        lift_covariance: covariance of that mean, shape (6, 6).
        windows: steady stretches of turns and slides, from `steady_windows`.
        mass: mass of the object [kg], if known.
        center: center of mass from the TCP while it hung [m], world axes, if known.
        setup: stated errors of the setup, which increase the allowed errors of turns and slides.

    Raises:
        InvalidValueError: wrong shapes, or a mass not above 0.
    """
    findings: list[Finding] = []
    if lift is not None and lift_covariance is not None:
        wrench = frozen_array("check_trial.lift", lift, (6,))
        covariance = frozen_array("check_trial.lift_covariance", lift_covariance, (6, 6))
        findings += _of_lift(wrench, covariance, mass)
        if center is not None and findings[0].ok:
            findings.append(_of_lever(wrench, covariance, frozen_array("check_trial.center", center, (2,))))
    findings += [_of_work(window) for window in windows]
    there = [w for w in windows if w.twist[2] >= SLIDING]
    back = [w for w in windows if w.twist[2] <= -SLIDING]
    if not setup.table_tilt:  # the weight's part along a tilted table stays too
        findings += [_of_flip(a, b) for a, b in zip(there, back, strict=False)]
    findings += [_of_slide(w, setup) for w in windows if abs(w.twist[2]) < SLIDING]
    return findings


def _of_lift(wrench: np.ndarray, covariance: np.ndarray, mass: float | None) -> list[Finding]:
    weight, error = float(wrench[2]), float(np.sqrt(covariance[2, 2]))
    text = f"the lifted object is held by {weight:.2f} +- {error:.2f} N upwards"
    if weight < -SIGNIFICANT * error:
        why = "it cannot hang upwards: sign is the wrong one, or the sensor is mounted upside down"
        return [Finding("weight", False, weight, f"{text}: {why}")]
    if weight < SIGNIFICANT * error:
        return [Finding("weight", False, weight, f"{text}: nothing was lifted")]
    findings = [Finding("weight", True, weight, text)]
    if mass is not None:
        check_positive("check_trial.mass", mass)
        off, spread = weight / GRAVITY / mass - 1, error / GRAVITY / mass
        ok = abs(off) <= MASS_ALLOWED + SIGNIFICANT * spread
        text = f"{weight / GRAVITY:.3f} kg where it has {mass:g} kg ({100 * off:+.1f} +- {100 * spread:.1f} %)"
        findings.append(judged("mass", ok, off, text, "check the gain by a known mass"))
    tilt = float(np.arctan2(np.linalg.norm(wrench[:2]), weight))
    spread = float(np.sqrt(np.linalg.eigvalsh(covariance[:2, :2])[-1]) / weight)
    ok = tilt <= TILT_ALLOWED + SIGNIFICANT * spread
    text = f"its weight leans by {np.degrees(tilt):.1f} +- {np.degrees(spread):.1f} deg"
    findings.append(judged("vertical", ok, tilt, text, "the sensor's rotation is off, or something touched the object"))
    return findings


def _of_lever(wrench: np.ndarray, covariance: np.ndarray, center: np.ndarray) -> Finding:
    held, spread = held_center(wrench, covariance)
    off = float(np.linalg.norm(held - center))
    error = float(np.sqrt(np.linalg.eigvalsh(spread)[-1]))
    ok = off <= LEVER_ALLOWED + SIGNIFICANT * error
    at = ", ".join(f"{1e3 * value:.1f}" for value in held)
    text = f"it hangs ({at}) mm from the TCP, {1e3 * off:.1f} +- {1e3 * error:.1f} mm from where it should"
    why = "the TCP's place in the sensor's frame is off, or the rotation about the tool's axis"
    return judged("lever arm", ok, off, text, why)


def _of_work(window: SteadyWindow) -> Finding:
    """Finding on the power of the gripper on the object: positive, since friction dissipates it."""
    power = float(window.wrench[PLANAR] @ window.twist)
    error = float(np.sqrt(window.twist @ _error_of_mean(window)[np.ix_(PLANAR, PLANAR)] @ window.twist))
    kind = "slide" if abs(window.twist[2]) < SLIDING else f"turn at {np.degrees(window.twist[2]):+.0f} deg/s"
    text = f"{kind}: the gripper puts {power:.4f} +- {error:.4f} W into it"
    if abs(power) <= SIGNIFICANT * error:
        return Finding("friction", False, power, f"{text}: too little to decide", decided=False)
    return judged("friction", power > 0, power, text, "friction would have to push; sign or rotation is wrong")


def _of_flip(there: SteadyWindow, back: SteadyWindow) -> Finding:
    reversing, constant = ((there.wrench[5] + side * back.wrench[5]) / 2 for side in (-1, 1))
    error = float(np.sqrt(there.covariance[5, 5] + back.covariance[5, 5]) / 2)
    ratio = float(abs(constant)) / max(float(abs(reversing)), 1e-9)
    tare_error = float(np.sqrt(_error_since_tare(back)[5, 5]))
    ok = abs(constant) <= BIAS_ALLOWED * abs(reversing) + SIGNIFICANT * math.hypot(error, tare_error)
    text = f"turned there and back, {reversing:.4f} N m flips and {constant:.4f} +- {error:.4f} N m stays"
    return judged("there and back", ok, ratio, text, "a bias that the tare left, or a cable that pulls")


def _error_since_tare(window: SteadyWindow) -> Float[np.ndarray, "6 6"]:
    """Covariance of a window's mean wrench by bias and drift, as the sensor states them."""
    return window.bias_covariance + abs(window.since_tare.mean()) * window.drift_covariance


def _error_of_mean(window: SteadyWindow) -> Float[np.ndarray, "6 6"]:
    """Covariance of a window's mean wrench by noise, bias and drift."""
    return window.covariance + _error_since_tare(window)


def _of_slide(window: SteadyWindow, setup: SetupErrors) -> Finding:
    force, velocity = window.wrench[:2], window.twist[:2]
    angle = float(np.arctan2(cross_2d(velocity, force), velocity @ force))
    spread = _error_of_mean(window)
    error = float(np.sqrt(np.linalg.eigvalsh(spread[:2, :2])[-1]) / max(np.linalg.norm(force), 1e-9))
    # friction that differs by a along two axes of the table turns its force by up to 2 a
    lean = setup.table_tilt / LEAST_FRICTION
    deviation = float(np.linalg.norm([error, setup.mounting_angle, 2 * setup.anisotropy, setup.friction_law, lean]))
    ok = abs(angle) <= TURN_ALLOWED + SIGNIFICANT * deviation
    text = f"slide: the force points {np.degrees(angle):+.1f} +- {np.degrees(error):.1f} deg off the motion"
    turn = f"{-np.degrees(angle):+.0f} deg about the vertical, {np.degrees(angle):+.0f} about a z axis that points down"
    against = "sign is the other one; else " if abs(angle) > _AGAINST else ""
    why = f"{against}turn the sensor's rotation by {turn}, or two of its axes are exchanged"
    return judged("direction", ok, angle, text, why)
