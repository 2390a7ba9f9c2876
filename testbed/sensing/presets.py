"""Sensing presets by name: stated errors of a sensor and its camera, and factors of the true errors."""

from __future__ import annotations

import re
from dataclasses import dataclass, replace

import numpy as np

from testbed.errors import InvalidValueError
from testbed.sensing.camera import CAMERAS, Camera
from testbed.validation import frozen_array

Axes = tuple[float, float, float]
"""Values of the axes x, y, z."""


@dataclass(frozen=True)
class Sensing:
    """Errors of a sensor as its data sheet states them: standard deviations, SI units, sensor axes.

    A draw multiplies bias and drift by `true_bias` and `true_drift`, which are hidden from methods and policies.
    """

    name: str
    """Preset name."""
    force_noise: Axes = (0.0, 0.0, 0.0)
    """White noise of the force, per sample [N]."""
    torque_noise: Axes = (0.0, 0.0, 0.0)
    """White noise of the torque, per sample [N m]."""
    lag1: float = 0.0
    """Correlation between neighboring samples."""
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
    true_bias: float = 1.0
    """Ratio of the drawn bias to the stated one."""
    true_drift: float = 1.0
    """Ratio of the drawn random walk to the stated one."""
    source: str = ""
    """Source of the numbers."""
    camera: Camera = CAMERAS["exact"]
    """Camera for the poses of parts that the hand does not hold."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if name in ("name", "source", "camera"):
                continue
            shape = (3,) if name in ("force_noise", "torque_noise") else ()
            if (frozen_array(f"Sensing.{name}", value, shape) < 0).any():
                raise InvalidValueError(f"Sensing.{name}", value, "numbers >= 0")
        if not self.lag1 < 1:
            raise InvalidValueError("Sensing.lag1", self.lag1, "a number from 0 to below 1")

    @property
    def stated(self) -> Sensing:
        """Sensor with the errors of its data sheet, which methods and policies may use."""
        name = re.sub(r":(bias|drift)=[^:]*", "", self.name)
        return replace(self, name=name, true_bias=1.0, true_drift=1.0)

    @property
    def bias_std(self) -> np.ndarray:
        """Constant error left by the tare, as stated [N, N m], shape (6,)."""
        return np.repeat([self.force_bias, self.torque_bias], 3)

    @property
    def drift_std(self) -> np.ndarray:
        """Random walk of the zero, as stated [N/sqrt(s), N m/sqrt(s)], shape (6,)."""
        return np.repeat([self.force_drift, self.torque_drift], 3)


def _grid(name: str, force: float, torque: float, angular: float, linear: float) -> Sensing:
    return Sensing(
        name,
        (force, force, force),
        (torque, torque, torque),
        linear_acceleration_noise=linear,
        angular_acceleration_noise=angular,
        scale=0.001,
        source="the simulation study in arXiv:2203.00830, Table II",
    )


PRESETS: dict[str, Sensing] = {
    preset.name: preset
    for preset in (
        Sensing("ideal", source="no sensor: a perfect one"),
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
            camera=CAMERAS["30hz"],
            source="noise: one lab's measurement; bias after the tare, walk, scale: ours, well below its cold drift",
        ),
        _grid("low", 0.05, 0.0025, 0.25, 0.025),
        _grid("moderate", 0.1, 0.005, 0.5, 0.05),
        _grid("high", 0.33, 0.0067, 1.0, 0.1),
    )
}
"""Presets by name: `ideal`, `ft300s`, `low`, `moderate`, `high`."""


_FACTORS = re.compile(
    r"(?P<preset>[^:]+)(:bias=(?P<bias>[\d.]+))?(:drift=(?P<drift>[\d.]+))?(:camera=(?P<camera>[^:]+))?"
)


def preset(name: str, field: str = "sensing") -> Sensing:
    """Sensing preset by name; "ft300s:bias=2:drift=0.5" draws twice the stated bias and half the stated drift.

    "ft300s:camera=exact" has another camera. `field` is the name's field in an error.

    Raises:
        InvalidValueError: no such preset.
    """
    found = _FACTORS.fullmatch(name) if isinstance(name, str) else None
    if found is None or found["preset"] not in PRESETS:
        allowed = f"one of {', '.join(PRESETS)}; with another bias or drift than stated as ft300s:bias=2:drift=0.5"
        raise InvalidValueError(field, name, allowed)
    camera = found["camera"] or PRESETS[found["preset"]].camera.name
    if camera not in CAMERAS:
        raise InvalidValueError(field, name, f"a camera of {', '.join(CAMERAS)}")
    stated, bias, drift = PRESETS[found["preset"]], found["bias"] or 1.0, found["drift"] or 1.0
    try:
        return replace(stated, name=name, camera=CAMERAS[camera], true_bias=float(bias), true_drift=float(drift))
    except ValueError:
        raise InvalidValueError(field, name, "a number of each factor, as ft300s:bias=2:drift=0.5") from None
