"""Safety limits of the real robot, checked on the planned path and at every tick."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.frames import rotation_matrix
from testbed.robot.interfaces import ArmLimits, ArmState, RobotError, SensorIdentity
from testbed.validation import Range, check_settings

FROZEN = 4
"""Largest number of equal frames in a row; the noise is several counts."""
LAGS = 50
"""Number of frames kept for comparison."""
PERIODS = 10
"""Longest period of a single component that is detected [frames]."""
PAIRS = 3
"""Largest number of frames in which a component has only two values, over the largest number of equal ones in a row."""
SHORT = 15
"""Number of frames whose changes are compared with the noise of all components together; for a single one, `LAGS`."""
QUIET = 1 / 3
"""Least ratio of the rms change from frame to frame to the noise at rest; white noise has 1.4."""
_COMPONENTS = ("fx", "fy", "fz", "tx", "ty", "tz")
_OVERSHOOT = 1.25
"""Allowed ratio of measured to commanded speed."""


Place = Annotated[float, Range(-1.2, 1.2, "m")]
"""Coordinate within reach of the arm: the Gen3 reaches 0.9 m."""


@dataclass(frozen=True)
class SafetyLimits:
    """Limits on the tool, base frame of the arm."""

    low: tuple[Place, Place, Place] = (0.25, -0.35, 0.015)
    """Corner of the box for the TCP [m]."""
    high: tuple[Place, Place, Place] = (0.65, 0.35, 0.40)
    """The opposite corner [m]."""
    linear_speed: Annotated[float, Range(0.002, 0.5, "m/s")] = 0.15
    """Speed of the TCP [m/s]."""
    angular_speed: Annotated[float, Range(math.radians(0.1), math.radians(100), "rad/s")] = 1.2
    """Turn rate of the tool [rad/s]."""
    tilt: Annotated[float, Range(math.radians(5), math.radians(35), "rad")] = math.radians(5)
    """Angle of the approach axis from straight down [rad]; a lift that tilts the object needs more."""
    force: Annotated[float, Range(1, 300, "N")] = 60.0
    """Change of the sensor's force since the tare, or since the first frame before it [N]."""
    torque: Annotated[float, Range(0.1, 30, "N m")] = 8.0
    """Change of the sensor's torque since then [N m]."""
    joint_margin: Annotated[float, Range(0, math.radians(45), "rad")] = math.radians(3)
    """Least distance from the ends of a joint's range [rad]."""
    age: Annotated[float, Range(0.02, 0.2, "s")] = 0.08
    """Greatest age of the newest feedback and of the newest wrench [s]."""

    def __post_init__(self) -> None:
        check_settings(SafetyLimits, vars(self), "SafetyLimits")
        for name in ("low", "high"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))
        if not all(a < b for a, b in zip(self.low, self.high, strict=True)):
            raise InvalidValueError("SafetyLimits.high", self.high, f"a corner beyond the low one {self.low}, m")


@dataclass(frozen=True)
class Violation:
    """A limit that was exceeded."""

    limit: str
    """Name of the limit."""
    value: float
    """Value found."""
    allowed: float
    """Value allowed."""
    unit: str
    """Unit of both."""
    broken: bool = False
    """True for a failed device, False for a motion beyond its limit."""

    def __str__(self) -> str:
        side = "at least" if self.value < self.allowed else "at most"
        unit = f" {self.unit}" if self.unit else ""
        return f"{self.limit}: {self.value:.3g}{unit}; allowed: {side} {self.allowed:.3g}{unit}"


class UnsafeError(RobotError):
    """A limit was exceeded; the arm has been stopped."""

    def __init__(self, violation: Violation):
        self.violation = violation
        super().__init__(str(violation))


@dataclass(frozen=True, eq=False)
class Snapshot:
    """State, load and command at one tick."""

    now: float
    """Time [s]."""
    state: ArmState
    """Newest feedback."""
    wrench_time: float
    """Arrival of the newest wrench [s]."""
    load: Float[np.ndarray, "6"]
    """Newest wrench less the tare [N, N m], sensor axes."""
    command: Float[np.ndarray, "6"]
    """Commanded twist [m/s, rad/s], base axes."""


def violations(limits: SafetyLimits, arm: ArmLimits, at: Snapshot) -> Iterator[Violation]:
    """Every violation at a tick, the worst kind first."""
    state = at.state
    if state.faulted:
        yield Violation(f"arm in a fault ({state.message or 'unnamed'})", 1.0, 0.0, "faults", broken=True)
    for name, time_s in (("feedback of the arm", state.time_s), ("wrench", at.wrench_time)):
        if not at.now - time_s <= limits.age:
            yield Violation(f"age of the {name}", at.now - time_s, limits.age, "s", broken=True)
    yield from load_violations(limits, at.load)
    yield from _speed_violations("commanded", limits, at.command, 1.0 + 1e-9)
    yield from _speed_violations("measured", limits, state.tcp_twist, _OVERSHOOT)
    yield from _outside(limits, state.tcp_pose.position)
    down = -rotation_matrix(state.tcp_pose.orientation)[2, 2]
    if not (tilt := math.acos(min(max(down, -1.0), 1.0))) <= limits.tilt:
        yield Violation("tilt of the tool", tilt, limits.tilt, "rad")
    yield from _joints(limits, arm, state)


def load_violations(limits: SafetyLimits, load: Float[np.ndarray, "6"]) -> Iterator[Violation]:
    """Every violation by a change of the wrench [N, N m]."""
    return _norm_violations(load, ("force", limits.force, "N"), ("torque", limits.torque, "N m"))


class FrameWatch:
    """Checks on every frame of a sensor: NaN, values beyond its range, and values without noise.

    A dead sensor repeats values: one value in a row or with a period, earlier whole frames, only two values, or changes
    from frame to frame far below its noise. With the noise and counts of an FT-300S (correlation of 0.3 between
    neighbors) the probability of a false alarm per frame at rest is 1.5e-8, one in 180 hours, by equal values in a row,
    half of it by tz; 6e-10 by periods; below 1e-14 by only two values. The limit on small changes is 11 standard
    deviations away. A changing load lowers these probabilities.
    """

    def __init__(self, sensor: SensorIdentity):
        self._sensor = sensor
        self._before = np.full((LAGS, 6), np.nan)  # newest first
        self._runs = np.zeros((LAGS, 6), dtype=int)  # values in a row that equal those of each lag before
        self._pair, self._pairs = np.full((2, 6), np.nan), np.zeros(6, dtype=int)
        self._changes = np.full((LAGS, 6), np.nan)  # squared changes from frame to frame
        self._taken = -1  # number of changes from frame to frame: none with the first frame
        self._variance = None if sensor.noise is None else np.square(sensor.noise)

    def violations(self, wrench: Float[np.ndarray, "6"]) -> Iterator[Violation]:
        """Every violation by the next frame, raw [N, N m]."""
        if missing := float((~np.isfinite(wrench)).sum()):
            yield Violation("values of the wrench that are no number", missing, 0.0, "", True)
        for name, part, allowed, unit in (
            ("raw force", wrench[:3], self._sensor.force_range, "N"),
            ("raw torque", wrench[3:], self._sensor.torque_range, "N m"),
        ):
            if (most := float(np.abs(part).max())) > allowed:
                yield Violation(name, most, allowed, unit)
        self._take(wrench)
        yield from self._repeated()
        yield from self._quiet()

    def _take(self, wrench: np.ndarray) -> None:
        last = self._before[0]
        row = self._runs[0] + 1  # of the value before
        self._runs = np.where(self._before == wrench, self._runs + 1, 0)
        third = (wrench != self._pair).all(axis=0)
        self._pairs = np.where(third, row + 1, self._pairs + 1)
        self._pair = np.where(third, np.stack([last, wrench]), self._pair)
        for kept, new in ((self._changes, np.square(wrench - last)), (self._before, wrench)):
            kept[1:] = kept[:-1].copy()
            kept[0] = new
        self._taken += 1

    def _repeated(self) -> Iterator[Violation]:
        """Violations by repeated values."""
        rows, repeats = self._runs[0] + 1, np.array(self._sensor.repeats)
        if rows.min() > FROZEN:
            yield Violation("equal frames in a row", float(rows.min()), FROZEN, "", broken=True)
        elif (again := self._runs.min(axis=1)).max() > FROZEN:
            lag = int(again.argmax()) + 1
            yield Violation(f"frames in a row that are those of {lag} before", float(again.max()), FROZEN, "", True)
        for axis, name in enumerate(_COMPONENTS):
            most = int(repeats[axis])
            if rows[axis] > most:
                yield Violation(f"equal values of {name} in a row", int(rows[axis]), most, "", broken=True)
            period = int(self._runs[:PERIODS, axis].argmax()) + 1
            if period > 1 and (run := int(self._runs[period - 1, axis])) > most + 1:
                yield Violation(f"values of {name} in a row with a period of {period} frames", run, most + 1, "", True)
            if (pairs := int(self._pairs[axis])) > PAIRS * most:
                yield Violation(f"frames in which {name} has two values alone", pairs, PAIRS * most, "", True)

    def _quiet(self) -> Iterator[Violation]:
        """Violations by changes below the noise at rest."""
        if self._taken >= LAGS and self._variance is None:  # no stated noise: that of the first frames
            self._variance = self._changes.mean(axis=0)
        if self._taken < SHORT or self._variance is None:
            return
        if (whole := float(self._over_noise(SHORT, self._variance).mean())) < QUIET**2:
            yield Violation("changes from frame to frame over the noise", whole**0.5, QUIET, "", broken=True)
        if self._taken < LAGS:
            return
        for name, part in zip(_COMPONENTS, self._over_noise(LAGS, self._variance).tolist(), strict=True):
            if part < QUIET**2:
                yield Violation(f"changes of {name} from frame to frame over its noise", part**0.5, QUIET, "", True)

    def _over_noise(self, frames: int, variance: np.ndarray) -> np.ndarray:
        """Mean squared change over the variance of the noise, shape (6,); infinite for a noise of 0."""
        changes = self._changes[:frames].mean(axis=0)
        return np.divide(changes, variance, out=np.full(6, np.inf), where=variance > 0)


def path_violations(
    limits: SafetyLimits,
    positions: Float[np.ndarray, "N 3"],
    twists: Float[np.ndarray, "N 6"],
    tilts: Float[np.ndarray, "N"],
) -> Iterator[Violation]:
    """Every violation by a planned path of the TCP.

    Args:
        limits: limits on the tool.
        positions: positions [m], base frame.
        twists: linear and angular velocities [m/s, rad/s], base axes.
        tilts: angles of the approach axis from straight down [rad].
    """
    if not (most := float(tilts.max())) <= limits.tilt:
        yield Violation("tilt of the tool", most, limits.tilt, "rad")
    yield from _outside(limits, positions.min(axis=0))
    yield from _outside(limits, positions.max(axis=0))
    fastest = [part[np.linalg.norm(part, axis=1).argmax()] for part in (twists[:, :3], twists[:, 3:])]
    yield from _speed_violations("planned", limits, np.concatenate(fastest), 1.0 + 1e-9)


def _speed_violations(kind: str, limits: SafetyLimits, twist: np.ndarray, factor: float) -> Iterator[Violation]:
    linear, angular = limits.linear_speed, limits.angular_speed
    return _norm_violations(twist, (f"{kind} speed", linear, "m/s"), (f"{kind} turn rate", angular, "rad/s"), factor)


def _norm_violations(
    vector: np.ndarray, linear: tuple[str, float, str], angular: tuple[str, float, str], factor: float = 1.0
) -> Iterator[Violation]:
    """Violations by the linear and angular half of a vector (6,); each limit has name, largest norm and unit."""
    for part, (name, allowed, unit) in ((vector[:3], linear), (vector[3:], angular)):
        if not (length := float(np.linalg.norm(part))) <= allowed * factor:
            yield Violation(name, length, allowed, unit)


def _outside(limits: SafetyLimits, position: np.ndarray) -> Iterator[Violation]:
    for axis, value, low, high in zip("xyz", position.tolist(), limits.low, limits.high, strict=True):
        if not low <= value <= high:
            yield Violation(f"{axis} of the tool", value, low if value < low else high, "m")


def _joints(limits: SafetyLimits, arm: ArmLimits, state: ArmState) -> Iterator[Violation]:
    low, high = arm.joint_range.T
    for joint in range(7):
        q, speed = float(state.joint_position[joint]), float(abs(state.joint_velocity[joint]))
        bounds = low[joint] + limits.joint_margin, high[joint] - limits.joint_margin
        if not bounds[0] <= q <= bounds[1]:
            yield Violation(f"joint {joint + 1}", q, float(bounds[0] if q < bounds[0] else bounds[1]), "rad")
        if not speed <= arm.joint_speed[joint]:
            yield Violation(f"speed of joint {joint + 1}", speed, float(arm.joint_speed[joint]), "rad/s")
