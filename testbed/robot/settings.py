"""Settings of the real bench: its table, its tool, how it moves, and when a record is refused."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from jaxtyping import Float

from testbed.arrays import check_positive, frozen_array, is_number
from testbed.drift import DriftLimit
from testbed.errors import InvalidValueError
from testbed.robot.safety import SafetyLimits
from testbed.sensing import preset
from testbed.trajectory import Tool


@dataclass(frozen=True, eq=False)
class RobotSettings:
    """Settings of the real bench. The world is the arm's base frame, its origin lowered or raised to the table."""

    tool: Tool
    """What hangs below the sensor, in the sensor's frame: by calibration."""
    sensor_orientation: Float[np.ndarray, "4"] = field(default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0]))
    """Orientation of the sensor's frame in the arm's tool frame, wxyz: by calibration."""
    sensor_sign: Literal[1, -1] = 1
    """What to multiply the sensor's reading by, so that it is what the arm does to the tool: by calibration."""
    closing_angle: float = 0.0
    """Direction along which the pads close, from the x axis of the arm's tool frame about its z axis, rad."""
    table_height: float = 0.0
    """Of the table's top in the arm's base frame, m."""
    grip_height: float = 0.022
    """Of the TCP over the table while holding, m."""
    grip_force: float = 120.0
    """At each finger, N; a gripper that cannot be told takes its own."""
    hover: float = 0.06
    """Height over the grasp at which the sensor is zeroed, m."""
    travel_speed: float = 0.1
    """Between places over the table, m/s."""
    descent_speed: float = 0.05
    """Greatest speed down to the object, up, and lifting it, m/s."""
    tare_time: float = 1.0
    """Of each of the two tares, s."""
    settle_time: float = 1.5
    """After the grip has closed, while the load that the closing fingers left is nulled, s."""
    null_gain: tuple[float, float] = (5e-4, 5e-3)
    """How fast the tool gives way to vertical load and to tilt, m/s a newton and rad/s a newton metre."""
    null_travel: tuple[float, float] = (0.002, math.radians(0.5))
    """How far it gives way at most, m and rad."""
    lift: float = 0.015
    """How far an object is lifted to be weighed, m."""
    rate: float = 40.0
    """Rate of twist commands, Hz."""
    gain: float = 2.0
    """Rate at which an error of pose is taken back, 1/s."""
    off_path: tuple[float, float] = (0.005, math.radians(2.0))
    """Distance and angle from the planned path at which a trial ends, m and rad."""
    drift: DriftLimit = field(default_factory=DriftLimit)
    """How far the sensor's zero may move over a trial that is still data."""
    bias_std: tuple[float, float] = (preset("ft300s").force_bias, preset("ft300s").torque_bias)
    """What a tare may leave, one standard deviation, N and N m."""
    drift_std: tuple[float, float] = (preset("ft300s").force_drift, preset("ft300s").torque_drift)
    """How the sensor's zero walks at least, N and N m per square root of a second; no maker's figure is known. A trial
    whose two tares show more counts with that."""
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    """What must never be done."""

    def __post_init__(self) -> None:
        quaternion = frozen_array("RobotSettings.sensor_orientation", self.sensor_orientation, (4,))
        if abs(np.linalg.norm(quaternion) - 1) > 1e-3:
            raise InvalidValueError("RobotSettings.sensor_orientation", quaternion.tolist(), "a unit quaternion, wxyz")
        object.__setattr__(self, "sensor_orientation", quaternion)
        if self.sensor_sign not in (1, -1):
            raise InvalidValueError("RobotSettings.sensor_sign", self.sensor_sign, "1 or -1")
        for name in ("closing_angle", "table_height"):
            if not is_number(getattr(self, name)):
                raise InvalidValueError(f"RobotSettings.{name}", getattr(self, name), "a finite number")
        for name in (
            *("grip_height", "grip_force", "hover", "travel_speed", "descent_speed", "tare_time", "settle_time"),
            *("lift", "rate", "gain"),
        ):
            check_positive(f"RobotSettings.{name}", getattr(self, name))
        for name in ("off_path", "bias_std", "drift_std", "null_gain", "null_travel"):
            pair = frozen_array(f"RobotSettings.{name}", getattr(self, name), (2,))
            if not (pair >= 0).all():
                raise InvalidValueError(f"RobotSettings.{name}", pair.tolist(), "two numbers >= 0")
            object.__setattr__(self, name, tuple(pair.tolist()))
