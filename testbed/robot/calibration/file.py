"""Calibrations of the sensor's mount and of a tracker as TOML files, which can be read and edited by hand."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from testbed.errors import InvalidValueError
from testbed.files import write_text
from testbed.objects.model import GRAVITY
from testbed.robot.calibration.hand_eye import HandEye
from testbed.robot.calibration.static_poses import Calibration
from testbed.robot.interfaces import Pose
from testbed.toml import Finite, NonNegative, Positive, fitted, load_toml, toml_text
from testbed.validation import unit_quaternion

_THREE, _SIX = Field(min_length=3, max_length=3), Field(min_length=6, max_length=6)
Vector = Annotated[list[Finite], _THREE]
Force = Annotated[list[Annotated[float, Field(ge=-300, le=300, allow_inf_nan=False)]], _THREE]
Torque = Annotated[list[Annotated[float, Field(ge=-30, le=30, allow_inf_nan=False)]], _THREE]
Center = Annotated[list[Annotated[float, Field(ge=-0.5, le=0.5, allow_inf_nan=False)]], _THREE]
Gains = Annotated[list[Annotated[float, Field(ge=0.5, le=2, allow_inf_nan=False)]], _SIX]
Deviations = Annotated[list[NonNegative], _THREE]
Walk = Annotated[list[Annotated[float, Field(ge=0, le=20, allow_inf_nan=False)]], _SIX]
Quaternion = Annotated[
    list[Finite],
    Field(min_length=4, max_length=4),
    AfterValidator(lambda wxyz: unit_quaternion("", wxyz).tolist()),
]


class CalibrationFile(BaseModel):
    """File of a sensor's calibration, SI units; `Calibration` explains the fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    sensor: str
    """Serial number of the sensor, or "unknown"."""
    made: str
    """Date, in any format."""
    sign: Literal[1, -1]
    sensor_in_hand_wxyz: Quaternion
    sensor_in_hand_std_rad: Deviations
    bias_force_N: Force
    bias_force_std_N: Deviations
    bias_torque_Nm: Torque
    bias_torque_std_Nm: Deviations
    tool_mass_kg: Annotated[float, Field(gt=0, le=10, allow_inf_nan=False)]
    tool_mass_std_kg: Positive
    tool_com_m: Center
    tool_com_std_m: Deviations
    misfit: NonNegative
    poses: Annotated[int, Field(ge=4)]
    gain: Gains = [1.0] * 6
    gain_std: Annotated[list[NonNegative], _SIX] = [0.0] * 6
    bias_walk: Walk = [0.0] * 6
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] = GRAVITY

    @model_validator(mode="after")
    def _makes_a_calibration(self) -> Self:
        self.calibration()
        return self

    def calibration(self) -> Calibration:
        """Calibration with the values of the file."""
        return Calibration(
            sign=self.sign,
            sensor_in_hand=np.array(self.sensor_in_hand_wxyz),
            sensor_in_hand_std=np.array(self.sensor_in_hand_std_rad),
            bias=np.array([*self.bias_force_N, *self.bias_torque_Nm]),
            bias_std=np.array([*self.bias_force_std_N, *self.bias_torque_std_Nm]),
            mass=self.tool_mass_kg,
            mass_std=self.tool_mass_std_kg,
            com=np.array(self.tool_com_m),
            com_std=np.array(self.tool_com_std_m),
            misfit=self.misfit,
            poses=self.poses,
            gain=np.array(self.gain),
            gain_std=np.array(self.gain_std),
            bias_walk=np.array(self.bias_walk),
            gravity=self.gravity,
        )


class HandEyeFile(BaseModel):
    """File of a tracker's calibration, SI units; `HandEye` explains the fields."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    made: str
    """Date, in any format."""
    tracker_in_base_m: Vector
    tracker_in_base_wxyz: Quaternion
    residual_m: NonNegative
    standard_error_m: NonNegative


def save_calibration(path: Path, calibration: Calibration, sensor: str, made: str) -> None:
    """Write a sensor's calibration atomically; `sensor`: serial number, `made`: date.

    Raises:
        InvalidFileError: values that `load_calibration` refuses; a line for each error.
    """
    c = calibration
    scaled = c.gain_std.any() or (c.gain != 1).any()
    fields = {
        "sensor": sensor,
        "made": made,
        "sign": c.sign,
        "sensor_in_hand_wxyz": c.sensor_in_hand.tolist(),
        "sensor_in_hand_std_rad": c.sensor_in_hand_std.tolist(),
        "bias_force_N": c.bias[:3].tolist(),
        "bias_force_std_N": c.bias_std[:3].tolist(),
        "bias_torque_Nm": c.bias[3:].tolist(),
        "bias_torque_std_Nm": c.bias_std[3:].tolist(),
        "tool_mass_kg": c.mass,
        "tool_mass_std_kg": c.mass_std,
        "tool_com_m": c.com.tolist(),
        "tool_com_std_m": c.com_std.tolist(),
        "misfit": c.misfit,
        "poses": c.poses,
        **({"gain": c.gain.tolist(), "gain_std": c.gain_std.tolist()} if scaled else {}),
        **({"bias_walk": c.bias_walk.tolist()} if c.bias_walk.any() else {}),
        **({"gravity": c.gravity} if c.gravity != GRAVITY else {}),
    }
    fitted(path, fields, CalibrationFile)
    write_text(path, toml_text(fields))


def load_calibration(path: Path, sensor: str | None = None) -> Calibration:
    """Load a sensor's calibration; `sensor`: serial number of the sensor in use, if known.

    Raises:
        InvalidFileError: not a calibration file, or values out of range; a line for each error.
        InvalidValueError: a calibration of another sensor.
    """
    file = load_toml(path, CalibrationFile)
    if sensor is not None and "unknown" not in (sensor, file.sensor) and sensor != file.sensor:
        raise InvalidValueError("sensor", file.sensor, f"{sensor}, which is plugged in; calibrate it", file=path)
    return file.calibration()


def save_hand_eye(path: Path, found: HandEye, made: str) -> None:
    """Write a tracker's calibration atomically; `made`: date."""
    fields = {
        "made": made,
        "tracker_in_base_m": found.tracker_in_base.position.tolist(),
        "tracker_in_base_wxyz": found.tracker_in_base.orientation.tolist(),
        "residual_m": found.residual,
        "standard_error_m": found.standard_error,
    }
    write_text(path, toml_text(fields))


def load_hand_eye(path: Path) -> HandEye:
    """Load a tracker's calibration.

    Raises:
        InvalidFileError: not such a file, or values out of range.
    """
    file = load_toml(path, HandEyeFile)
    pose = Pose(np.array(file.tracker_in_base_m), np.array(file.tracker_in_base_wxyz))
    return HandEye(pose, file.residual_m, file.standard_error_m)
