"""Actions: what to do with the object, not how the robot does it. Angles rad, SI units, object frame."""

from __future__ import annotations

import math
from dataclasses import MISSING, asdict, dataclass, fields
from typing import Any

import numpy as np

from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.validation import check_positive, frozen_array, is_number

STEEPEST = math.radians(30)
"""Tilt in the air beyond which no object is taken, rad."""


@dataclass(frozen=True)
class Weigh:
    """Put the object on a scale and read M."""


@dataclass(frozen=True)
class Rotate:
    """Grasp-and-rotate at constant speed: one turn of the paper, 10 deg/s for 18 s; or there and back."""

    grasp: int
    """Index into the shape's grasps; also the centre of the turn unless `pivot` says otherwise."""
    speed: float = math.radians(10)
    """Angular speed, rad/s; positive turns counter-clockwise seen from above."""
    duration: float = 18.0
    """Time at constant speed, s."""
    pivot: tuple[float, float] | None = None
    """Centre of the turn, m, object frame; None is the grasp point."""
    back: bool = False
    """Turn back again in the same grasp, after one tare: friction flips, and whatever bias the tare left does not."""

    def __post_init__(self) -> None:
        _check_index("Rotate.grasp", self.grasp)
        _check_nonzero("Rotate.speed", self.speed)
        check_positive("Rotate.duration", self.duration)
        if not isinstance(self.back, bool):
            raise InvalidValueError("Rotate.back", self.back, "true or false")
        if self.pivot is not None:
            object.__setattr__(self, "pivot", tuple(frozen_array("Rotate.pivot", self.pivot, (2,)).tolist()))


@dataclass(frozen=True)
class Accelerate:
    """A turn about the grasp point whose angular acceleration steps through several values of both signs.

    The paper's "apply various torque": the slope of torque against acceleration is I_j (Eq. dvp).
    """

    grasp: int
    """Index into the shape's grasps."""
    accelerations: tuple[float, ...] = (1.0, -1.0, 1.5, -1.5, 0.5, -0.5, 1.5, -1.5)
    """Angular accelerations, rad/s^2, held one after the other."""
    hold: float = 0.6
    """Time at each acceleration, s."""
    start_speed: float = 0.15
    """Angular speed before the first, rad/s; its sign is the direction of the turn, which never reverses."""

    def __post_init__(self) -> None:
        _check_index("Accelerate.grasp", self.grasp)
        check_positive("Accelerate.hold", self.hold)
        _check_nonzero("Accelerate.start_speed", self.start_speed)
        values = tuple(frozen_array("Accelerate.accelerations", self.accelerations, (None,)).tolist())
        if not (any(a > 0 for a in values) and any(a < 0 for a in values)):
            raise InvalidValueError(
                "Accelerate.accelerations", self.accelerations, "finite numbers of both signs, rad/s^2"
            )
        object.__setattr__(self, "accelerations", values)
        speeds = self.start_speed + np.concatenate([[0.0], np.cumsum(values) * self.hold])
        if (speeds * np.sign(self.start_speed) <= 0).any():
            raise InvalidValueError(
                "Accelerate.accelerations",
                self.accelerations,
                "a sequence that never stops or reverses the turn: friction would flip",
            )


@dataclass(frozen=True)
class Slide:
    """Grasp-and-slide along a straight line at constant speed: 5 cm/s for 4 s in the paper."""

    grasp: int
    """Index into the shape's grasps."""
    direction: float = 0.0
    """Direction of travel, rad, in the object frame."""
    speed: float = 0.05
    """Speed, m/s."""
    duration: float = 4.0
    """Time at constant speed, s."""

    def __post_init__(self) -> None:
        _check_index("Slide.grasp", self.grasp)
        check_positive("Slide.speed", self.speed)
        check_positive("Slide.duration", self.duration)
        if not is_number(self.direction):
            raise InvalidValueError("Slide.direction", self.direction, "a finite angle, rad")


@dataclass(frozen=True)
class Lift:
    """Lift the object clear of the table, hold it still, and rock it there about its own x, y and z axis.

    Still, the wrench is its weight at its centre of mass, with no friction in it; rocking adds the second moments. It
    rocks about the TCP between tilts of either sign, at one angular acceleration of alternating sign.
    """

    grasp: int
    """Index into the shape's grasps."""
    tilt: float = math.radians(6)
    """How far it is tilted, and turned, either way, rad; 0 only holds it still and level."""
    acceleration: float = 2.5
    """Angular acceleration while rocking, rad/s^2."""
    swings: int = 6
    """Stretches of such acceleration about each axis; 0 holds still at every tilt and does not rock."""
    hold: float = 2.0
    """Time held still, level and at every tilt, s."""
    height: float = 0.08
    """How far it is lifted, m."""

    def __post_init__(self) -> None:
        _check_index("Lift.grasp", self.grasp)
        if not (is_number(self.tilt) and 0 <= self.tilt <= STEEPEST):
            raise InvalidValueError("Lift.tilt", self.tilt, f"an angle from 0 to {STEEPEST:.2f}, rad")
        for name in ("acceleration", "hold", "height"):
            check_positive(f"Lift.{name}", getattr(self, name))
        if isinstance(self.swings, bool) or not (isinstance(self.swings, int) and self.swings >= 0):
            raise InvalidValueError("Lift.swings", self.swings, "an integer >= 0")

    def rocks(self, segment: int) -> bool:
        """Whether it rocks in a stretch, from 0, or holds still: level first, then at either end of each rocking."""
        return segment > 0 and self.swings > 0 and (segment - 1) % (self.swings + 2) not in (0, self.swings + 1)


TableAction = Rotate | Accelerate | Slide
"""Moves the object over the table."""
Action = Weigh | TableAction | Lift
"""What can be done with an object."""
_KINDS: dict[str, type[Action]] = {
    "weigh": Weigh,
    "rotate": Rotate,
    "accelerate": Accelerate,
    "slide": Slide,
    "lift": Lift,
}


def action_to_dict(action: Action) -> dict[str, Any]:
    """The action as plain data, with its kind."""
    return {"kind": type(action).__name__.lower(), **asdict(action)}


def action_from_dict(data: dict[str, Any]) -> Action:
    """The inverse of `action_to_dict`.

    Raises:
        InvalidValueError: unknown kind or field, or a value out of range.
    """
    if not isinstance(data, dict):
        raise InvalidValueError("action", data, "a table with a kind and its fields")
    rest = dict(data)
    kind = _KINDS.get(str(rest.pop("kind", None)))
    if kind is None:
        raise InvalidValueError("action.kind", data.get("kind"), f"one of {', '.join(_KINDS)}")
    known = {f.name for f in fields(kind)}
    if unknown := sorted(set(rest) - known):
        raise InvalidValueError("action", unknown, f"fields {', '.join(sorted(known))}")
    missing = sorted(f.name for f in fields(kind) if f.default is MISSING and f.name not in rest)
    if missing:
        raise InvalidValueError("action", data, f"fields {', '.join(missing)} as well")
    return kind(**rest)


def pivot_of(action: Rotate | Accelerate, shape: ObjectShape) -> np.ndarray:
    """Centre of a turn, m, object frame, (2,)."""
    pivot = action.pivot if isinstance(action, Rotate) else None
    return shape.grasps[action.grasp].position if pivot is None else np.array(pivot)


def _check_index(name: str, value: int) -> None:
    if isinstance(value, bool) or not (isinstance(value, int) and value >= 0):
        raise InvalidValueError(name, value, "an integer >= 0, an index into the shape's grasps")


def _check_nonzero(name: str, value: float) -> None:
    if not (is_number(value) and value != 0):
        raise InvalidValueError(name, value, "a finite number other than 0")
