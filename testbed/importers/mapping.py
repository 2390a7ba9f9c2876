"""Schema of a mapping file: the columns of its logs, and the object and action that each records."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Field, model_validator

from testbed.actions.base import KINDS, Action, action_from_dict
from testbed.errors import InvalidValueError, nearest
from testbed.importers.columns import CameraMap, Columns, JointMap, Table, Text, ToolMap, VelocityMap
from testbed.objects.model import ROBOTIQ_2F85, Hand, ObjectShape
from testbed.toml import Finite, NonNegative, Positive
from testbed.trajectory import Phase
from testbed.worlds.presets import UNSTATED, StatedSetup


class PhaseWindow(Table):
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

    action: Action
    """The action, by grasp 0 if it has a name."""
    grasp_name: str = ""
    """Name of the grasp; empty where it has a number."""

    def on(self, shape: ObjectShape, hand: Hand = ROBOTIQ_2F85) -> Action:
        """The action on an object, whose grasps are those of a hand.

        Raises:
            InvalidValueError: the object has no such grasp, or a push that does not meet it.
        """
        if self.action.grasp is None:
            self.action.face(shape)
            return self.action
        names, given = [g.name for g in shape.grasps], self.grasp_name or self.action.grasp
        if self.grasp_name in names:
            return replace(self.action, grasp=names.index(self.grasp_name))
        if self.grasp_name or self.action.grasp >= len(names):
            listed = ", ".join(f"{i} ({name})" for i, name in enumerate(names)) or f"none: {hand.nothing}"
            raise InvalidValueError("action.grasp", given, f"{listed}{nearest(str(given), names)}")
        return self.action


def _mapped_action(table: dict[str, Any]) -> MappedAction:
    name = table.get("grasp") if isinstance(table, dict) and isinstance(table.get("grasp"), str) else ""
    on_table = [known for known, action in KINDS.items() if action.on_table]
    if isinstance(table, dict) and table.get("kind") not in on_table:  # a log holds a motion over the table
        raise InvalidValueError("kind", table.get("kind"), f"one of {', '.join(on_table)}")
    return MappedAction(action_from_dict(table | {"grasp": 0} if name else table), str(name))


_WITHIN = re.compile(r"(\S+) s to (?:(\S+) s|its end)$")
"""Times at the end of `LogMap.stretch`."""
Windows = Annotated[list[PhaseWindow], AfterValidator(_in_order)]
RecordedAction = Annotated[MappedAction, BeforeValidator(_mapped_action)]


class LogMap(Table):
    """One [[logs]] table: a log or a stretch of it, and its differences from the rest of the file."""

    file: Text
    from_s: NonNegative = 0.0
    to_s: Positive | None = None
    where: dict[Text, Finite] = Field(default={})
    sensor_file: Text | None = None
    camera_files: list[Text] | None = None
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
        within = [f"{self.from_s:g} s to {end}"] if self.from_s or self.to_s else []
        return ", ".join([*(f"{name} {value:g}" for name, value in self.where.items()), *within])

    @property
    def moved(self) -> tuple[float, float]:
        """Begin and end of the motion by its phases, or else of the whole stretch [s]."""
        steady = [window for window in self.phases or () if window.kind == Phase.STEADY]
        if steady:
            return steady[0].from_s, steady[-1].to_s
        return self.from_s, math.inf if self.to_s is None else self.to_s


def moved_as_stored(source: dict[str, Any]) -> tuple[float, float]:
    """Begin and end of the motion [s] of a stored trial, as `LogMap.moved`, by its mapping and its stretch in words."""
    steady = [window for window in source["mapping"].get("phases", ()) if window["phase"] == "steady"]
    if steady:
        return steady[0]["from_s"], steady[-1]["to_s"]
    within = _WITHIN.search(source.get("stretch", ""))
    return (float(within[1]), float(within[2] or math.inf)) if within else (0.0, math.inf)


class Mapping(Columns):
    """A mapping file."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    object: Text
    action: RecordedAction | None = None
    tool: ToolMap
    setup: StatedSetup = UNSTATED
    velocity: VelocityMap | None = None
    joints: JointMap | None = None
    camera: CameraMap | None = None
    phases: Windows = Field(default=[])
    logs: list[LogMap] = Field(default=[])

    def entries(self, log: Path, folder: Path) -> list[LogMap]:
        """The [[logs]] tables of a log in their order, or one of the whole log; `folder` is the mapping file's.

        Raises:
            InvalidValueError: two of them name the same stretch.
        """
        named = [entry for entry in self.logs if (folder / entry.file).resolve() == log.resolve()]
        for earlier, later in pairwise(sorted(named, key=lambda entry: (sorted(entry.where.items()), entry.moved))):
            if earlier.where == later.where and later.moved[0] < earlier.moved[1] - 1e-9:
                given = ", ".join(filter(None, (later.file, later.stretch)))
                allowed = (
                    "each stretch (from_s, to_s) of a file once: a trial is one, tare to release; another [[logs]] "
                    f"has {earlier.stretch or 'the whole file'}; heft import --find finds them"
                )
                raise InvalidValueError("logs.file", given, allowed)
        return named or [LogMap(file=str(log))]

    def for_entry(self, own: LogMap) -> Mapping:
        """Mapping of one trial."""
        changes: dict[str, Any] = {"action": own.action, "phases": own.phases, "where": self.where | own.where}
        if own.sensor_file is not None:
            changes["sensor"] = self.sensor.model_copy(update={"file": own.sensor_file})
        if own.camera_files is not None:
            parts = [] if self.camera is None else self.camera.parts
            if len(own.camera_files) != len(parts):
                raise InvalidValueError("logs.camera_files", own.camera_files, f"a file for each of {len(parts)} parts")
            files = [part.model_copy(update={"file": f}) for part, f in zip(parts, own.camera_files, strict=True)]
            changes["camera"] = self.camera and self.camera.model_copy(update={"parts": files})
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
