"""Schema of a mapping file: the columns of a log, their units and frames, and the action they record."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from testbed.actions.base import TableAction, action_from_dict
from testbed.errors import InvalidValueError, nearest
from testbed.importers.logs import factor
from testbed.objects.files import Side
from testbed.objects.model import ROBOTIQ_2F85, Hand, ObjectShape
from testbed.sensing.presets import preset
from testbed.toml import Finite, NonNegative, Positive
from testbed.trajectory import Phase
from testbed.worlds.presets import StatedSetup
from testbed.worlds.setup_errors import EXACT_SETUP

ISO = "iso"
"""Unit of a table's times that are dates by ISO 8601."""


def _unit_of(quantity: str, *others: str) -> AfterValidator:
    def check(unit: str) -> str:
        if unit not in others:
            factor(quantity, unit)
        return unit

    return AfterValidator(check)


TimeUnit = Annotated[str, _unit_of("time", ISO)]
LengthUnit = Annotated[str, _unit_of("length")]
AngleUnit = Annotated[str, _unit_of("angle")]
SpeedUnit = Annotated[str, _unit_of("speed")]
TurnRateUnit = Annotated[str, _unit_of("turn rate")]
ForceUnit = Annotated[str, _unit_of("force")]
TorqueUnit = Annotated[str, _unit_of("torque")]
Text = Annotated[str, Field(min_length=1)]
Three = Annotated[list[Text], Field(min_length=3, max_length=3)]
Vector = Annotated[list[Finite], Field(min_length=3, max_length=3)]
Quaternion = Annotated[list[Finite], Field(min_length=4, max_length=4)]
OrientationAs = Literal["wxyz", "xyzw", "rotation_vector", "roll_pitch_yaw"]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class TimeMap(_Table):
    """The [time] table."""

    column: Text | None = None
    unit: TimeUnit = "s"


class SensorMap(_Table):
    """The [sensor] table."""

    file: Text | None = None
    topic: Text | None = None
    time: TimeMap | None = None
    delay_s: Finite | None = None
    force: Three | None = None
    torque: Three | None = None
    axes: Literal["sensor", "base"] = "sensor"
    force_unit: ForceUnit = "N"
    torque_unit: TorqueUnit = "N m"
    calibration: Text | None = None
    sign: Literal[1, -1] = 1
    in_hand_wxyz: Quaternion = [1.0, 0.0, 0.0, 0.0]
    bias_std_N: NonNegative = preset("ft300s").force_bias
    bias_std_Nm: NonNegative = preset("ft300s").torque_bias
    drift_std_N: NonNegative = preset("ft300s").force_drift
    drift_std_Nm: NonNegative = preset("ft300s").torque_drift

    @model_validator(mode="after")
    def _has_all_columns(self) -> Self:
        if (self.force is None) != (self.torque is None):
            raise InvalidValueError("force, torque", [self.force, self.torque], "columns of both, or of neither")
        return self

    @model_validator(mode="after")
    def _is_rotation(self) -> Self:
        if not 0.999 < sum(q * q for q in self.in_hand_wxyz) < 1.001:
            raise InvalidValueError("in_hand_wxyz", self.in_hand_wxyz, "a unit quaternion, wxyz")
        return self


class HandMap(_Table):
    """The [hand] table."""

    topic: Text | None = None
    frame: Text | None = None
    base: Text | None = None
    urdf: Text | None = None
    position: Three | None = None
    position_unit: LengthUnit = "m"
    orientation: Annotated[list[Text], Field(min_length=3, max_length=4)] | None = None
    orientation_as: OrientationAs = "wxyz"
    angle_unit: AngleUnit = "rad"
    tcp_in_hand_m: Vector = [0.0, 0.0, 0.0]
    closing_deg: Finite = 0.0
    table_height_m: Finite = 0.0
    stroke_m: Side = ROBOTIQ_2F85.stroke
    finger_width_m: Side = ROBOTIQ_2F85.finger_width

    @property
    def size(self) -> Hand:
        """Size of the hand, by which rows of blocks can be taken."""
        return Hand(self.stroke_m, self.finger_width_m)

    @model_validator(mode="after")
    def _has_all_parts(self) -> Self:
        parts = 4 if self.orientation_as in ("wxyz", "xyzw") else 3
        if (self.position is None) != (self.orientation is None):
            given = [self.position, self.orientation]
            raise InvalidValueError("position, orientation", given, "columns of both, or of neither")
        if self.orientation is not None and len(self.orientation) != parts:
            raise InvalidValueError("orientation", self.orientation, f"{parts} columns for {self.orientation_as}")
        return self


class VelocityMap(_Table):
    """The [velocity] table: TCP velocity, base axes; without it the pose is differentiated."""

    topic: Text | None = None
    linear: Three
    angular: Three
    linear_unit: SpeedUnit = "m/s"
    angular_unit: TurnRateUnit = "rad/s"


class JointMap(_Table):
    """The [joints] table."""

    topic: Text | None = None
    position: Annotated[list[Text], Field(min_length=7, max_length=7)]
    unit: AngleUnit = "rad"


class ToolMap(_Table):
    """The [tool] table."""

    mass_kg: NonNegative
    com_m: Vector
    inertia_kg_m2: Annotated[list[Vector], Field(min_length=3, max_length=3)]
    tcp_m: Vector


class PhaseWindow(_Table):
    """One [[phases]] table; steady ones are numbered in their order."""

    phase: Literal["tare", "approach", "grasp", "settle", "ramp", "steady", "release"]
    from_s: NonNegative
    to_s: Positive

    @model_validator(mode="after")
    def _ends_after_start(self) -> Self:
        if self.to_s <= self.from_s:
            raise InvalidValueError("to_s", self.to_s, f"more than from_s ({self.from_s:g})")
        return self

    @property
    def kind(self) -> Phase:
        return Phase[self.phase.upper()]


def _in_order(windows: list[PhaseWindow]) -> list[PhaseWindow]:
    last = 0.0
    for window in windows:
        if window.from_s < last - 1e-9:
            raise InvalidValueError("phases", window.from_s, f"windows in order, from_s not before {last:g}")
        last = window.to_s
    return windows


@dataclass(frozen=True)
class MappedAction:
    """An action whose grasp may be named."""

    action: TableAction
    """The action, by grasp 0 if it has a name."""
    grasp_name: str = ""
    """Name of the grasp; empty where it has a number."""

    def on(self, shape: ObjectShape, hand: Hand = ROBOTIQ_2F85) -> TableAction:
        """The action on an object, whose grasps are those of a hand.

        Raises:
            InvalidValueError: the object has no such grasp.
        """
        names, given = [g.name for g in shape.grasps], self.grasp_name or self.action.grasp
        if self.grasp_name in names:
            return replace(self.action, grasp=names.index(self.grasp_name))
        if self.grasp_name or self.action.grasp >= len(names):
            listed = ", ".join(f"{i} ({name})" for i, name in enumerate(names)) or f"none: {hand.nothing}"
            raise InvalidValueError("action.grasp", given, f"{listed}{nearest(str(given), names)}")
        return self.action


def _mapped_action(table: dict[str, Any]) -> MappedAction:
    name = table.get("grasp") if isinstance(table, dict) and isinstance(table.get("grasp"), str) else ""
    action = action_from_dict(table | {"grasp": 0} if name else table)
    if not isinstance(action, TableAction):  # a log holds a motion over the table
        raise InvalidValueError("kind", table.get("kind"), "rotate, accelerate or slide")
    return MappedAction(action, str(name))


Windows = Annotated[list[PhaseWindow], AfterValidator(_in_order)]
RecordedAction = Annotated[MappedAction, BeforeValidator(_mapped_action)]


class LogMap(_Table):
    """One [[logs]] table: a log or a stretch of it, and its differences from the rest of the file."""

    file: Text
    from_s: NonNegative = 0.0
    to_s: Positive | None = None
    sensor_file: Text | None = None
    closing_deg: Finite | None = None
    action: RecordedAction | None = None
    phases: Windows | None = None

    @model_validator(mode="after")
    def _ends_after_start(self) -> Self:
        if self.to_s is not None and self.to_s <= self.from_s:
            raise InvalidValueError("to_s", self.to_s, f"more than from_s ({self.from_s:g})")
        return self

    @property
    def stretch(self) -> str:
        """The stretch in words; empty of a whole log."""
        end = "its end" if self.to_s is None else f"{self.to_s:g} s"
        return f"{self.from_s:g} s to {end}" if self.from_s or self.to_s else ""

    @property
    def moved(self) -> tuple[float, float]:
        """Begin and end of the motion [s], by its phases, or else of the whole stretch."""
        steady = [window for window in self.phases or () if window.kind == Phase.STEADY]
        if steady:
            return steady[0].from_s, steady[-1].to_s
        return self.from_s, math.inf if self.to_s is None else self.to_s


class Columns(_Table):
    """The part of a mapping file that says which column is what; a calibration needs no more."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    separator: Text = ","
    decimal: Literal[".", ","] = "."
    comment: str = "#"
    longest_gap_s: Positive = 0.1
    time: TimeMap = TimeMap()
    sensor: SensorMap
    hand: HandMap

    @model_validator(mode="after")
    def _separates_columns(self) -> Self:
        if self.separator == self.decimal:
            raise InvalidValueError("separator", self.separator, "another character than that of decimals")
        return self


class Mapping(Columns):
    """A mapping file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    object: Text
    action: RecordedAction | None = None
    tool: ToolMap
    setup: StatedSetup = EXACT_SETUP
    velocity: VelocityMap | None = None
    joints: JointMap | None = None
    phases: Windows = []
    logs: list[LogMap] = []

    def entries(self, log: Path, folder: Path) -> list[LogMap]:
        """The [[logs]] tables of a log in their order, or one of the whole log; `folder` is the mapping file's.

        Raises:
            InvalidValueError: two of them name the same stretch.
        """
        named = [entry for entry in self.logs if (folder / entry.file).resolve() == log.resolve()]
        for earlier, later in pairwise(sorted(named, key=lambda entry: entry.moved)):
            if later.moved[0] < earlier.moved[1] - 1e-9:
                given = ", ".join(filter(None, (later.file, later.stretch)))
                allowed = (
                    "each stretch (from_s, to_s) of a file once: a trial is one, tare to release; another [[logs]] "
                    f"has {earlier.stretch or 'the whole file'}; heft import --find finds them"
                )
                raise InvalidValueError("logs.file", given, allowed)
        return named or [LogMap(file=str(log))]

    def entry(self, log: Path, folder: Path) -> LogMap:
        """The [[logs]] table of a log that is one trial.

        Raises:
            InvalidValueError: it has several.
        """
        found = self.entries(log, folder)
        if len(found) > 1:
            raise InvalidValueError("entry", None, f"one of the {len(found)} [[logs]] tables of {log}")
        return found[0]

    def for_entry(self, own: LogMap) -> Mapping:
        """Mapping of one trial."""
        changes: dict[str, Any] = {"action": own.action, "phases": own.phases}
        if own.sensor_file is not None:
            changes["sensor"] = self.sensor.model_copy(update={"file": own.sensor_file})
        if own.closing_deg is not None:
            changes["hand"] = self.hand.model_copy(update={"closing_deg": own.closing_deg})
        return self.model_copy(update={"logs": [], **{k: v for k, v in changes.items() if v is not None}})

    @property
    def separate(self) -> bool:
        """True if pose and wrench are separate streams, whose clocks may differ."""
        sensor = self.sensor
        return sensor.file is not None or sensor.time is not None or sensor.topic != self.hand.topic

    def recorded_action(self) -> MappedAction:
        """The action in the log.

        Raises:
            InvalidValueError: the file gives none.
        """
        if self.action is None:
            allowed = (
                'a table: { kind = "rotate", grasp = 1, ... }, for all logs or each; heft import --find finds those of '
                "a recording of several"
            )
            raise InvalidValueError("action", None, allowed)
        return self.action
