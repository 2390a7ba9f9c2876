"""Actions: motions of the object, not how the robot makes them. Angles in rad, SI units, object frame.

A new action is a module with a subclass of `Action` (or of `TableAction`), and its name in `testbed.actions`.
"""

from __future__ import annotations

from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.actions.path import WORKSPACE, Profile, Steady, ToolPath, motion_time
from testbed.errors import InvalidValueError
from testbed.frames import pose_from_point, rotation_2d, transform_point
from testbed.objects.model import ObjectShape
from testbed.validation import check_integer, is_number

KINDS: dict[str, type[Action]] = {}
"""Every action by the name that files give it."""


class ActionWords(NamedTuple):
    """An action in words, for tables and titles."""

    name: str
    """Verb, such as "turn"."""
    about: str = ""
    """Center of a turn that has one of its own, mm, object frame."""
    manner: str = ""
    """Direction, speed, or times."""


@dataclass(frozen=True)
class Action:
    """Base of all actions."""

    kind: ClassVar[str] = ""
    """Name in files: "rotate", "accelerate", "slide", "push", "lift" or "weigh"."""
    moves: ClassVar[bool] = True
    """False if nothing moves: the object lies on a scale."""
    on_table: ClassVar[bool] = False
    """True if the object moves over the table, under friction."""
    in_air: ClassVar[bool] = False
    """True if the object leaves the table."""
    turns: ClassVar[bool] = False
    """True if the object turns about a vertical axis on the table."""
    accelerated: ClassVar[bool] = False
    """True if the steady stretches on the table are at constant acceleration, False if at constant speed."""

    grasp: int | None
    """Index into the shape's grasps; None for a scale, and for a push."""

    def __init_subclass__(cls, kind: str = "") -> None:
        """Register an action by its name in files; a base class of several actions has none."""
        if kind:
            cls.kind = kind
            KINDS[kind] = cls

    def __post_init__(self) -> None:
        if self.moves:
            check_integer(self._field("grasp"), self.grasp, least=0)  # pyright: ignore[reportArgumentType]

    @property
    def seconds(self) -> float:
        """Duration of the motion, from rest to rest [s]."""
        raise NotImplementedError

    def accelerates(self, segment: int) -> bool:
        """True if the steady stretch `segment` (from 0) is at constant acceleration, not at rest or constant speed."""
        return self.accelerated

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        raise NotImplementedError

    def describe(self, shape: ObjectShape) -> str:
        """Sentence of the whole action."""
        name, about, manner = self.words(shape)
        if self.grasp is not None:
            known = self.grasp < len(shape.grasps)
            name += f" at {shape.grasps[self.grasp].name if known else f'grasp {self.grasp}'}"
        return ", ".join(filter(None, (f"{name} about {about} mm" if about else name, manner)))

    def to_dict(self) -> dict[str, Any]:
        """The action as plain data, with its kind; `action_from_dict` is the inverse."""
        return {"kind": self.kind, **asdict(self)}

    def _field(self, name: str) -> str:
        return f"{type(self).__name__}.{name}"

    def _check_nonzero(self, name: str) -> None:
        if not (is_number(value := getattr(self, name)) and value != 0):
            raise InvalidValueError(self._field(name), value, "a finite number other than 0")


@dataclass(frozen=True)
class TableAction(Action):
    """An action that moves the object over the table along a circle or a straight line."""

    on_table: ClassVar[bool] = True

    grasp: int
    """Index into the shape's grasps."""

    @property
    def steady(self) -> tuple[Steady, ...]:
        """Stretches of constant speed or acceleration, in order: what estimators see of the action."""
        raise NotImplementedError

    @property
    def heading(self) -> Float[np.ndarray, "2"]:
        """Unit vector of a slide's direction, object frame; zero for a turn."""
        return np.zeros(2)

    def center(self, shape: ObjectShape) -> Float[np.ndarray, "2"]:
        """Center of a turn [m], object frame; the grasp point unless the action says otherwise."""
        return shape.grasps[self.grasp].position

    @property
    def seconds(self) -> float:
        """Duration of the motion, from rest to rest [s]."""
        return motion_time(self.steady)

    def profile(self, step: float) -> Profile:
        """Progress along the path, sampled every `step` s."""
        return Profile.through(self.steady, step)

    def centered_path(self, shape: ObjectShape, length: float, middle: tuple[float, float] = WORKSPACE) -> ToolPath:
        """Path of `length` [rad or m] whose middle has the TCP at `middle` [m, world], the pads closing along x."""
        yaw, at, center = -shape.grasps[self.grasp].angle, np.array(middle), self.center(shape)
        if self.turns:
            grasp = shape.grasps[self.grasp].position
            at = transform_point(pose_from_point(at, grasp, np.array(yaw)), center)
        return self._path(shape, length, at, yaw, rotation_2d(yaw) @ self.heading)

    def path_from(self, shape: ObjectShape, length: float, pose: Float[np.ndarray, "3"]) -> ToolPath:
        """Path of `length` [rad or m] that starts where the object lies: planar pose [m, m, rad], world."""
        path = self._path(shape, length, np.zeros(2), 0.0, self.heading)
        yaw = float(pose[2]) + path.turn / 2
        slide = rotation_2d(yaw) @ path.slide
        at = transform_point(np.asarray(pose, dtype=float), path.pivot) + slide / 2
        return ToolPath(path.grasp, path.grasp_angle, path.pivot, at, yaw, path.turn, slide)

    def _path(self, shape: ObjectShape, length: float, at: np.ndarray, yaw: float, heading: np.ndarray) -> ToolPath:
        grasp = shape.grasps[self.grasp]
        turn = float(np.copysign(length, self.steady[0].speed)) if self.turns else 0.0
        return ToolPath(grasp.position, grasp.angle, self.center(shape), at, yaw, turn, length * heading)


def action_from_dict(data: dict[str, Any]) -> Action:
    """Action from plain data: the inverse of `Action.to_dict`.

    Raises:
        InvalidValueError: unknown kind or field, or a value out of range.
    """
    if not isinstance(data, dict):
        raise InvalidValueError("action", data, "a table with a kind and its fields")
    rest = dict(data)
    kind = KINDS.get(str(rest.pop("kind", None)))
    if kind is None:
        raise InvalidValueError("action.kind", data.get("kind"), f"one of {', '.join(KINDS)}")
    known = {f.name for f in fields(kind)}
    if unknown := sorted(set(rest) - known):
        raise InvalidValueError("action", unknown, f"fields {', '.join(sorted(known))}")
    missing = sorted(f.name for f in fields(kind) if f.default is MISSING and f.name not in rest)
    if missing:
        raise InvalidValueError("action", data, f"fields {', '.join(missing)} as well")
    return kind(**rest)
