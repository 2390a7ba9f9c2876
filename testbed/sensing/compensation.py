"""Compensation: from the raw sensor record to the wrench on the object, by tare and tool."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import savgol_filter

from testbed.errors import InvalidValueError
from testbed.frames import move_wrench, rotate_wrench, rotation_matrix
from testbed.objects.model import GRAVITY
from testbed.sensing.series import interpolated, runs
from testbed.trajectory import Phase, Tool, Trajectory

SIDEWAYS = GRAVITY * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
"""Change of the acceleration that opposes gravity with a tilt about the table's x and y axes [m/s^2 per rad]."""
SMOOTHING = 0.1
"""Time over which the hand's velocity is differentiated [s]."""
UNEVEN = 0.01
"""Part of a step by which samples may lie off even times: beyond, they are interpolated."""
ZEROED_BEFORE = "zeroed_before_s"
"""Figure of a record without a tare: time from the zeroing of its sensor to its first sample [s]."""


def compensate(trajectory: Trajectory, zeroed: Float[np.ndarray, "4"] | None = None) -> Trajectory:
    """Trajectory with `wrench_on_object_world` from its raw sensor record, simulated or real.

    Tare: the sensor's bias is the mean of the raw record while hovering, less the weight of the tool. A second tare at
    the end of a trial only shows the drift. Tool: gravity and inertia of all parts below the sensor follow from the
    hand's motion. The remaining wrench is moved to the TCP, in world axes.

    Args:
        trajectory: record with a tool.
        zeroed: orientation in which the sensor was zeroed before the record, wxyz; a record then needs no tare.

    Raises:
        InvalidValueError: no tare samples, or no tool.
    """
    tool, tares = trajectory.tool, _tares(trajectory)
    if tool is None or not (tares or zeroed is not None):
        raise InvalidValueError(
            "Trajectory", "no tool" if tool is None else "no samples in phase TARE", "a record with a tool and a tare"
        )
    axes = rotation_matrix(trajectory.sensor_orientation)
    load = tool_wrench(tool, trajectory, axes)
    if tares:
        bias = (trajectory.sensor_wrench - load)[tares[0]].mean(axis=0)
    else:
        bias = -tool_pulls(tool, rotation_matrix(np.array(zeroed))[None], np.array([[0.0, 0.0, GRAVITY]]))[0, 0]
    at_sensor = trajectory.sensor_wrench - bias - load
    world = rotate_wrench(axes, move_wrench(at_sensor, tool.tcp))
    return replace(trajectory, wrench_on_object_world=world)


def tare_biases(trajectory: Trajectory) -> list[Float[np.ndarray, "6"]]:
    """Bias of the sensor at every tare of a record, in order [N, N m]; empty without a tare or a tool."""
    tool, tares = trajectory.tool, _tares(trajectory)
    if tool is None or not tares:
        return []
    load = tool_wrench(tool, trajectory, rotation_matrix(trajectory.sensor_orientation))
    return [(trajectory.sensor_wrench - load)[tare].mean(axis=0) for tare in tares]


def tare_samples(trajectory: Trajectory) -> Int[np.ndarray, "N"]:
    """Indices of the samples of the first tare; empty without a tare."""
    return next(iter(_tares(trajectory)), np.empty(0, dtype=np.int64))


def _tares(trajectory: Trajectory) -> list[Int[np.ndarray, "N"]]:
    """Indices of the samples of every tare, without its first third, in which the arm comes to rest."""
    return [stretch[len(stretch) // 3 :] for stretch in runs(trajectory.mask(Phase.TARE))]


def tool_wrench(tool: Tool, trajectory: Trajectory, axes: np.ndarray) -> np.ndarray:
    """Wrench on the tool alone for its motion and weight [N, N m], sensor axes, about the sensor's origin, (T, 6)."""
    twist, rates = trajectory.tcp_velocity, twist_rates(trajectory)
    into_sensor = axes.transpose(0, 2, 1)
    linear = np.einsum("nij,nj->ni", into_sensor, rates[:, :3])
    spin, spin_rate = (np.einsum("nij,nj->ni", into_sensor, x) for x in (twist[:, 3:], rates[:, 3:]))
    arm = tool.com - tool.tcp
    acceleration = linear + np.cross(spin_rate, arm) + np.cross(spin, np.cross(spin, arm))
    gravity = np.einsum("nij,j->ni", into_sensor, [0, 0, -GRAVITY])
    force = tool.mass * (acceleration - gravity)
    torque = spin_rate @ tool.inertia.T + np.cross(spin, spin @ tool.inertia.T) + np.cross(tool.com, force)
    return np.hstack([force, torque])


def tool_pulls(
    tool: Tool, axes: Float[np.ndarray, "T 3 3"], pulls: Float[np.ndarray, "A 3"]
) -> Float[np.ndarray, "T A 6"]:
    """Wrenches on the tool alone for accelerations in the world [m/s^2], sensor axes, about the sensor's origin."""
    force = tool.mass * np.einsum("nji,aj->nai", axes, pulls)
    return np.concatenate([force, np.cross(tool.com, force)], axis=2)


def twist_rates(trajectory: Trajectory) -> Float[np.ndarray, "T 6"]:
    """Linear and angular acceleration of the tool at the TCP [m/s^2, rad/s^2], world axes, shape (T, 6)."""
    twist = trajectory.tcp_velocity
    time = trajectory.time_s
    if len(time) < 3:
        return np.zeros_like(twist)
    even = np.linspace(time[0], time[-1], len(time))
    step = float(even[1] - even[0])
    around = max(round(SMOOTHING / 2 / step), 1)
    window = min(2 * around + 1, len(twist) - 1 + len(twist) % 2)
    uneven = np.abs(time - even).max() > UNEVEN * step
    samples = interpolated(even, time, twist) if uneven else twist
    rates = np.asarray(savgol_filter(samples, window, 2, deriv=1, delta=step, axis=0))
    return interpolated(time, even, rates) if uneven else rates


def tare_time(trajectory: Trajectory) -> float:
    """Middle of the first tare [s]; the time at which the sensor was zeroed without a tare."""
    tare = tare_samples(trajectory)
    zeroed = trajectory.time_s[0] - trajectory.figures.get(ZEROED_BEFORE, 0.0)
    return float(trajectory.time_s[tare].mean() if len(tare) else zeroed)
