"""Pushes: a closed hand's round fingertip against the object's outline."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
from jaxtyping import Float

from testbed.actions.base import Action, ActionWords, Fingertip
from testbed.actions.path import (
    LEAST_KNOTS,
    RAMP_TIME,
    WORKSPACE,
    Profile,
    Steady,
    ToolPath,
    Way,
    level,
)
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.frames import pose_from_point, transform_point
from testbed.objects.faces import Face, face_at, room_at
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive_fields, frozen_array, is_number

GAP = 0.01
"""Least distance of the fingertip from the face at the start [m]."""
SPEEDS = (0.005, 0.2)
"""Least and greatest speed of a push [m/s]: slower ones stick, and after faster ones an object slides on."""
TIP_HEIGHT = 0.008
"""Height of the fingertip over the table, on a peg between the closed fingers [m]: a higher push would tilt light parts
off the table. A low object is pushed at half its height."""
LEAST_LENGTH = 0.03
"""Least length of a push [m]: a shorter one stops before it has data."""
SLOW = 0.05
"""Speed of a push up to which its `pace` is 1 [m/s]."""
LEAST_CONTACT = 1.0
"""Least contact time of a usable push, at a pace of 1 [s]."""
ON_FACE = 1e-4
"""Greatest distance of a push's point from the outline [m]."""
_SPACING = 0.01
"""Distance between the points of a path [m]."""
STEEPEST = math.radians(60)
"""Greatest angle between a push and the normal of the face that it meets [rad]."""


@dataclass(frozen=True)
class Push(Action, kind="push"):
    """Push with a round fingertip along a straight or a curved path, at constant speed; the object is free to turn.

    The hand closes on nothing and does not turn: the wrench is a force at a fingertip that sticks, slides or leaves.
    """

    pushes: ClassVar[bool] = True
    on_table: ClassVar[bool] = True
    grasp: ClassVar[None] = None  # pyright: ignore[reportIncompatibleVariableOverride]  no field of a push

    point: tuple[float, float]
    """Point of the outline that the fingertip meets [m], object frame."""
    direction: float
    """Direction of travel as it meets the object [rad], object frame."""
    curvature: float = 0.0
    """Curvature of the path, positive to the left [rad/m]."""
    speed: float = 0.03
    """Speed of the fingertip [m/s]."""
    length: float = 0.1
    """Length of the path from the first contact [m]."""
    radius: float = 0.006
    """Radius of the fingertip [m]."""
    friction: float = 0.4
    """Friction of the fingertip against the faces in a simulation; no method uses it."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "point", tuple(frozen_array("Push.point", self.point, (2,)).tolist()))
        check_positive_fields(self, "speed", "length", "radius", "friction")
        for name in ("direction", "curvature"):
            if not is_number(value := getattr(self, name)):
                raise InvalidValueError(f"Push.{name}", value, "a finite number")
        if not SPEEDS[0] <= self.speed <= SPEEDS[1]:
            raise InvalidValueError("Push.speed", self.speed, f"{SPEEDS[0]:g} to {SPEEDS[1]:g}, m/s")
        ramps = self.speed * RAMP_TIME - self.gap  # distance at less than full speed
        if self.length < LEAST_LENGTH or self.length <= ramps:
            allowed = f"at least {LEAST_LENGTH:g}, m, and at {self.speed:g} m/s more than {ramps:.3g}"
            raise InvalidValueError("Push.length", self.length, allowed)

    @classmethod
    def into(cls, face: Face, part: float = 0.5, angle: float = 0.0, curvature: float = 0.0) -> Self:
        """Push into a face at a part of its length, at an angle from its normal [rad].

        Raises:
            InvalidValueError: a part that is not from 0 to 1.
        """
        if not (is_number(part) and 0 <= part <= 1):
            raise InvalidValueError("Push.into.part", part, "0 to 1, from one end of the face to the other")
        x, y = face.begin + part * (face.end - face.begin)
        direction = math.atan2(-face.normal[1], -face.normal[0]) + angle
        return cls((float(x), float(y)), float(direction), float(curvature))

    @property
    def pace(self) -> float:
        """Ratio of the contact time and the window length to those of a slow push, over the same distance."""
        return min(SLOW / self.speed, 1.0)

    @property
    def gap(self) -> float:
        """Distance of the fingertip from the face at the start [m], enough to reach its speed."""
        return max(GAP, self.speed * RAMP_TIME / 2)

    @property
    def heading(self) -> Float[np.ndarray, "2"]:
        """Unit vector of the direction of travel as it meets the object, object frame."""
        return np.array([math.cos(self.direction), math.sin(self.direction)])

    @property
    def steady(self) -> tuple[Steady, ...]:
        """The stretch at constant speed."""
        return (Steady(self.speed, 0.0, (self.gap + self.length) / self.speed - RAMP_TIME),)

    def fingertip(self, shape: ObjectShape) -> Fingertip:
        """Fingertip, at the height of the push."""
        return Fingertip(self.radius, self.friction, min(TIP_HEIGHT, shape.height / 2))

    def hand(self, shape: ObjectShape) -> tuple[Float[np.ndarray, "2"], float]:
        """Point of the outline that the fingertip meets [m]; the hand does not turn."""
        return np.array(self.point), 0.0

    def face(self, shape: ObjectShape) -> Face:
        """The face that the fingertip meets.

        Raises:
            InvalidValueError: the point is not on the outline, or the path leads away from the face or along it.
        """
        face, away = face_at(shape, np.array(self.point))
        if away > ON_FACE:
            raise InvalidValueError("Push.point", self.point, f"a point of the outline, {away * 1e3:.1f} mm away")
        if -face.normal @ self.heading < math.cos(STEEPEST):
            within = f"within {math.degrees(STEEPEST):.0f} deg of the normal into the face"
            raise InvalidValueError("Push.direction", self.direction, within)
        return face

    def check_start(self, shape: ObjectShape) -> None:
        """Refuse a push without room for the fingertip beside the object.

        Raises:
            InfeasibleTrialError: no face there, or no room for the fingertip to come down.
        """
        gap = room_at(shape, self._tip_path(shape, np.zeros(1))[0])
        if gap < self.radius - 1e-9:
            raise InfeasibleTrialError(
                f"push: the fingertip would come down {max(gap, 0.0) * 1e3:.1f} mm from the object with its radius of "
                f"{self.radius * 1e3:.0f} mm; push where there is room, or with a smaller fingertip"
            )

    def path(self, shape: ObjectShape, distance: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N 2"]:
        """Center of the fingertip [m], object frame as the object lay, at distances from the path's start [m]."""
        way = np.asarray(distance, dtype=float) - self.gap
        turned = np.maximum(way, 0.0) * self.curvature / 2
        # a chord of an arc is along its middle, shorter by sin(x) / x
        chord = way * np.sinc(turned / np.pi)
        heading = self.direction + turned
        start = np.array(self.point) + self.radius * self.face(shape).normal
        return start + chord[:, None] * np.column_stack([np.cos(heading), np.sin(heading)])

    def headings(self, distance: Float[np.ndarray, "N"]) -> Float[np.ndarray, "N"]:
        """Directions of travel [rad], object frame as the object lay, at distances from the path's start [m]."""
        return self.direction + self.curvature * np.maximum(np.asarray(distance, dtype=float) - self.gap, 0.0)

    def centered_pose(
        self, shape: ObjectShape, step: float, shift: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Float[np.ndarray, "3"]:
        """Planar pose of an object whose push crosses the middle of the workspace along y.

        Raises:
            InfeasibleTrialError: it meets no face.
        """
        profile = self.profile(step)
        count = self._stretches(profile)
        middle = self._tip_path(shape, np.array([(count // 2) / count * profile.length]))[0]
        yaw = math.pi / 2 - self.direction - self.curvature * self.length / 2 + shift[2]
        return pose_from_point(np.array(WORKSPACE) + shift[:2], middle, np.array(yaw))

    def tool_path(
        self, shape: ObjectShape, pose: Float[np.ndarray, "3"], step: float, speed: float = math.inf
    ) -> ToolPath:
        """Path of the fingertip, on an object that starts at a planar pose [m, m, rad], world.

        Raises:
            InfeasibleTrialError: it meets no face.
        """
        profile, start = self.profile(step), np.asarray(pose, dtype=float)
        length = profile.length

        def place(parameter: np.ndarray) -> np.ndarray:
            at = transform_point(start, self._tip_path(shape, parameter * length))
            return level(np.column_stack([at, np.zeros(len(at))]))

        def slope(parameter: np.ndarray) -> np.ndarray:
            heading = start[2] + self.headings(parameter * length)
            return level(length * np.column_stack([np.cos(heading), np.sin(heading), 0.0 * heading]))

        knots = np.linspace(0.0, 1.0, self._stretches(profile) + 1)
        way = Way(place, slope, knots, profile.distance / length, profile.rate / length)
        return ToolPath(step, profile.segment, (way,))

    @staticmethod
    def _stretches(profile: Profile) -> int:
        return max(math.ceil(profile.length / _SPACING), LEAST_KNOTS)

    def _tip_path(self, shape: ObjectShape, distance: np.ndarray) -> np.ndarray:
        """`path`; a push that meets no face is an infeasible trial."""
        try:
            return self.path(shape, distance)
        except InvalidValueError as error:
            raise InfeasibleTrialError(f"push: {error}") from error

    def words(self, shape: ObjectShape) -> ActionWords:
        """The parts of `describe`."""
        x, y = (f"{1e3 * value:z.0f}" for value in self.point)
        towards = f"towards {math.remainder(math.degrees(self.direction), 360.0):z.0f} deg, {self.speed * 100:g} cm/s"
        return ActionWords(f"push at ({x}, {y}) mm", manner=towards)
