"""From what the sensor says to what the gripper does to the object: sensor model, tare, tool compensation.

Simulation and hardware share `compensate`. A simulated trial stores the clean sensor record, and `draw_sensing` puts a
preset's noise on it afterwards, so that a hundred noise seeds cost no simulation.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import lfilter, savgol_filter

from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, perpendicular, rotate_wrench, rotation_matrix
from testbed.objects.model import GRAVITY
from testbed.trajectory import Phase, Tool, Trajectory
from testbed.validation import frozen_array

Axes = tuple[float, float, float]
"""A number for each axis: x, y, z."""


@dataclass(frozen=True)
class Sensing:
    """How a sensor errs. Standard deviations, SI units."""

    name: str
    """Preset name."""
    force_noise: Axes = (0.0, 0.0, 0.0)
    """Per sample, N, sensor axes."""
    torque_noise: Axes = (0.0, 0.0, 0.0)
    """Per sample, N m."""
    lag1: float = 0.0
    """Correlation between neighbouring samples."""
    force_bias: float = 0.0
    """Left after the tare, one draw a trial, N."""
    torque_bias: float = 0.0
    """Left after the tare, one draw a trial, N m."""
    force_drift: float = 0.0
    """Random walk, N per square root of a second."""
    torque_drift: float = 0.0
    """Random walk, N m per square root of a second."""
    linear_acceleration_noise: float = 0.0
    """Of the hand's motion, m/s^2 per sample."""
    angular_acceleration_noise: float = 0.0
    """Of the hand's motion, rad/s^2 per sample."""
    scale: float = 0.0
    """Of the scale's reading, kg."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name == "name":
                continue
            shape = (3,) if name in ("force_noise", "torque_noise") else ()
            if (frozen_array(f"Sensing.{name}", value, shape) < 0).any():
                raise InvalidValueError(f"Sensing.{name}", value, "numbers >= 0")
        if not self.lag1 < 1:
            raise InvalidValueError("Sensing.lag1", self.lag1, "a number from 0 to below 1")

    @property
    def bias_std(self) -> np.ndarray:
        """Constant error that the tare may leave, N and N m, (6,)."""
        return np.repeat([self.force_bias, self.torque_bias], 3)

    @property
    def drift_std(self) -> np.ndarray:
        """Random walk of the zero, N and N m per square root of a second, (6,)."""
        return np.repeat([self.force_drift, self.torque_drift], 3)


def _grid(name: str, force: float, torque: float, angular: float, linear: float) -> Sensing:
    return Sensing(
        name,
        (force, force, force),
        (torque, torque, torque),
        linear_acceleration_noise=linear,
        angular_acceleration_noise=angular,
        scale=0.001,
    )


PRESETS: dict[str, Sensing] = {
    preset.name: preset
    for preset in (
        Sensing("ideal"),
        # One lab's measurement of an FT-300S; bias left after tare and the walk are ours, well below its cold drift
        Sensing(
            "ft300s",
            (0.067, 0.083, 0.065),
            (0.0034, 0.0030, 0.0010),
            lag1=0.3,
            force_bias=0.05,
            torque_bias=0.003,
            force_drift=0.005,
            torque_drift=0.0003,
            scale=0.001,
        ),
        # The simulation study in arXiv:2203.00830, Table II
        _grid("low", 0.05, 0.0025, 0.25, 0.025),
        _grid("moderate", 0.1, 0.005, 0.5, 0.05),
        _grid("high", 0.33, 0.0067, 1.0, 0.1),
    )
}
"""By name: `ideal`, `ft300s`, `low`, `moderate`, `high`."""


def preset(name: str) -> Sensing:
    """A sensing preset by name.

    Raises:
        InvalidValueError: no such preset.
    """
    if name not in PRESETS:
        raise InvalidValueError("sensing", name, f"one of {', '.join(PRESETS)}")
    return PRESETS[name]


def draw_sensing(clean: Trajectory, sensing: Sensing, seed: int) -> Trajectory:
    """A clean record as this sensor would have given it, tared and compensated.

    Args:
        clean: a simulated trial with a perfect sensor.
        sensing: how the sensor errs.
        seed: of the draw; the same seed gives the same errors to every trial of equal length; mix in the trial's own.
    """
    rng = np.random.default_rng(seed)
    if clean.tool is None:
        wrench = np.array(clean.wrench_on_object_world)
        wrench[:, 2] += GRAVITY * sensing.scale * rng.standard_normal()
        return replace(clean, wrench_on_object_world=wrench, provenance=clean.provenance | _said(sensing, seed))
    count, dt = len(clean.time_s), float(np.median(np.diff(clean.time_s)))
    noise_std = np.array([*sensing.force_noise, *sensing.torque_noise])
    white = rng.standard_normal((count, 6))
    white[1:] *= np.sqrt(1 - sensing.lag1**2)
    coloured = lfilter([1.0], [1.0, -sensing.lag1], white, axis=0)
    bias = sensing.bias_std * rng.standard_normal(6)
    walk = np.cumsum(sensing.drift_std * np.sqrt(dt) * rng.standard_normal((count, 6)), axis=0)
    tared = np.maximum.accumulate(clean.phase > Phase.TARE)
    raw = clean.sensor_wrench + noise_std * coloured + walk + np.outer(tared, bias)
    accelerations = np.repeat([sensing.linear_acceleration_noise, sensing.angular_acceleration_noise], 3)
    jitter = accelerations * dt / np.sqrt(2) * rng.standard_normal((count, 6))
    velocity = clean.tcp_velocity + jitter
    planar = clean.object_velocity + jitter[:, [0, 1, 5]]
    planar[:, :2] += jitter[:, 5:] * perpendicular(clean.object_pose[:, :2] - clean.tcp_position[:, :2])
    noisy = replace(
        clean,
        sensor_wrench=raw,
        tcp_velocity=velocity,
        object_velocity=planar,
        sensor_bias_std=sensing.bias_std,
        sensor_drift_std=sensing.drift_std,
        provenance=clean.provenance | _said(sensing, seed),
    )
    return compensate(noisy)


def compensate(trajectory: Trajectory) -> Trajectory:
    """Fill `wrench_on_object_world` from the raw sensor record: the one path that every bench shares.

    Tare: the mean of the raw record while hovering, less what the tool weighs there, is the sensor's bias; where a
    trial ends with another tare, that one only shows the drift. Tool: gravity and inertia of all that hangs below the
    sensor, from the hand's own motion. What remains is moved to the TCP, world axes.

    Raises:
        InvalidValueError: no tare samples, or no tool.
    """
    tool, tares = trajectory.tool, _tares(trajectory)
    if tool is None or not tares:
        raise InvalidValueError(
            "Trajectory", "no tool" if tool is None else "no samples in phase TARE", "a record with a tool and a tare"
        )
    axes = rotation_matrix(trajectory.sensor_orientation)
    load = _tool_wrench(tool, trajectory, axes)
    bias = (trajectory.sensor_wrench - load)[tares[0]].mean(axis=0)
    at_sensor = trajectory.sensor_wrench - bias - load
    world = rotate_wrench(axes, move_wrench(at_sensor, tool.tcp))
    return replace(trajectory, wrench_on_object_world=world)


def tare_biases(trajectory: Trajectory) -> list[Float[np.ndarray, "6"]]:
    """The sensor's bias at every tare of a record, in order, N and N m; empty where there is no tare or no tool."""
    tool, tares = trajectory.tool, _tares(trajectory)
    if tool is None or not tares:
        return []
    load = _tool_wrench(tool, trajectory, rotation_matrix(trajectory.sensor_orientation))
    return [(trajectory.sensor_wrench - load)[tare].mean(axis=0) for tare in tares]


def tare_samples(trajectory: Trajectory) -> Int[np.ndarray, "N"]:
    """Indices of the samples from which the wrench is counted; empty where there is no tare."""
    return next(iter(_tares(trajectory)), np.empty(0, dtype=np.int64))


def _tares(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples of every tare, its first third left out: the arm has only just come to rest."""
    inside = np.flatnonzero(trajectory.phase == Phase.TARE)
    stretches = np.split(inside, np.flatnonzero(np.diff(inside) > 1) + 1) if len(inside) else []
    return [stretch[len(stretch) // 3 :] for stretch in stretches]


def _tool_wrench(tool: Tool, trajectory: Trajectory, axes: np.ndarray) -> np.ndarray:
    """What the arm must do to the tool alone to move it as it moved, sensor axes, about the sensor's origin, (T, 6)."""
    twist, rates = trajectory.tcp_velocity, twist_rates(trajectory)
    into = axes.transpose(0, 2, 1)
    linear = np.einsum("nij,nj->ni", into, rates[:, :3])
    spin, spin_rate = (np.einsum("nij,nj->ni", into, x) for x in (twist[:, 3:], rates[:, 3:]))
    arm = tool.com - tool.tcp
    acceleration = linear + np.cross(spin_rate, arm) + np.cross(spin, np.cross(spin, arm))
    gravity = np.einsum("nij,j->ni", into, [0, 0, -GRAVITY])
    force = tool.mass * (acceleration - gravity)
    torque = spin_rate @ tool.inertia.T + np.cross(spin, spin @ tool.inertia.T) + np.cross(tool.com, force)
    return np.hstack([force, torque])


def twist_rates(trajectory: Trajectory) -> Float[np.ndarray, "T 6"]:
    """Acceleration of the tool at the TCP, linear and angular, world axes, m/s^2 and rad/s^2."""
    twist = trajectory.tcp_velocity
    rate = 1 / float(np.median(np.diff(trajectory.time_s)))
    window = min(11, len(twist) - 1 + len(twist) % 2)
    rates = savgol_filter(twist, window, 2, deriv=1, delta=1 / rate, axis=0) if window > 2 else np.zeros_like(twist)
    return np.asarray(rates)


def _said(sensing: Sensing, seed: int) -> dict[str, str]:
    return {"sensing": sensing.name, "sensing_seed": str(seed)}
