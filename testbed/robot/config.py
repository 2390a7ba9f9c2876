"""Settings of the real bench: its table, its tool, how it moves, and when a record is refused."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.objects.files import Finite, NonNegative, Positive, load_toml
from testbed.robot.calibration.file import load_calibration
from testbed.robot.calibration.static_poses import Calibration
from testbed.robot.kinova.arm import KortexSettings
from testbed.robot.safety import SafetyLimits
from testbed.sensing.drift import DriftLimit
from testbed.sensing.presets import preset
from testbed.simulation.motion import gripper_tool
from testbed.trajectory import Tool
from testbed.validation import check_positive, frozen_array, is_number


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


PASSWORD_VARIABLE = "HEFT_KORTEX_PASSWORD"
"""Environment variable with the password of the arm's user; the maker's own if not set."""
DEFAULT = "robot.toml"
Corner = Annotated[list[Finite], Field(min_length=3, max_length=3)]


class Strict(BaseModel):
    """Every field is known, and nothing changes after reading."""

    model_config = ConfigDict(extra="forbid", frozen=True)


class ArmTable(Strict):
    """[arm]"""

    address: str = "192.168.1.10"
    """Of the arm."""
    port: Annotated[int, Field(gt=0, lt=65536)] = 10000
    """TCP port of the arm."""
    username: str = "admin"
    """User of the arm; the password is in HEFT_KORTEX_PASSWORD."""
    python: str | None = None
    """Python that has kortex_api, instead of HEFT_KORTEX_PYTHON."""
    tool_length_m: Positive = 0.2115
    """From the arm's interface to the tool centre point, as stored in the arm."""


class SensorTable(Strict):
    """[sensor]"""

    port: str | None = None
    """Device file."""
    calibration: str = "calibration.toml"
    """File that heft robot calibrate writes, beside this one."""
    to_tcp_m: Positive = 0.174
    """From the sensor's origin to the tool centre point, along the tool's axis."""


class BenchTable(Strict):
    """[bench]"""

    table_height_m: Finite = 0.0
    """Of the table's top over the arm's base."""
    closing_deg: Finite = 0.0
    """Direction in which the pads close, from the x axis of the arm's tool frame about its z axis."""
    grip_height_m: Positive = 0.022
    """Of the pads' middle over the table while they hold."""
    travel_speed_m_s: Positive = 0.1
    """Over the table."""
    descent_speed_m_s: Positive = 0.05
    """Down to the object, and up."""
    tare_s: Positive = 1.0
    """Time of each tare."""
    drift_force_N: Positive = 0.2
    """How far the sensor's zero may move in a trial that is still data."""
    drift_torque_Nm: Positive = 0.01
    """The same of torque."""


class LimitsTable(Strict):
    """[limits]"""

    low_m: Corner = [0.25, -0.35, 0.015]
    """Corner of the box that the tool centre point must stay in, base frame of the arm."""
    high_m: Corner = [0.65, 0.35, 0.4]
    """The opposite corner."""
    speed_m_s: Positive = 0.15
    """Of the tool."""
    turn_deg_s: Positive = 69.0
    """Of the tool."""
    force_N: Positive = 60.0
    """Change of the sensor's force since the tare."""
    torque_Nm: Positive = 8.0
    """Change of its torque."""
    joint_margin_deg: NonNegative = 3.0
    """Distance to keep from the end of a joint's range."""


class RobotFile(Strict):
    """All of it; every field has a default but the sensor's port."""

    arm: ArmTable = ArmTable()
    sensor: SensorTable = SensorTable()
    bench: BenchTable = BenchTable()
    limits: LimitsTable = LimitsTable()

    def kortex(self) -> KortexSettings:
        """How to reach the arm."""
        return KortexSettings(
            self.arm.address,
            self.arm.username,
            os.environ.get(PASSWORD_VARIABLE, "admin"),
            self.arm.port,
            python=self.arm.python,
            tool_length=self.arm.tool_length_m,
        )

    def settings(self, calibration: Calibration | None, width: float) -> RobotSettings:
        """Settings of a trial whose fingers hold something `width` (m) wide.

        Without a calibration the tool is the gripper's data sheet and the sensor sits straight: for a dry run.
        """
        b, limits = self.bench, self.limits
        settings = RobotSettings(
            gripper_tool(width),
            closing_angle=math.radians(b.closing_deg),
            table_height=b.table_height_m,
            grip_height=b.grip_height_m,
            travel_speed=b.travel_speed_m_s,
            descent_speed=b.descent_speed_m_s,
            tare_time=b.tare_s,
            drift=DriftLimit(b.drift_force_N, b.drift_torque_Nm),
            limits=SafetyLimits(
                low=(limits.low_m[0], limits.low_m[1], limits.low_m[2]),
                high=(limits.high_m[0], limits.high_m[1], limits.high_m[2]),
                linear_speed=limits.speed_m_s,
                angular_speed=math.radians(limits.turn_deg_s),
                force=limits.force_N,
                torque=limits.torque_Nm,
                joint_margin=math.radians(limits.joint_margin_deg),
            ),
        )
        if calibration is None:
            return settings
        return replace(
            settings,
            tool=self._tool(calibration, settings.tool),
            sensor_orientation=calibration.sensor_in_hand,
            sensor_sign=calibration.sign,
        )

    def _tool(self, calibration: Calibration, sheet: Tool) -> Tool:
        """Mass and centre as calibrated; inertia from the data sheet, turned into the sensor's axes."""
        turn = Rotation.from_quat(calibration.sensor_in_hand, scalar_first=True).as_matrix().T
        tcp = turn @ np.array([0.0, 0.0, self.sensor.to_tcp_m])
        return calibration.tool(tcp, turn @ sheet.inertia @ turn.T)


def load_robot_file(path: Path) -> RobotFile:
    """The file, or its defaults where there is none of the usual name.

    Raises:
        InvalidFileError: not such a file, with a line for each error.
        InvalidValueError: no file of another name than the usual one.
    """
    if path.is_file():
        return load_toml(path, RobotFile)
    if path.name != DEFAULT:
        raise InvalidValueError("config", str(path), "a path to an existing .toml file")
    return RobotFile()


def calibration_of(file: RobotFile, path: Path, sensor: str | None = None) -> Calibration | None:
    """The calibration that the file names, beside it; None where there is none yet.

    Raises:
        InvalidFileError: it is not such a file.
        InvalidValueError: it was made with another sensor than the one of this serial number.
    """
    where = path.parent / file.sensor.calibration
    return load_calibration(where, sensor) if where.is_file() else None


def sensor_port(file: RobotFile) -> str:
    """The sensor's port.

    Raises:
        InvalidValueError: the file does not name it.
    """
    if file.sensor.port is None:
        raise InvalidValueError(
            "sensor.port",
            None,
            '[sensor] port = "/dev/serial/by-id/..." in robot.toml; heft robot check lists the ports there are',
        )
    return file.sensor.port
