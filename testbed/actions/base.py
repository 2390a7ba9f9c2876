"""Actions: motions of the object, independent of the robot. Angles in rad, SI units, object frame.

A new action is a module with a subclass of `TableAction`, `Push` or `Action`, and its name in `testbed.actions`:
simulation, robot, importers, planners and figures use its path, its hand and its fingertip.
"""

from __future__ import annotations

import math
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any, ClassVar, NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.actions.path import WORKSPACE, PlanarPath, Profile, Steady, ToolPath, motion_time
from testbed.errors import InvalidValueError
from testbed.frames import pose_from_point, rotation_2d, transform_point
from testbed.objects.faces import Face
from testbed.objects.model import ObjectShape
from testbed.validation import check_integer, is_number

_TURN, _LINE = math.radians(10), 0.025
"""Greatest distance between the knots of a turn [rad], and of a slide [m]."""
KINDS: dict[str, type[Action]] = {}
"""Actions by their names in files."""


class ActionWords(NamedTuple):
    """An action in words, for tables and titles."""

    name: str
    """Verb, such as "turn"."""
    about: str = ""
    """Center of a turn at constant speed, mm, object frame; else empty."""
    manner: str = ""
    """Direction, speed, or times."""


class Fingertip(NamedTuple):
    """Round fingertip of a closed hand, on a peg below the pads."""

    radius: float
    """Radius [m]."""
    friction: float
    """Friction against the faces of the object."""
    height: float
    """Height of its middle over the table [m]."""


@dataclass(frozen=True)
class Action:
    """Base of all actions."""

    kind: ClassVar[str] = ""
    """Name in files: "rotate", "accelerate", "slide", "push", "lift" or "weigh"."""
    moves: ClassVar[bool] = True
    """False if nothing moves: the object lies on a scale."""
    pushes: ClassVar[bool] = False
    """True if a fingertip moves the object, which is free; False if the pads hold it."""
    on_table: ClassVar[bool] = False
    """True if the object moves over the table, under friction."""
    in_air: ClassVar[bool] = False
    """True if the object leaves the table."""
    turns: ClassVar[bool] = False
    """True if predictions and checks of logs take the motion on the table as a turn about a vertical axis through
    `center`; False for a straight line along `heading`."""
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
            object.__setattr__(self, "grasp", check_integer(self._field("grasp"), self.grasp, least=0))

    @property
    def dragged(self) -> bool:
        """True if the pads move the object over the table."""
        return self.on_table and not self.pushes

    @property
    def dragged_steadily(self) -> bool:
        """True if the pads move the object over the table at constant speed."""
        return self.dragged and not self.accelerated

    @property
    def steady(self) -> tuple[Steady, ...]:
        """Stretches of constant speed or acceleration over the table, in order."""
        return ()

    @property
    def heading(self) -> Float[np.ndarray, "2"]:
        """Unit vector of the direction of a slide, or of a push as it meets the object, object frame; else zero."""
        return np.zeros(2)

    @property
    def seconds(self) -> float:
        """Duration of the motion, from rest to rest [s]."""
        return motion_time(self.steady)

    def profile(self, step: float) -> Profile:
        """Progress along a path over the table, sampled every `step` s."""
        return Profile.through(self.steady, step)

    def center(self, shape: ObjectShape) -> Float[np.ndarray, "2"]:
        """Center of a turn, else the grasp point [m], object frame; of a push, the object's middle."""
        return np.zeros(2) if self.grasp is None else shape.grasps[self.grasp].position

    def hand(self, shape: ObjectShape) -> tuple[Float[np.ndarray, "2"], float]:
        """Place of the hand on the object at the start [m] and its closing direction [rad], object frame."""
        assert self.grasp is not None
        return shape.grasps[self.grasp].position, shape.grasps[self.grasp].angle

    def fingertip(self, shape: ObjectShape) -> Fingertip | None:
        """Fingertip that pushes an object; None where the pads hold it."""
        return None

    def face(self, shape: ObjectShape) -> Face | None:
        """Face that a fingertip meets; None where the pads hold the object.

        Raises:
            InvalidValueError: it meets none.
        """
        return None

    def check_start(self, shape: ObjectShape) -> None:
        """Refuse an action without room to begin.

        Raises:
            InfeasibleTrialError: no face there, or no room for a fingertip to come down.
        """

    def needs_camera(self, shape: ObjectShape) -> bool:
        """True if a body moves that the hand does not hold."""
        return self.on_table and (self.pushes or shape.chain is not None)

    def centered_pose(
        self, shape: ObjectShape, step: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Float[np.ndarray, "3"]:
        """Planar pose of the object at the start [m, m, rad], world, of an action about the middle of the workspace.

        The hand is over the middle, unless the action moves over the table.

        Args:
            shape: geometry of the object.
            step: time between ticks, s.
            shift: displacement from the middle and rotation about it, m, m, rad.
        """
        place, angle = self.hand(shape)
        return pose_from_point(np.array(WORKSPACE) + shift[:2], place, np.array(shift[2] - angle))

    def planar_path(self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float) -> PlanarPath:
        """Path of an object that the pads hold over its planar pose [m, m, rad], world; at rest unless it moves there.

        Args:
            shape: geometry of the object.
            pose: its pose at the start.
            step: time between ticks, s.
        """
        place, angle = self.hand(shape)
        return PlanarPath(place, angle, np.zeros(2), np.array(pose[:2]), float(pose[2]), 0.0, np.zeros(2))

    def tool_path(
        self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float, speed: float = math.inf
    ) -> ToolPath:
        """Path of the tool between grasp and release, on an object that starts at a planar pose [m, m, rad], world.

        Args:
            shape: geometry of the object.
            pose: its pose at the start.
            step: time between ticks, s.
            speed: greatest speed up and down, m/s.

        Raises:
            InvalidValueError: nothing moves.
            InfeasibleTrialError: a fingertip that meets no face.
        """
        raise InvalidValueError("action", self, "an action that moves the object")

    @property
    def pace(self) -> float:
        """Ratio of the contact time and the window length of a fast push to those of a slow one; else 1."""
        return 1.0

    @property
    def tilt_acceleration(self) -> float:
        """Angular acceleration of the rocking in the air [rad/s^2]."""
        return 0.0

    def accelerates(self, segment: int) -> bool:
        """True if the steady stretch `segment` (from 0) is at constant acceleration, not at rest or constant speed."""
        return self.accelerated

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        raise NotImplementedError

    def describe(self, shape: ObjectShape) -> str:
        """Action in one line, from `words`."""
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

    def centered_pose(
        self, shape: ObjectShape, step: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Float[np.ndarray, "3"]:
        """Planar pose of the object at the start of the centered path, after the shift [m, m, rad], world."""
        path = self.centered_path(shape, self.profile(step).length).shifted(shift, WORKSPACE)
        return path.object_pose(np.array([-0.5]))[0]

    def planar_path(self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float) -> PlanarPath:
        """Path of the object from a planar pose [m, m, rad], world."""
        return self.path_from(shape, self.profile(step).length, pose)

    def tool_path(
        self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float, speed: float = math.inf
    ) -> ToolPath:
        """Path of the tool, on an object that starts at a planar pose [m, m, rad], world."""
        profile = self.profile(step)
        path = self.path_from(shape, profile.length, pose)
        return ToolPath(step, profile.segment, (path.way(profile, _TURN if self.turns else _LINE),))

    def centered_path(self, shape: ObjectShape, length: float) -> PlanarPath:
        """Path of `length` [rad or m] whose middle has the TCP in the middle of the workspace, closing along x."""
        yaw, at, center = -shape.grasps[self.grasp].angle, np.array(WORKSPACE), self.center(shape)
        if self.turns:
            grasp = shape.grasps[self.grasp].position
            at = transform_point(pose_from_point(at, grasp, np.array(yaw)), center)
        return self._path(shape, length, at, yaw, rotation_2d(yaw) @ self.heading)

    def path_from(self, shape: ObjectShape, length: float, pose: Float[np.ndarray, "3"]) -> PlanarPath:
        """Path of `length` [rad or m] that starts where the object lies: planar pose [m, m, rad], world."""
        path = self._path(shape, length, np.zeros(2), 0.0, self.heading)
        yaw = float(pose[2]) + path.turn / 2
        slide = rotation_2d(yaw) @ path.slide
        at = transform_point(np.asarray(pose, dtype=float), path.pivot) + slide / 2
        return PlanarPath(path.grasp, path.grasp_angle, path.pivot, at, yaw, path.turn, slide)

    def _path(self, shape: ObjectShape, length: float, at: np.ndarray, yaw: float, heading: np.ndarray) -> PlanarPath:
        grasp = shape.grasps[self.grasp]
        turn = float(np.copysign(length, self.steady[0].speed)) if self.turns else 0.0
        return PlanarPath(grasp.position, grasp.angle, self.center(shape), at, yaw, turn, length * heading)


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
