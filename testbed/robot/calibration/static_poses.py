"""Calibration by static poses: mount of the sensor on the hand, its sign and bias, mass and center of the tool.

At rest the arm carries the weight of the tool. With u the upward unit vector in sensor axes, m and c the tool's mass
and center of mass,

    force = gain sign m g u + bias,    torque = gain sign m g (c x u) + bias,

and u is known in the hand's frame from the arm's pose. Sign is +1 for a sensor that reports the wrench of the arm on
the tool, heft's convention, and -1 for one that reports the wrench of the tool on the arm. A sensor with one axis
mirrored, in force and torque, is equivalent to one negated and turned by 180 degrees about that axis. The gain of each
axis is 1 unless an error of it is stated; then it is estimated as far as the poses determine it. The noise differs
between axes, and the bias of a sensor that warms up walks from pose to pose: both are estimated from the residuals of
a fit, and weigh the readings in the next one.

The hand is the frame whose pose the arm reports; its z axis points out of the flange. The arm's base is taken as level.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.optimize import OptimizeResult, least_squares, minimize
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.objects.model import GRAVITY
from testbed.robot.interfaces import RobotError
from testbed.sensing.windows import mean_covariance
from testbed.validation import check_positive_fields, freeze_arrays, frozen_array, is_number, unit_quaternion

Sign = Literal[1, -1]
TELLING = 25.0
"""Difference of squared misfits that determines the sign, or that the axes differ in their noise: five standard
deviations."""
HANDED = 0.2
"""Residual of the forces' directions, from 0 to 1, that determines the sign by the forces alone; chosen here."""
FARTHEST = 0.5
"""Greatest distance of a tool's center of mass from the sensor [m]; chosen here."""
WALKS = 20.0
"""Twice the gain in log likelihood from which the bias of an axis is taken to walk: noise alone reaches it in one
calibration of 100,000."""
UNKNOWNS = 13
"""Number of unknowns without gains: turn, mass, center, bias."""
ROUNDS = 3
"""Number of fits to readings that scatter more than their noise, each weighted by the residuals of the last."""
MISFIT = 3.0
"""Squared misfit that noise does not explain; 1 is expected."""


class CalibrationError(RobotError):
    """Poses or points that do not determine a calibration; the message says which to add."""


@dataclass(frozen=True, eq=False)
class StaticPose:
    """Reading of the sensor while the hand is held still."""

    hand: Float[np.ndarray, "4"]
    """Orientation of the hand in the arm's base frame, wxyz."""
    wrench: Float[np.ndarray, "6"]
    """Mean reading as reported [N, N m]."""
    standard_error: Float[np.ndarray, "6"]
    """Standard error of that mean [N, N m]."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "hand", unit_quaternion("StaticPose.hand", self.hand))
        freeze_arrays(self, wrench=(6,), standard_error=(6,))
        if not (self.standard_error > 0).all():
            raise InvalidValueError("StaticPose.standard_error", self.standard_error.tolist(), "numbers > 0")

    @property
    def up(self) -> Float[np.ndarray, "3"]:
        """Upward unit vector, hand axes, shape (3,)."""
        return Rotation.from_quat(self.hand, scalar_first=True).inv().apply([0.0, 0.0, 1.0])


def static_pose(hand: Float[np.ndarray, "4"], samples: Float[np.ndarray, "T 6"]) -> StaticPose:
    """Static pose from the sensor's samples at that pose.

    Raises:
        InvalidValueError: too few samples, or all equal, as of a dead sensor.
    """
    samples = frozen_array("static_pose.samples", samples, (None, 6))
    if len(samples) < 10:
        raise InvalidValueError("static_pose.samples", len(samples), "10 or more samples")
    return StaticPose(hand, samples.mean(axis=0), np.sqrt(np.diag(mean_covariance(samples))))


@dataclass(frozen=True, eq=False)
class Calibration:
    """Mount of the sensor and the tool below it, each with its standard deviation."""

    sign: Sign
    """Factor that converts the sensor's reading to the wrench of the arm on the tool."""
    sensor_in_hand: Float[np.ndarray, "4"]
    """Orientation of the sensor's frame in the hand, wxyz."""
    sensor_in_hand_std: Float[np.ndarray, "3"]
    """Standard deviation of a turn about each axis of the sensor [rad]."""
    bias: Float[np.ndarray, "6"]
    """Reading without load [N, N m], as reported. It drifts: every trial is tared anew."""
    bias_std: Float[np.ndarray, "6"]
    """Standard deviation of the bias [N, N m]."""
    mass: float
    """Mass of the tool [kg]: everything below the sensor's gauges."""
    mass_std: float
    """Standard deviation of the mass [kg]."""
    com: Float[np.ndarray, "3"]
    """Center of mass of the tool [m], sensor frame."""
    com_std: Float[np.ndarray, "3"]
    """Standard deviation of the center of mass [m]."""
    misfit: float
    """Mean squared distance between readings and model, in standard errors; about 1 is expected."""
    poses: int
    """Number of poses."""
    gain: Float[np.ndarray, "6"] = field(default_factory=lambda: np.ones(6))
    """Reading over true value, of each axis."""
    gain_std: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    """Standard deviation of each gain; as stated where the poses do not determine it."""
    bias_walk: Float[np.ndarray, "6"] = field(default_factory=lambda: np.zeros(6))
    """Standard deviation of the bias's change from pose to pose [N, N m], 0 for a constant bias; else `bias` is that of
    the first pose."""
    gravity: float = GRAVITY
    """Acceleration of free fall at the calibration [m/s^2]."""

    def __post_init__(self) -> None:
        if self.sign not in (1, -1):
            raise InvalidValueError("Calibration.sign", self.sign, "1 or -1")
        check_positive_fields(self, "mass", "mass_std", "gravity")
        object.__setattr__(self, "sensor_in_hand", unit_quaternion("Calibration.sensor_in_hand", self.sensor_in_hand))
        freeze_arrays(self, sensor_in_hand_std=(3,), bias=(6,), bias_std=(6,), com=(3,), com_std=(3,))
        freeze_arrays(self, gain=(6,), gain_std=(6,), bias_walk=(6,))


def calibrate(poses: Sequence[StaticPose], gain_error: float = 0.0, gravity: float = GRAVITY) -> Calibration:
    """Estimate mount, bias, tool and gains by weighted least squares on the readings.

    Standard deviations follow from those of the readings, or from their scatter if that is larger; a bias that walks
    from pose to pose is modeled as a random walk.

    Args:
        poses: readings at rest, in order of time.
        gain_error: prior standard deviation of each axis' gain; 0 fixes the gains at 1.
        gravity: acceleration of free fall [m/s^2].

    Raises:
        CalibrationError: too few poses, or poses too similar to determine rotation, sign or tool.
    """
    if len(poses) < 4:
        raise CalibrationError(f"calibration: got {len(poses)} poses; allowed: 4 or more, each tilted another way")
    if not (is_number(gain_error) and 0 <= gain_error < 1):
        raise InvalidValueError("gain_error", gain_error, "a number from 0 to below 1")
    noise = np.array([pose.standard_error for pose in poses])
    errors = _Errors(noise, np.zeros(6), np.array([np.diag(each) for each in noise.T]))
    fits = {sign: _fit(poses, sign, gain_error, errors, gravity) for sign in (1, -1)}
    if (least := min(fit.force_left for fit in fits.values())) > HANDED and (other := _better_convention(poses, least)):
        raise CalibrationError(f"calibration: the force does not turn with the hand, but does {other}")
    sign, other = sorted(fits, key=lambda s: fits[s].cost)
    best = fits[sign]
    freedom = 6 * len(poses) - UNKNOWNS
    misfit = 2 * best.cost / freedom
    lengths = np.linalg.norm(best.jac, axis=0)
    if not (lengths > 0).all() or np.linalg.matrix_rank(best.jac / lengths, tol=1e-4) < len(best.x):
        raise CalibrationError(
            "calibration: the poses are too alike to determine how the sensor is mounted; "
            "tilt the hand by 30 deg or more, about two axes and both ways"
        )
    if 2 * (fits[other].cost - best.cost) < TELLING * max(misfit, 1.0):
        of_force = sorted(fit.force_left for fit in fits.values())
        if of_force[0] < HANDED * of_force[1] and of_force[1] > HANDED:
            raise CalibrationError(
                "calibration: the force turns with the hand under one sign, and the torque under the other; allowed: "
                "axes of one handedness; an axis of the force or of the torque is negated, or its frame is left-handed"
            )
        raise CalibrationError(
            "calibration: the poses do not determine the sensor's sign; add some with the hand level and upside down, "
            "so that gravity is measured along all three of its axes"
        )
    for _ in range(ROUNDS):
        scattered = _Errors.scattered(noise, errors.raw(best.fun[: 6 * len(poses)]))
        if scattered is None:
            break
        errors = scattered
        best = _fit(poses, sign, gain_error, errors, gravity)
    # scatter scales the errors of the readings, not the prior of the gains
    of_readings, of_prior = best.jac[: 6 * len(poses)], best.jac[6 * len(poses) :]
    covariance = np.linalg.inv(of_readings.T @ of_readings / max(2 * best.cost / freedom, 1.0) + of_prior.T @ of_prior)
    mass, com = best.x[3], best.x[4:7] / best.x[3]
    to_com = np.hstack([-com[:, None] / mass, np.eye(3) / mass])
    com_std = np.sqrt(np.diag(to_com @ covariance[3:7, 3:7] @ to_com.T))
    if (distance := float(np.linalg.norm(com))) > FARTHEST:
        units = {
            10: "force kgf (force_unit), or that of the torque N cm (torque_unit)",
            1e3: "torque N mm (torque_unit)",
            np.inf: "torque another (torque_unit)",
        }
        unit = next(unit for factor, unit in units.items() if distance < factor * FARTHEST)
        raise CalibrationError(
            f"calibration: the tool's center of mass comes out {distance:.3g} m from the sensor; allowed: "
            f"{FARTHEST:g} m; is the unit of the {unit}?"
        )
    std = np.sqrt(np.diag(covariance))
    rotation = best.start * Rotation.from_rotvec(best.x[:3])
    outward = rotation.as_matrix()[2]  # z axis of the hand, sensor axes
    if outward @ com < -3 * np.linalg.norm(outward * com_std):
        raise CalibrationError(
            f"calibration: the tool's center of mass comes out {-outward @ com * 1e3:.0f} mm behind the sensor; "
            "the signs of its force and its torque do not belong together, or the arm reports another frame's pose"
        )
    return Calibration(
        sign=1 if sign == 1 else -1,
        sensor_in_hand=rotation.as_quat(scalar_first=True),
        sensor_in_hand_std=std[:3],
        bias=best.x[7:13],
        bias_std=std[7:13],
        mass=float(mass),
        mass_std=float(std[3]),
        com=com,
        com_std=com_std,
        misfit=float(misfit),
        poses=len(poses),
        bias_walk=errors.walk,
        gravity=gravity,
        **({"gain": best.x[13:], "gain_std": std[13:]} if gain_error else {}),
    )


def residuals(calibration: Calibration, poses: Sequence[StaticPose]) -> Float[np.ndarray, "N 6"]:
    """Readings less the model's [N, N m]."""
    mount = Rotation.from_quat(calibration.sensor_in_hand, scalar_first=True)
    held = mount.inv().apply(np.array([pose.up for pose in poses]))
    load = calibration.mass * calibration.gravity * np.hstack([held, np.cross(calibration.com, held)])
    return np.array([pose.wrench for pose in poses]) - calibration.sign * calibration.gain * load - calibration.bias


@dataclass(frozen=True, eq=False)
class _Errors:
    """Covariance of the readings of N poses: their noise, and the random walk of the bias."""

    noise: Float[np.ndarray, "N 6"]
    """Standard errors [N, N m]."""
    walk: Float[np.ndarray, "6"]
    """Standard deviation of the bias's change from pose to pose."""
    roots: Float[np.ndarray, "6 N N"]
    """Cholesky root of each axis' covariance."""

    @cached_property
    def inverses(self) -> Float[np.ndarray, "6 N N"]:
        """Inverse of each root."""
        return np.linalg.inv(self.roots)

    @staticmethod
    def scattered(noise: Float[np.ndarray, "N 6"], left: Float[np.ndarray, "N 6"]) -> _Errors | None:
        """Maximum-likelihood errors by the residuals of a fit: for each axis a factor of the noise, and a walk.

        None if no bias walks and one factor explains the scatter of all axes.
        """
        order = np.arange(len(noise))
        together = np.minimum(order[:, None], order).astype(float)
        found = [_likeliest(np.diag(own**2), together, of_axis) for own, of_axis in zip(noise.T, left.T, strict=True)]
        walk = np.array([walk for walk, _ in found])
        scatter = np.maximum(((left / noise) ** 2).mean(axis=0), 1.0)
        unlike = len(noise) * np.log(scatter.mean() / scatter).sum()
        if not walk.any() and unlike < TELLING:
            return None
        return _Errors(noise, walk, np.array([root for _, root in found]))

    def whitened(self, left: Float[np.ndarray, "N 6"]) -> Float[np.ndarray, "N 6"]:
        """Residuals divided by their errors."""
        return np.einsum("aij,ja->ia", self.inverses, left)

    def raw(self, whitened: Float[np.ndarray, "n"]) -> Float[np.ndarray, "N 6"]:
        """Residuals [N, N m] from flattened whitened ones: the inverse of `whitened`."""
        return np.einsum("aij,ja->ia", self.roots, whitened.reshape(len(self.noise), 6))


def _likeliest(
    noise: Float[np.ndarray, "N N"], together: Float[np.ndarray, "N N"], left: Float[np.ndarray, "N"]
) -> tuple[float, Float[np.ndarray, "N N"]]:
    """Walk of an axis from pose to pose, 0 unless the fit is significantly better, and the covariance's root (N, N)."""
    constant = np.ones((len(left), 1))

    def cost(covariance: np.ndarray) -> float:
        """Twice the negative log likelihood of the residuals, with the bias marginalized."""
        inverse = np.linalg.inv(covariance)
        of_bias = constant.T @ inverse @ constant
        about = left - constant[:, 0] * float((constant.T @ inverse @ left / of_bias).item())
        return float(about @ inverse @ about + np.linalg.slogdet(covariance)[1] + np.log(of_bias.item()))

    scatter, mean = float(np.var(left)), float(np.diag(noise).mean())
    alone = noise * max(scatter / mean, 1.0)

    def covariance(logarithms: np.ndarray) -> np.ndarray:
        factor, walk = np.exp(logarithms)
        return noise * factor + together * walk

    # half of the scatter from noise, half from a walk
    start = np.log([max(scatter / mean / 2, 1.0), max(3 * scatter / len(left), 1e-3 * mean)])
    # far beyond any likely value, but finite: without bounds the line search overflows
    most = 100 * max(scatter, mean)
    bounds = [(0.0, np.log(most / mean)), (np.log(1e-6 * mean), np.log(most))]
    best = minimize(lambda x: cost(covariance(x)), start, method="L-BFGS-B", bounds=bounds)
    if cost(alone) - float(best.fun) < WALKS:
        return 0.0, np.linalg.cholesky(alone)
    return float(np.exp(best.x[1] / 2)), np.linalg.cholesky(covariance(best.x))


def _better_convention(poses: Sequence[StaticPose], least: float) -> str:
    """Convention of the hand's orientations under which the force turns with the hand, in words; empty without any.

    `least` is the residual of the forces' directions under the assumed convention.
    """
    hands, force = (np.array([getattr(pose, name) for pose in poses]) for name in ("hand", "wrench"))
    inverse = Rotation.from_quat(hands, scalar_first=True).inv().as_quat(scalar_first=True)
    order, turned = "with quaternions in another order: xyzw or wxyz?", "with their inverse: of the base in the hand?"
    for words, each in ((order, np.roll(hands, 1, 1)), (order, np.roll(hands, -1, 1)), (turned, inverse)):
        up = Rotation.from_quat(each, scalar_first=True).inv().apply([0.0, 0.0, 1.0])
        if min(_aligned(up, sign * force[:, :3])[1] for sign in (1, -1)) < min(HANDED, least / 4):
            return words
    return ""


def _aligned(up: Float[np.ndarray, "N 3"], force: Float[np.ndarray, "N 3"]) -> tuple[Rotation, float]:
    """Kabsch's rotation from the forces to the upward vectors, both about their means, and its residual, 0 to 1.

    The mean includes the bias, so the differences are free of it.
    """
    changes = (vectors - vectors.mean(axis=0) for vectors in (up, force))
    scaled = (each / max(float(np.linalg.norm(each)), 1e-12) for each in changes)
    rotation, residual, *_ = Rotation.align_vectors(*scaled)
    return rotation, float(residual)


def _fit(poses: Sequence[StaticPose], sign: int, gain_error: float, errors: _Errors, gravity: float) -> OptimizeResult:
    """Least-squares fit for one sign.

    The solution `x` has a rotation vector from `start` [rad], sensor axes, mass, mass times center, bias and gains.
    """
    up, wrench = (np.array([getattr(p, name) for p in poses]) for name in ("up", "wrench"))
    force, middle = sign * wrench[:, :3], up - up.mean(axis=0)
    start, force_left = _aligned(up, force)  # all the rest is linear
    mass = max(float(np.sum(start.apply(force) * middle) / max(np.sum(middle**2), 1e-12) / gravity), 1e-3)

    def weighted(x: np.ndarray) -> np.ndarray:
        held = (start * Rotation.from_rotvec(x[:3])).inv().apply(up)
        load = gravity * np.hstack([x[3] * held, np.cross(x[4:7], held)])
        gain = x[13:] if gain_error else np.ones(6)
        residual = errors.whitened(sign * gain * load + x[7:13] - wrench).ravel()
        return np.append(residual, (gain - 1) / gain_error) if gain_error else residual

    guess = np.concatenate([np.zeros(3), [mass], np.zeros(3), wrench.mean(axis=0)])
    scale = np.concatenate([np.ones(3), [1.0], np.full(3, 0.1), np.ones(3), np.full(3, 0.1)])
    if gain_error:
        guess, scale = np.append(guess, np.ones(6)), np.append(scale, np.full(6, gain_error))
    lowest = np.full(len(guess), -np.inf)
    lowest[3] = 1e-6  # a negative mass would duplicate the other sign
    tolerances = {"xtol": 1e-10, "ftol": 1e-10, "gtol": 1e-10, "max_nfev": 100}
    fit = least_squares(weighted, guess, bounds=(lowest, np.inf), x_scale=scale, **tolerances)
    fit.start, fit.force_left = start, force_left
    return fit


def sentences(calibration: Calibration) -> list[str]:
    """Results of a calibration, a sentence each: sign, rotation, tool, gains, and warnings."""
    c = calibration
    turn, mirrored = _turn_in_words(Rotation.from_quat(c.sensor_in_hand, scalar_first=True))
    lines = []
    if c.sign < 0:
        also = f" (the same thing: its {mirrored} axis is mirrored)" if mirrored else ""
        lines.append(f"the sensor reports what the tool does to the arm: set sign = -1{also}")
    lines.append(f"the sensor is {turn} +- {np.degrees(c.sensor_in_hand_std.max()):.2g} deg")
    com = ", ".join(f"{1e3 * x:.1f} +- {1e3 * s:.2g}" for x, s in zip(c.com, c.com_std, strict=True))
    lines.append(f"the tool weighs {c.mass:.4f} +- {c.mass_std:.2g} kg; its center is at {com} mm")
    if c.gain_std.any():
        each = ", ".join(f"{g:.4f} +- {s:.2g}" for g, s in zip(c.gain, c.gain_std, strict=True))
        lines.append(f"gains of the six axes, as far as the poses determine them: {each}")
    if c.bias_walk.any():
        force, torque = c.bias_walk[:3].max(), c.bias_walk[3:].max()
        lines.append(
            f"the bias walks by up to {force:.2g} N and {torque:.2g} N m from pose to pose, as of a sensor that warms "
            "up: the standard deviations allow for it; let the sensor warm up for a smaller error"
        )
    elif c.misfit > MISFIT:
        lines.append(
            f"the readings scatter {np.sqrt(c.misfit):.1f} times as much as their noise: a cable that pulls, "
            "a sensor not yet warm, or poses not at rest; the standard deviations allow for it"
        )
    return lines


def _turn_in_words(rotation: Rotation) -> tuple[str, str]:
    """A rotation in words, and the frame's axis about which it is half a turn, else empty."""
    vector = rotation.as_rotvec(degrees=True)
    angle = float(np.linalg.norm(vector))
    if angle < 1.0:
        return f"not turned ({angle:.2g} deg)", ""
    axis = vector / angle
    nearest = int(np.argmax(np.abs(axis)))
    if np.degrees(np.arccos(min(abs(axis[nearest]), 1.0))) > 2.0:
        return f"turned by {angle:.1f} deg about ({axis[0]:.2f}, {axis[1]:.2f}, {axis[2]:.2f})", ""
    name, signed = "xyz"[nearest], angle * np.sign(axis[nearest])
    half = abs(angle - 180) < 2.0
    return f"turned by {180 if half else signed:.{0 if half else 1}f} deg about {name}", name if half else ""
