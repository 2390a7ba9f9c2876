"""The mapping file: which columns of a log are what, and in which unit.

object = "L2"                        # a library name or a file, as in a scenario
action = { kind = "rotate", grasp = 1, speed = 0.1745, duration = 18.0, back = true }   # as done; rad/s and s

[time]
column = "t"                         # of an MCAP: "log_time", "publish_time", or a field of the messages
unit = "ms"

[sensor]
topic = "/ft"                        # of an MCAP; likewise below
force = ["fx", "fy", "fz"]           # fields of a message with dots: "wrench.force.x"
torque = ["tx", "ty", "tz"]
force_unit = "N"
torque_unit = "N m"
sign = -1                            # where the sensor reports what the tool does to the arm
in_hand_wxyz = [1, 0, 0, 0]          # how it sits on the hand

[hand]                               # the frame whose pose the arm reports
position = ["x", "y", "z"]           # in the arm's base frame, z up
position_unit = "mm"
orientation = ["qw", "qx", "qy", "qz"]
orientation_as = "wxyz"              # or xyzw, rotation_vector, roll_pitch_yaw
tcp_in_hand_m = [0, 0, 0.12]         # where the hand is not the TCP
closing_deg = 0                      # direction of the pads' closing, from the hand's x axis about its z axis
table_height_m = 0.0                 # of the table in the base frame

[tool]                               # what hangs below the sensor, sensor frame
mass_kg = 0.925
com_m = [0, 0, 0.06]
inertia_kg_m2 = [[0.003, 0, 0], [0, 0.003, 0], [0, 0, 0.0006]]
tcp_m = [0, 0, 0.174]

[joints]                             # optional
position = ["q1", "q2", "q3", "q4", "q5", "q6", "q7"]
unit = "deg"

[[phases]]                           # optional: found from the motion of a turn or a slide
phase = "tare"                       # tare and steady at least; s from the log's first sample
from_s = 0.2
to_s = 1.0
"""

from __future__ import annotations

from typing import Annotated, Any, Literal, Self

from pydantic import BaseModel, ConfigDict, Field, model_validator

from testbed.actions import Accelerate, Rotate, Slide, action_from_dict
from testbed.errors import InvalidValueError
from testbed.lab_logs.units import AngleUnit, ForceUnit, LengthUnit, SpeedUnit, TimeUnit, TorqueUnit, TurnRateUnit
from testbed.object_files import Finite, NonNegative, Positive
from testbed.sensing import preset
from testbed.trajectory import Phase

Text = Annotated[str, Field(min_length=1)]
Three = Annotated[list[Text], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Finite], Field(min_length=4, max_length=4)]
OrientationAs = Literal["wxyz", "xyzw", "rotation_vector", "roll_pitch_yaw"]
_STRICT = ConfigDict(extra="forbid", frozen=True)


class TimeMap(BaseModel):
    """The [time] table."""

    model_config = _STRICT

    column: Text = "log_time"
    unit: TimeUnit = "s"


class SensorMap(BaseModel):
    """The [sensor] table."""

    model_config = _STRICT

    topic: Text | None = None
    force: Three
    torque: Three
    force_unit: ForceUnit = "N"
    torque_unit: TorqueUnit = "N m"
    sign: Literal[1, -1] = 1
    in_hand_wxyz: Quaternion = [1.0, 0.0, 0.0, 0.0]
    bias_std_N: NonNegative = preset("ft300s").force_bias
    bias_std_Nm: NonNegative = preset("ft300s").torque_bias

    @model_validator(mode="after")
    def _turns(self) -> Self:
        if not 0.999 < sum(q * q for q in self.in_hand_wxyz) < 1.001:
            raise InvalidValueError("in_hand_wxyz", self.in_hand_wxyz, "a unit quaternion, wxyz")
        return self


class HandMap(BaseModel):
    """The [hand] table."""

    model_config = _STRICT

    topic: Text | None = None
    position: Three
    position_unit: LengthUnit = "m"
    orientation: Annotated[list[Text], Field(min_length=3, max_length=4)]
    orientation_as: OrientationAs = "wxyz"
    angle_unit: AngleUnit = "rad"
    tcp_in_hand_m: Vector = [0.0, 0.0, 0.0]
    closing_deg: Finite = 0.0
    table_height_m: Finite = 0.0

    @model_validator(mode="after")
    def _has_all_parts(self) -> Self:
        parts = 4 if self.orientation_as in ("wxyz", "xyzw") else 3
        if len(self.orientation) != parts:
            raise InvalidValueError("orientation", self.orientation, f"{parts} columns for {self.orientation_as}")
        return self


class VelocityMap(BaseModel):
    """The [velocity] table: of the TCP, base axes; without it the pose is differentiated."""

    model_config = _STRICT

    topic: Text | None = None
    linear: Three
    angular: Three
    linear_unit: SpeedUnit = "m/s"
    angular_unit: TurnRateUnit = "rad/s"


class JointMap(BaseModel):
    """The [joints] table."""

    model_config = _STRICT

    topic: Text | None = None
    position: Annotated[list[Text], Field(min_length=7, max_length=7)]
    unit: AngleUnit = "rad"


class ToolMap(BaseModel):
    """The [tool] table."""

    model_config = _STRICT

    mass_kg: NonNegative
    com_m: Vector
    inertia_kg_m2: Annotated[list[Vector], Field(min_length=3, max_length=3)]
    tcp_m: Vector


class PhaseWindow(BaseModel):
    """One [[phases]] table; steady ones are numbered in their order."""

    model_config = _STRICT

    phase: Literal["tare", "approach", "grasp", "settle", "ramp", "steady", "release"]
    from_s: NonNegative
    to_s: Positive

    @model_validator(mode="after")
    def _lasts(self) -> Self:
        if self.to_s <= self.from_s:
            raise InvalidValueError("to_s", self.to_s, f"more than from_s ({self.from_s:g})")
        return self

    @property
    def kind(self) -> Phase:
        """As a `Phase`."""
        return Phase[self.phase.upper()]


class Mapping(BaseModel):
    """A whole mapping file."""

    model_config = _STRICT

    object: Text
    action: dict[str, Any]
    separator: Text = ","
    longest_gap_s: Positive = 0.1
    time: TimeMap
    sensor: SensorMap
    hand: HandMap
    tool: ToolMap
    velocity: VelocityMap | None = None
    joints: JointMap | None = None
    phases: list[PhaseWindow] = []

    @model_validator(mode="after")
    def _does_something(self) -> Self:
        self.done()
        last = 0.0
        for window in self.phases:
            if window.from_s < last - 1e-9:
                raise InvalidValueError("phases", window.from_s, f"windows in order, from_s not before {last:g}")
            last = window.to_s
        return self

    def done(self) -> Rotate | Accelerate | Slide:
        """The action.

        Raises:
            InvalidValueError: not a turn or a slide, or out of range.
        """
        action = action_from_dict(self.action)
        if not isinstance(action, Rotate | Accelerate | Slide):
            raise InvalidValueError("action.kind", self.action.get("kind"), "rotate, accelerate or slide")
        return action
