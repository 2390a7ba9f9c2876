"""Noise: draws of a sensor's errors for a clean, simulated record.

A simulated trial is stored as of a perfect sensor, so that further draws need no simulation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from scipy.signal import lfilter

from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import perpendicular
from testbed.objects.model import GRAVITY
from testbed.sensing.camera import draw_camera
from testbed.sensing.camera_poses import with_camera_poses
from testbed.sensing.compensation import compensate
from testbed.sensing.presets import Sensing
from testbed.trajectory import Phase, Trajectory
from testbed.worlds.draw import WorldDraw
from testbed.worlds.instruments import as_measured, rounded, true_sensing

SURE_WEIGHT = 3.0
"""Least reading of a scale over its standard error."""


def draw_sensing(clean: Trajectory, sensing: Sensing, seed: int) -> Trajectory:
    """Draw the record of a sensor with errors from a clean trajectory; the result is tared and compensated.

    If the clean trajectory is from a world that is not ideal, the errors of arm and sensor in that world are added.

    The result states the sensor's errors as its data sheet does, and nothing that reveals the draw.

    Args:
        clean: simulated trial with a perfect sensor.
        sensing: errors of the sensor.
        seed: seed of the draw. Trials of equal length get the same errors from the same seed: use one per trial.

    Raises:
        InvalidValueError: a trajectory with a sensor's errors.
    """
    if "sensing" in clean.provenance:
        allowed = "a simulated trial of a perfect sensor, as run_clean gives it"
        raise InvalidValueError("clean", "a trajectory with a sensor's errors", allowed)
    rng, draw = np.random.default_rng(seed), WorldDraw.in_record(clean.provenance)
    provenance = {name: clean.provenance[name] for name in ("runner",) if name in clean.provenance}
    provenance["sensing"] = "drawn"
    if clean.tool is None:
        wrench = np.array(clean.wrench_on_object_world)
        offset = 0.0 if draw is None else draw.normal("scale", 1)[0]
        wrench[:, 2] += GRAVITY * read_scale(offset, sensing, seed)
        return replace(clean, sensor_wrench=wrench, wrench_on_object_world=wrench, provenance=provenance)
    if draw is not None:
        clean, sensing = as_measured(clean, draw), true_sensing(sensing, draw)
    count = len(clean.time_s)
    dt = float(np.median(np.diff(clean.time_s))) if count > 1 else 0.0
    noise_std = np.array([*sensing.force_noise, *sensing.torque_noise])
    white = rng.standard_normal((count, 6))
    white[1:] *= np.sqrt(1 - sensing.lag1**2)
    colored = lfilter([1.0], [1.0, -sensing.lag1], white, axis=0)
    bias = sensing.true_bias * sensing.bias_std * rng.standard_normal(6)
    walk = np.cumsum(sensing.true_drift * sensing.drift_std * np.sqrt(dt) * rng.standard_normal((count, 6)), axis=0)
    tared = np.maximum.accumulate(clean.phase > Phase.TARE)
    raw = clean.sensor_wrench + noise_std * colored + walk + np.outer(tared, bias)
    if draw is not None:
        raw = rounded(raw, draw)
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
        provenance=provenance,
    )
    if clean.camera is not None:
        noisy = with_camera_poses(replace(noisy, camera=draw_camera(clean.camera, sensing.camera, seed)))
    return compensate(noisy)


def read_scale(mass: float, sensing: Sensing, seed: int | Sequence[int]) -> float:
    """Reading of a scale [kg]: the mass with one draw of the scale's error."""
    return mass + sensing.scale * float(np.random.default_rng(seed).standard_normal())


def check_reading(name: str, reading: float, sensing: Sensing) -> None:
    """Check that the reading of a scale exceeds its error.

    Raises:
        InfeasibleTrialError: a reading of at most `SURE_WEIGHT` standard errors.
    """
    if reading <= SURE_WEIGHT * sensing.scale:
        reason = f"weight: the scale reads {1e3 * reading:.2g} g, with an error of {1e3 * sensing.scale:.2g} g"
        raise InfeasibleTrialError(f"{name}: {reason}; take a better scale or a heavier object")
