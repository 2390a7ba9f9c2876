"""Trials: an object, an action, a support model and a sensing preset; and the runners of trials."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import Grasp, ObjectModel, ObjectShape
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory
from testbed.validation import check_integer, is_number
from testbed.worlds.draw import WorldDraw
from testbed.worlds.seeds import seed_of


@dataclass(frozen=True)
class Support:
    """Support model: distribution of the object's weight over its feet on the table.

    0 N/m: every mass group rests on its own feet (blocks joined by free vertical slides), as the paper assumes.
    Infinite: one rigid body, whose load is affine over all its feet. Between: springs across the joints.
    """

    stiffness: float = 0.0
    """Vertical stiffness between neighboring groups [N/m]."""

    def __post_init__(self) -> None:
        if not (is_number(self.stiffness) or self.stiffness == math.inf) or self.stiffness < 0:
            allowed = "a number >= 0, N/m; infinite is one rigid body: heft.parse_support takes names"
            raise InvalidValueError("Support.stiffness", self.stiffness, allowed)

    @property
    def is_rigid(self) -> bool:
        """True if the object is one rigid body."""
        return math.isinf(self.stiffness)

    @property
    def name(self) -> str:
        """Name: own_weight, rigid, or the stiffness with its unit."""
        if self.is_rigid or self.stiffness == 0:
            return "rigid" if self.is_rigid else "own_weight"
        text = f"{self.stiffness:g}"
        return f"{text if float(text) == self.stiffness else self.stiffness} N/m"


OWN_WEIGHT = Support(0.0)
"""Support of every mass group by its own feet, as the paper assumes."""
RIGID = Support(math.inf)
"""Support of one rigid body."""


def parse_support(text: str | float) -> Support:
    """Support by name, such as "own_weight", "rigid" or "300 N/m", or by its stiffness [N/m].

    Raises:
        InvalidValueError: another text.
    """
    named = {"own_weight": OWN_WEIGHT, "rigid": RIGID}
    try:
        bare = text.removesuffix(" N/m") if isinstance(text, str) else text
        return named[str(text)] if text in named else Support(float(bare))
    except (TypeError, ValueError, OverflowError):
        raise InvalidValueError("support", text, '"own_weight", "rigid", or a stiffness >= 0, N/m') from None


def support_of(shape: ObjectShape, text: str | None = None) -> Support:
    """Support by name; by default own weight if the shape stands in groups, else one rigid body.

    Raises:
        InvalidValueError: a text that `parse_support` refuses.
    """
    if text is not None:
        return parse_support(text)
    return OWN_WEIGHT if shape.stands_in_groups else RIGID


@dataclass(frozen=True, eq=False)
class Trial:
    """Request to a runner."""

    object: ObjectModel
    """Object, with its true masses and frictions, which only a simulation uses."""
    action: Action
    """Action on the object."""
    support: Support = OWN_WEIGHT
    """Support model."""
    sensing: str = "ideal"
    """Name of a sensing preset."""
    seed: int = 0
    """Number of the draw of the errors of sensor and trial, >= 0: a trial that is run twice has the same errors."""
    world: WorldDraw | None = None
    """Draw of a world for the object; None is the ideal world. Only a simulation needs it."""

    def __post_init__(self) -> None:
        if not isinstance(self.object, ObjectModel):
            raise InvalidValueError("Trial.object", self.object, 'an ObjectModel, such as heft.load_object("L2")')
        if not isinstance(self.support, Support):
            raise InvalidValueError("Trial.support", self.support, "heft.OWN_WEIGHT, heft.RIGID or heft.Support(N/m)")
        if not isinstance(self.action, Action):
            raise InvalidValueError("Trial.action", self.action, "an action, such as heft.Rotate(0)")
        preset(self.sensing)
        object.__setattr__(self, "seed", check_integer("Trial.seed", self.seed, least=0, most=2**63))
        if not isinstance(self.world, WorldDraw | None):
            allowed = 'a draw, such as heft.WorldDraw.of(heft.world("lab"), obj, 0), or None'
            raise InvalidValueError("Trial.world", self.world, allowed)
        if self.world is not None:
            drawn = None if self.world.world.none else replace(self.world, repeat=self.seed)
            object.__setattr__(self, "world", drawn)
        if self.action.grasp is not None and self.action.grasp >= len(self.object.shape.grasps):
            names = ", ".join(f"{i} ({g.name})" for i, g in enumerate(self.object.shape.grasps))
            allowed = names or "none: nothing is grippable"
            raise InvalidValueError(f"{type(self.action).__name__}.grasp", self.action.grasp, allowed)

    def seed_under(self, secret: str) -> int:
        """Seed of the sensing draw under a runner's secret; it depends on the object and the action."""
        return seed_of(secret, self.seed, self.object.name, json.dumps(self.action.to_dict(), sort_keys=True))

    @property
    def grasp(self) -> Grasp:
        """Grasp of the action.

        Raises:
            InvalidValueError: an action without a grasp.
        """
        if self.action.grasp is None:
            raise InvalidValueError("trial.action", self.action, "an action that grips the object")
        return self.object.shape.grasps[self.action.grasp]


@runtime_checkable
class TrialRunner(Protocol):
    """Runner of trials: in MuJoCo, on the real arm, or from records. Entering it connects, leaving it stops."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None, /
    ) -> None: ...

    def run(self, trial: Trial) -> Trajectory:
        """Run one trial.

        Raises:
            InfeasibleTrialError: refused before moving.
        """
        ...
