"""Sensing presets: the errors of a sensor, by name."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from testbed.errors import InvalidValueError
from testbed.validation import frozen_array

Axes = tuple[float, float, float]
"""Numbers for the axes x, y, z."""


@dataclass(frozen=True)
class Sensing:
    """Errors of a sensor: standard deviations, SI units, sensor axes."""

    name: str
    """Preset name."""
    force_noise: Axes = (0.0, 0.0, 0.0)
    """White noise of the force, per sample [N]."""
    torque_noise: Axes = (0.0, 0.0, 0.0)
    """White noise of the torque, per sample [N m]."""
    lag1: float = 0.0
    """Correlation between neighbouring samples."""
    force_bias: float = 0.0
    """Force bias left after the tare, one draw per trial [N]."""
    torque_bias: float = 0.0
    """Torque bias left after the tare, one draw per trial [N m]."""
    force_drift: float = 0.0
    """Random walk of the force [N/sqrt(s)]."""
    torque_drift: float = 0.0
    """Random walk of the torque [N m/sqrt(s)]."""
    linear_acceleration_noise: float = 0.0
    """Noise of the hand's linear acceleration, per sample [m/s^2]."""
    angular_acceleration_noise: float = 0.0
    """Noise of the hand's angular acceleration, per sample [rad/s^2]."""
    scale: float = 0.0
    """Error of a scale's reading [kg]."""

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
        """Constant error left by the tare [N, N m], shape (6,)."""
        return np.repeat([self.force_bias, self.torque_bias], 3)

    @property
    def drift_std(self) -> np.ndarray:
        """Random walk of the zero [N/sqrt(s), N m/sqrt(s)], shape (6,)."""
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
"""Presets by name: `ideal`, `ft300s`, `low`, `moderate`, `high`."""


def preset(name: str) -> Sensing:
    """Sensing preset by name.

    Raises:
        InvalidValueError: no such preset.
    """
    if name not in PRESETS:
        raise InvalidValueError("sensing", name, f"one of {', '.join(PRESETS)}")
    return PRESETS[name]
