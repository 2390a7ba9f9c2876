"""A calibration as a TOML file, written by `save_calibration` and fit to be read and corrected by hand."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from testbed.errors import InvalidValueError
from testbed.objects.files import Finite, NonNegative, Positive, load_toml
from testbed.robot.calibration.static_poses import Calibration
from testbed.trajectory import write_whole

Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Deviations = Annotated[list[NonNegative], Field(min_length=3, max_length=3)]


class CalibrationFile(BaseModel):
    """All that a calibration found, SI units; see `Calibration` for what each field means."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    sensor: str
    """Serial number of the sensor, or "unknown"."""
    made: str
    """When, in words or as a date."""
    sign: Literal[1, -1]
    sensor_in_hand_wxyz: Annotated[list[Finite], Field(min_length=4, max_length=4)]
    sensor_in_hand_std_rad: Deviations
    bias_force_N: Vector
    bias_force_std_N: Deviations
    bias_torque_Nm: Vector
    bias_torque_std_Nm: Deviations
    tool_mass_kg: Positive
    tool_mass_std_kg: Positive
    tool_com_m: Vector
    tool_com_std_m: Deviations
    misfit: NonNegative
    poses: Annotated[int, Field(ge=4)]

    @model_validator(mode="after")
    def _makes_a_calibration(self) -> Self:
        self.calibration()
        return self

    def calibration(self) -> Calibration:
        """The calibration itself."""
        return Calibration(
            sign=self.sign,
            sensor_in_hand=self.sensor_in_hand_wxyz,  # pyright: ignore[reportArgumentType]
            sensor_in_hand_std=self.sensor_in_hand_std_rad,  # pyright: ignore[reportArgumentType]
            bias=[*self.bias_force_N, *self.bias_torque_Nm],  # pyright: ignore[reportArgumentType]
            bias_std=[*self.bias_force_std_N, *self.bias_torque_std_Nm],  # pyright: ignore[reportArgumentType]
            mass=self.tool_mass_kg,
            mass_std=self.tool_mass_std_kg,
            com=self.tool_com_m,  # pyright: ignore[reportArgumentType]
            com_std=self.tool_com_std_m,  # pyright: ignore[reportArgumentType]
            misfit=self.misfit,
            poses=self.poses,
        )


def save_calibration(path: Path, calibration: Calibration, sensor: str, made: str) -> None:
    """Write a calibration, whole or not at all.

    Args:
        path: where to.
        calibration: what was found.
        sensor: serial number of the sensor.
        made: when, as a date.
    """
    c = calibration
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
    }
    text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in fields.items())
    write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def load_calibration(path: Path, sensor: str | None = None) -> Calibration:
    """Read a calibration back.

    Args:
        path: the file.
        sensor: serial number of the sensor that is to be used with it, where known.

    Raises:
        InvalidFileError: not such a file, or values out of range; a line for each error.
        InvalidValueError: made with another sensor.
    """
    file = load_toml(path, CalibrationFile)
    if sensor is not None and "unknown" not in (sensor, file.sensor) and sensor != file.sensor:
        raise InvalidValueError("sensor", file.sensor, f"{sensor}, which is plugged in; calibrate it", file=path)
    return file.calibration()
