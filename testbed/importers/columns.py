"""Schema of a log's columns or messages: their quantities, units and frames."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.importers.logs import factor
from testbed.objects.files import Side
from testbed.objects.model import GRAVITY, ROBOTIQ_2F85, Hand
from testbed.sensing.camera import CAMERAS
from testbed.sensing.presets import preset
from testbed.toml import Finite, NonNegative, Positive

ISO = "iso"
"""Unit of a table's times that are dates by ISO 8601."""


def _unit_quaternion(wxyz: list[float]) -> list[float]:
    if not 0.999 < sum(q * q for q in wxyz) < 1.001:
        raise InvalidValueError("", wxyz, "a unit quaternion, wxyz")
    return wxyz


def _unit_of(quantity: str, *others: str) -> AfterValidator:
    def check(unit: str) -> str:
        if unit not in others:
            factor(quantity, unit)
        return unit

    return AfterValidator(check)


AngleUnit = Annotated[str, _unit_of("angle")]
Text = Annotated[str, Field(min_length=1)]
Cell = Text | Finite
"""Column by name, or a constant."""
Three = Annotated[list[Cell], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
UnitQuaternion = Annotated[list[Finite], Field(min_length=4, max_length=4), AfterValidator(_unit_quaternion)]
OrientationAs = Literal["wxyz", "xyzw", "rotation_vector", "roll_pitch_yaw", "yaw", "matrix"]
_COLUMNS = {"wxyz": 4, "xyzw": 4, "rotation_vector": 3, "roll_pitch_yaw": 3, "yaw": 1, "matrix": 9}
"""Number of columns of an orientation in each representation."""


class Table(BaseModel):
    """Base of the tables: known fields alone, frozen."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class TimeMap(Table):
    """The [time] table."""

    column: Text | None = None
    unit: Annotated[str, _unit_of("time", ISO)] = "s"


class SensorMap(Table):
    """The [sensor] table."""

    file: Text | None = None
    topic: Text | None = None
    time: TimeMap | None = None
    delay_s: Finite | None = None
    force: Three | None = None
    torque: Three | None = None
    axes: Literal["sensor", "base"] = "sensor"
    torque_about: Literal["sensor", "tcp"] = "sensor"
    force_unit: Annotated[str, _unit_of("force")] = "N"
    torque_unit: Annotated[str, _unit_of("torque")] = "N m"
    calibration: Text | None = None
    zeroed: bool = False
    sign: Literal[1, -1] = 1
    in_hand_wxyz: UnitQuaternion = [1.0, 0.0, 0.0, 0.0]
    bias_std_N: NonNegative = preset("ft300s").force_bias
    bias_std_Nm: NonNegative = preset("ft300s").torque_bias
    drift_std_N: NonNegative = preset("ft300s").force_drift
    drift_std_Nm: NonNegative = preset("ft300s").torque_drift

    @model_validator(mode="after")
    def _has_all_columns(self) -> Self:
        if (self.force is None) != (self.torque is None):
            raise InvalidValueError("force, torque", [self.force, self.torque], "columns of both, or of neither")
        return self

    @property
    def measured(self) -> list[bool]:
        """True for each component of the wrench that is a column, False for a constant."""
        return [not isinstance(cell, float) for cell in [*(self.force or [""] * 3), *(self.torque or [""] * 3)]]


class PoseMap(Table):
    """Columns, messages or frame of a pose."""

    topic: Text | None = None
    frame: Text | None = None
    base: Text | None = None
    position: Annotated[list[Cell], Field(min_length=2, max_length=3)] | None = None
    position_unit: Annotated[str, _unit_of("length")] = "m"
    orientation: Annotated[list[Cell], Field(min_length=1, max_length=9)] | None = None
    orientation_as: OrientationAs = "wxyz"
    angle_unit: AngleUnit = "rad"

    @model_validator(mode="after")
    def _has_all_parts(self) -> Self:
        parts = _COLUMNS[self.orientation_as]
        if (self.position is None) != (self.orientation is None):
            given = [self.position, self.orientation]
            raise InvalidValueError("position, orientation", given, "columns of both, or of neither")
        if self.orientation is not None and len(self.orientation) != parts:
            many = f"{parts} column{'s'[: parts > 1]}"
            raise InvalidValueError("orientation", self.orientation, f"{many} for {self.orientation_as}")
        if self.position is not None and (len(self.position) == 2) != (self.orientation_as == "yaw"):
            raise InvalidValueError("position", self.position, 'x, y and z; x and y with orientation_as = "yaw"')
        return self


class HandMap(PoseMap):
    """The [hand] table."""

    urdf: Text | None = None
    base_wxyz: UnitQuaternion = [1.0, 0.0, 0.0, 0.0]
    tcp_in_hand_m: Vector = [0.0, 0.0, 0.0]
    closing_deg: Finite = 0.0
    table_height_m: Finite = 0.0
    stroke_m: Side = ROBOTIQ_2F85.stroke
    finger_width_m: Side = ROBOTIQ_2F85.finger_width

    @property
    def upright(self) -> Rotation:
        """Orientation of the base frame in axes with z up."""
        return Rotation.from_quat(self.base_wxyz, scalar_first=True)

    @property
    def size(self) -> Hand:
        """Size of the hand, which limits the rows of blocks that it can grip."""
        return Hand(self.stroke_m, self.finger_width_m)

    @model_validator(mode="after")
    def _points_down(self) -> Self:
        if self.orientation_as == "yaw":
            allowed = ", ".join(name for name in _COLUMNS if name != "yaw")
            raise InvalidValueError(
                "orientation_as", "yaw", f"{allowed}: a hand's yaw alone does not determine its tilt"
            )
        return self


class PartMap(PoseMap):
    """One [[camera.parts]] table: the poses of one link, or of a rigid object."""

    file: Text | None = None
    time: TimeMap | None = None
    object_m: Vector = [0.0, 0.0, 0.0]
    object_wxyz: UnitQuaternion = [1.0, 0.0, 0.0, 0.0]


_CAMERA = CAMERAS["30hz"]


class CameraMap(Table):
    """The [camera] table."""

    parts: Annotated[list[PartMap], Field(min_length=1)]
    in_base_m: Vector = [0.0, 0.0, 0.0]
    in_base_wxyz: UnitQuaternion = [1.0, 0.0, 0.0, 0.0]
    position_std_m: NonNegative = _CAMERA.position
    angle_std_deg: NonNegative = math.degrees(_CAMERA.angle)
    delay_s: Finite = round(sum(_CAMERA.delay) / 2, 4)
    delay_std_s: NonNegative = round(_CAMERA.delay_std, 4)


class VelocityMap(Table):
    """The [velocity] table: TCP velocity, base axes; without it the pose is differentiated."""

    topic: Text | None = None
    linear: Three
    angular: Three
    linear_unit: Annotated[str, _unit_of("speed")] = "m/s"
    angular_unit: Annotated[str, _unit_of("turn rate")] = "rad/s"


class JointMap(Table):
    """The [joints] table."""

    topic: Text | None = None
    position: Annotated[list[Text], Field(min_length=7, max_length=7)]
    unit: AngleUnit = "rad"


class ToolMap(Table):
    """The [tool] table."""

    mass_kg: NonNegative
    com_m: Vector
    inertia_kg_m2: Annotated[list[Vector], Field(min_length=3, max_length=3)]
    tcp_m: Vector


class Columns(Table):
    """Part of a mapping file that describes the columns; a calibration reads no other."""

    model_config = ConfigDict(extra="ignore", frozen=True, strict=True)

    separator: Text = ","
    decimal: Literal[".", ","] = "."
    comment: str = "#"
    header: bool = True
    longest_gap_s: Positive = 0.1
    rows: Literal["samples", "poses"] = "samples"
    where: dict[Text, Finite] = Field(default={})
    gravity: Annotated[float, Field(ge=9.7, le=9.9)] = GRAVITY
    time: TimeMap = TimeMap()
    sensor: SensorMap
    hand: HandMap

    @model_validator(mode="after")
    def _separates_columns(self) -> Self:
        if self.separator == self.decimal:
            raise InvalidValueError("separator", self.separator, "another character than that of decimals")
        return self
