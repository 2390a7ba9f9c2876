"""Settings of the real robot, and the robot file (robot.toml) that sets them."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.objects.model import ROBOTIQ_2F85, Hand
from testbed.robot.calibration.file import load_calibration
from testbed.robot.calibration.static_poses import Calibration
from testbed.robot.interfaces import ArmIdentity
from testbed.robot.safety import Place, SafetyLimits
from testbed.sensing.camera import CAMERAS, Camera
from testbed.sensing.drift import DriftLimit
from testbed.sensing.presets import preset
from testbed.trajectory import Tool
from testbed.validation import Range, check_settings, unit_quaternion
from testbed.worlds.presets import UNSTATED, StatedSetup
from testbed.worlds.setup_errors import SetupErrors

_Force = Annotated[float, Range(0, 10, "N")]
_Torque = Annotated[float, Range(0, 1, "N m")]


@dataclass(frozen=True, eq=False)
class RobotSettings:
    """Settings of a trial. The world is the arm's base frame, its origin moved up or down to the table."""

    tool: Tool
    """Everything below the sensor, sensor frame; from calibration."""
    sensor_orientation: Annotated[Float[np.ndarray, "4"], Range(-1, 1, "")] = field(
        default_factory=lambda: np.array([1.0, 0.0, 0.0, 0.0])
    )
    """Orientation of the sensor's frame in the arm's tool frame, wxyz; from calibration."""
    sensor_sign: Literal[1, -1] = 1
    """Factor that converts the sensor's reading to the wrench of the arm on the tool; from calibration."""
    sensor_gain: Annotated[Float[np.ndarray, "6"], Range(0.5, 2, "")] = field(default_factory=lambda: np.ones(6))
    """Reading over true value, of each axis; from calibration."""
    closing_angle: Annotated[float, Range(-2 * math.pi, 2 * math.pi, "rad")] = 0.0
    """Closing direction of the pads, from the x axis of the arm's tool frame about its z axis [rad]."""
    table_height: Annotated[float, Range(-0.6, 0.6, "m")] = 0.0
    """Height of the table's top in the arm's base frame [m]."""
    grip_height: Annotated[float, Range(0.002, 0.2, "m")] = 0.022
    """Height of the TCP over the table while holding [m]."""
    grip_force: Annotated[float, Range(1, 300, "N")] = 120.0
    """Force of each finger [N]; a gripper without force control ignores it."""
    hover: Annotated[float, Range(0.005, 0.3, "m")] = 0.06
    """Height over the grasp at which the sensor is tared [m]."""
    travel_speed: Annotated[float, Range(0.002, 0.25, "m/s")] = 0.1
    """Speed of travel over the table [m/s]."""
    descent_speed: Annotated[float, Range(0.002, 0.1, "m/s")] = 0.05
    """Greatest speed of descent, rise and lift [m/s]."""
    tare_time: Annotated[float, Range(0.2, 30, "s")] = 1.0
    """Duration of each of the two tares [s]."""
    settle_time: Annotated[float, Range(0.2, 30, "s")] = 1.5
    """Time after the grip has closed, in which the load of the closing fingers is nulled [s]."""
    null_gain: tuple[Annotated[float, Range(0, 0.01, "m/s/N")], Annotated[float, Range(0, 0.1, "rad/s/(N m)")]] = (
        5e-4,
        5e-3,
    )
    """Gains by which the tool yields to vertical load and to tilting moment [m/s/N, rad/s/(N m)]."""
    null_travel: tuple[Annotated[float, Range(0, 0.02, "m")], Annotated[float, Range(0, 0.1, "rad")]] = (
        0.002,
        math.radians(0.5),
    )
    """Largest distance and angle by which the tool yields [m, rad]."""
    lift: Annotated[float, Range(0.002, 0.2, "m")] = 0.015
    """Height to which an object is lifted to be weighed [m]."""
    rate: Annotated[float, Range(20, 1000, "Hz")] = 40.0
    """Rate of twist commands [Hz]."""
    gain: Annotated[float, Range(0.1, 20, "1/s")] = 2.0
    """Gain of the feedback on a pose error [1/s]."""
    off_path: tuple[Annotated[float, Range(0, 0.05, "m")], Annotated[float, Range(0, 0.2, "rad")]] = (
        0.005,
        math.radians(2.0),
    )
    """Distance and angle from the planned path that end a trial [m, rad]."""
    drift: DriftLimit = field(default_factory=DriftLimit)
    """Limit on the drift of the sensor's zero in a valid trial."""
    setup: SetupErrors = UNSTATED
    """Errors of the setup other than the sensor's, as stated in the robot file."""
    bias_std: tuple[_Force, _Torque] = preset("ft300s").force_bias, preset("ft300s").torque_bias
    """Standard deviation of the bias after a tare [N, N m]."""
    drift_std: tuple[_Force, _Torque] = preset("ft300s").force_drift, preset("ft300s").torque_drift
    """Least random walk of the sensor's zero [N, N m per square root of a second]; the manufacturer states none. A
    trial whose two tares show more is given the larger one."""
    camera: Camera = CAMERAS["30hz"]
    """Errors of the camera, if any, as stated in the robot file."""
    tool_error: tuple[_Force, _Torque] = (0.35, 0.02)
    """Largest error of the change of the tool's wrench under a tilt before the first trial [N, N m]."""
    limits: SafetyLimits = field(default_factory=SafetyLimits)
    """Limits on every motion."""

    def __post_init__(self) -> None:
        check_settings(RobotSettings, vars(self), "RobotSettings")
        quaternion = unit_quaternion("RobotSettings.sensor_orientation", self.sensor_orientation)
        object.__setattr__(self, "sensor_orientation", quaternion)
        for name in ("off_path", "bias_std", "drift_std", "null_gain", "null_travel", "tool_error"):
            object.__setattr__(self, name, tuple(map(float, getattr(self, name))))

    def on_tool(self, reading: Float[np.ndarray, "*n 6"]) -> Float[np.ndarray, "*n 6"]:
        """Wrench of the arm on the tool [N, N m], sensor axes, from a reading of the sensor or a change of it."""
        return self.sensor_sign * reading / self.sensor_gain


_SEEN = CAMERAS["30hz"]
_OFF_AXIS = 0.05
"""Largest distance of the tool's center of mass from its axis [m]."""
Corner = Annotated[list[Place], Field(min_length=3, max_length=3)]


class Strict(BaseModel):
    """Base of the tables: known fields alone, frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class ArmTable(Strict):
    """[arm]"""

    model: str = "kinova_gen3"
    """Arm by name, or package:Class."""
    settings: dict[str, Any] = {}
    """Further arguments of its class."""
    address: str = "192.168.1.10"
    """Address of the arm."""
    port: Annotated[int, Range(1, 65535, "")] = 10000
    """TCP port of the arm."""
    username: str = "admin"
    """User of the arm; the password is in HEFT_KORTEX_PASSWORD."""
    serial: str | None = None
    """Serial number that the arm must report; None takes any."""
    firmware: str | None = None
    """Firmware that it must report."""
    tool_length_m: Annotated[float, Range(0.02, 0.6, "m")] = 0.2115
    """Distance from the arm's interface to the tool center point, as stored in the arm."""


class SensorTable(Strict):
    """[sensor]"""

    model: str = "ft300s"
    """Wrench sensor by name, or package:Class."""
    settings: dict[str, Any] = {}
    """Further arguments of its class."""
    port: str | None = None
    """Device file."""
    calibration: str = "calibration.toml"
    """File that heft robot calibrate writes, beside this one."""
    to_tcp_m: Annotated[float, Range(0.01, 0.5, "m")] = 0.174
    """Distance from the sensor's origin to the tool center point, along the tool's axis."""


class GripperTable(Strict):
    """[gripper]"""

    model: str = "2f85"
    """Gripper by name, or package:Class."""
    stroke_m: Annotated[float, Range(0.001, 1, "m")] = ROBOTIQ_2F85.stroke
    """Opening."""
    finger_width_m: Annotated[float, Range(0.001, 1, "m")] = ROBOTIQ_2F85.finger_width
    """Width of a finger across the closing direction."""
    settings: dict[str, Any] = {}
    """Further arguments of its class."""

    @property
    def hand(self) -> Hand:
        """Size of the hand, which determines the rows of blocks that it can grip."""
        return Hand(self.stroke_m, self.finger_width_m)


class CameraTable(Strict):
    """[camera]"""

    model: str | None = None
    """Camera by name, or package:Class; pushes, and objects with hinges, need one."""
    settings: dict[str, Any] = {}
    """Arguments of its class."""
    position_std_m: Annotated[float, Range(0, 0.05, "m")] = _SEEN.position
    """Standard deviation of a position, per frame and axis."""
    angle_std_deg: Annotated[float, Range(0, 20, "deg")] = math.degrees(_SEEN.angle)
    """Standard deviation of a yaw, per frame."""
    delay_s: Annotated[list[Annotated[float, Range(0, 1, "s")]], Field(min_length=2, max_length=2)] = list(_SEEN.delay)
    """Least and greatest time by which its stamps are late."""

    @model_validator(mode="after")
    def _least_delay_first(self) -> Self:
        if self.delay_s[0] > self.delay_s[1]:
            raise InvalidValueError("delay_s", self.delay_s, "two times, the least first, s")
        return self

    @property
    def errors(self) -> Camera:
        """Errors as stated."""
        least, most = self.delay_s
        angle = math.radians(self.angle_std_deg)
        return Camera(self.model or "none", position=self.position_std_m, angle=angle, delay=(least, most))


class BenchTable(Strict):
    """[bench]"""

    table_height_m: Annotated[float, Range(-0.6, 0.6, "m")] = 0.0
    """Height of the table's top over the arm's base."""
    closing_deg: Annotated[float, Range(-360, 360, "deg")] = 0.0
    """Closing direction of the pads, from the x axis of the arm's tool frame about its z axis."""
    grip_height_m: Annotated[float, Range(0.002, 0.2, "m")] = 0.022
    """Height of the pads' middle over the table while they hold."""
    travel_speed_m_s: Annotated[float, Range(0.002, 0.25, "m/s")] = 0.1
    """Speed over the table."""
    descent_speed_m_s: Annotated[float, Range(0.002, 0.1, "m/s")] = 0.05
    """Speed down to the object, and up."""
    tare_s: Annotated[float, Range(0.2, 30, "s")] = 1.0
    """Duration of each tare."""
    drift_force_N: Annotated[float, Range(0.001, 10, "N")] = 0.2
    """Allowed drift of the sensor's force over a trial."""
    drift_torque_Nm: Annotated[float, Range(0.0001, 1, "N m")] = 0.01
    """Allowed drift of its torque."""


class LimitsTable(Strict):
    """[limits]"""

    low_m: Corner = [0.25, -0.35, 0.015]
    """Corner of the box for the tool center point, base frame of the arm."""
    high_m: Corner = [0.65, 0.35, 0.4]
    """The opposite corner."""
    speed_m_s: Annotated[float, Range(0.002, 0.5, "m/s")] = 0.15
    """Largest speed of the tool."""
    turn_deg_s: Annotated[float, Range(0.1, 100, "deg/s")] = 69.0
    """Largest turn rate of the tool."""
    tilt_deg: Annotated[float, Range(5, 35, "deg")] = 5.0
    """Largest angle of the tool from straight down; a lift needs half a degree more than its tilt."""
    force_N: Annotated[float, Range(1, 300, "N")] = 60.0
    """Largest change of the sensor's force since the tare."""
    torque_Nm: Annotated[float, Range(0.1, 30, "N m")] = 8.0
    """Largest change of its torque."""
    joint_margin_deg: Annotated[float, Range(0, 45, "deg")] = 3.0
    """Distance to keep from the end of a joint's range."""

    @model_validator(mode="after")
    def _is_a_box(self) -> Self:
        if not all(low < high for low, high in zip(self.low_m, self.high_m, strict=True)):
            raise InvalidValueError("high_m", self.high_m, f"a corner beyond low_m, {self.low_m}, along each axis")
        return self


class RobotFile(Strict):
    """The robot file; every field has a default but the sensor's port."""

    arm: ArmTable = ArmTable()
    sensor: SensorTable = SensorTable()
    gripper: GripperTable = GripperTable()
    camera: CameraTable = CameraTable()
    bench: BenchTable = BenchTable()
    limits: LimitsTable = LimitsTable()
    setup: StatedSetup = UNSTATED

    @model_validator(mode="after")
    def _box_is_over_the_table(self) -> Self:
        if self.limits.low_m[2] < (top := self.bench.table_height_m):
            allowed = f"z of {top:g} m or more, bench.table_height_m: the tool must not reach below the table's top"
            raise InvalidValueError("limits.low_m", self.limits.low_m, allowed)
        return self

    def to_dict(self) -> dict[str, Any]:
        """Plain data for a record; a device's name, settings and sizes only where they differ from the defaults."""
        unused = {"setup": self.setup == UNSTATED, "camera": self.camera.model is None}
        tables = self.model_dump(exclude={name for name, left in unused.items() if left})
        for name in ("arm", "sensor", "gripper"):
            usual = type(getattr(self, name))().model_dump(include=set(GripperTable.model_fields))
            tables[name] = {key: value for key, value in tables[name].items() if usual.get(key, ...) != value}
        return {name: table for name, table in tables.items() if table}

    def check_arm(self, arm: ArmIdentity) -> None:
        """Compare an arm with the file.

        Raises:
            InvalidValueError: the file states another serial number or firmware.
        """
        for name in ("serial", "firmware"):
            wanted, found = getattr(self.arm, name), getattr(arm, name)
            if wanted not in (None, found):
                raise InvalidValueError(f"arm.{name}", wanted, f"{found}, which the arm reports")

    def settings(self, calibration: Calibration | None, sheet: Tool) -> RobotSettings:
        """Settings of a trial.

        Args:
            calibration: mount of the sensor, and mass and center of the tool; None, for a dry run, takes the sensor as
                aligned with the hand and the tool from the data sheet.
            sheet: the gripper's data sheet at the width of the held object.

        Raises:
            InvalidValueError: an implausible mass or center of the calibrated tool, as by a wrong sign or unit.
        """
        b, limits = self.bench, self.limits
        settings = RobotSettings(
            sheet,
            closing_angle=math.radians(b.closing_deg),
            table_height=b.table_height_m,
            grip_height=b.grip_height_m,
            travel_speed=b.travel_speed_m_s,
            descent_speed=b.descent_speed_m_s,
            tare_time=b.tare_s,
            drift=DriftLimit(b.drift_force_N, b.drift_torque_Nm),
            setup=self.setup,
            camera=self.camera.errors,
            limits=SafetyLimits(
                low=(limits.low_m[0], limits.low_m[1], limits.low_m[2]),
                high=(limits.high_m[0], limits.high_m[1], limits.high_m[2]),
                linear_speed=limits.speed_m_s,
                angular_speed=math.radians(limits.turn_deg_s),
                tilt=math.radians(limits.tilt_deg),
                force=limits.force_N,
                torque=limits.torque_Nm,
                joint_margin=math.radians(limits.joint_margin_deg),
            ),
        )
        if calibration is None:
            return settings
        mount, mass = calibration.sensor_in_hand, calibration.mass
        turn = Rotation.from_quat(mount, scalar_first=True).as_matrix().T  # from the hand's axes to the sensor's
        if not sheet.mass / 2 <= mass <= 3 * sheet.mass:
            allowed = f"{sheet.mass / 2:.2f} to {3 * sheet.mass:.2f} kg: the gripper's is {sheet.mass:.2f} kg"
            raise InvalidValueError("calibration.tool_mass_kg", mass, allowed)
        x, y, z = calibration.com @ turn
        if not (math.hypot(x, y) <= _OFF_AXIS and 0 < z < self.sensor.to_tcp_m):
            allowed = f"a place between sensor and tool center point, at most {_OFF_AXIS} m off the axis, hand axes, m"
            raise InvalidValueError("calibration.tool_com_m", [x, y, z], allowed)
        tcp = turn @ [0.0, 0.0, self.sensor.to_tcp_m]
        tool = Tool(mass, calibration.com, turn @ sheet.inertia @ turn.T, tcp)
        sensor: dict[str, Any] = {"sensor_sign": calibration.sign, "sensor_gain": calibration.gain}
        return replace(settings, tool=tool, sensor_orientation=mount, **sensor)


def calibration_of(file: RobotFile, path: Path, sensor: str | None = None) -> Calibration | None:
    """Load the calibration that the robot file names, relative to its folder; None if there is no such file.

    Raises:
        InvalidFileError: not a calibration file.
        InvalidValueError: a calibration of a sensor with another serial number.
    """
    where = path.parent / file.sensor.calibration
    return load_calibration(where, sensor) if where.is_file() else None
