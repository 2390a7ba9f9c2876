"""What is shown of a plan of touches: where each grasps and turns, and how sure each mass is after it."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.actions import Accelerate, Action, Lift, Rotate, Slide, pivot_of
from testbed.objects import ObjectShape

SHOWN_ARC, SHOWN_WAY = math.radians(70), 0.05
"""Most of a turn that its arrow covers, however far the turn goes: rad, and m along the way."""
IN_PLACE, PLACE_RADIUS = 0.008, 0.012
"""A turn about a point nearer to its grasp than this is drawn as one in place, so wide, m."""


@dataclass(frozen=True, eq=False)
class TouchShown:
    """One touch on the object, object frame."""

    grasp: Float[np.ndarray, "2"]
    """m."""
    about: Float[np.ndarray, "2"] | None
    """Centre of the turn, m; None for a slide."""
    way: Float[np.ndarray, "N 2"]
    """Line of the arrow, m; it ends at its head."""
    accelerated: bool

    @staticmethod
    def of(shape: ObjectShape, action: Rotate | Accelerate | Slide) -> TouchShown:
        """The first part of its way."""
        grasp = shape.grasps[action.grasp].position
        if isinstance(action, Slide):
            along = np.array([math.cos(action.direction), math.sin(action.direction)])
            return TouchShown(grasp, None, grasp + SHOWN_WAY * np.outer([0.0, 1.0], along), accelerated=False)
        pivot, accelerated = pivot_of(action, shape), isinstance(action, Accelerate)
        speed = action.start_speed if isinstance(action, Accelerate) else action.speed
        arm = grasp - pivot
        radius, begin = float(np.linalg.norm(arm)), math.atan2(arm[1], arm[0])
        if radius < IN_PLACE:
            radius, begin = PLACE_RADIUS, 0.0
        angle = begin + math.copysign(min(SHOWN_ARC, SHOWN_WAY / radius), speed) * np.linspace(0.0, 1.0, 12)
        way = pivot + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return TouchShown(grasp, pivot, way, accelerated)

    @property
    def label(self) -> Float[np.ndarray, "2"]:
        """Where its number goes, m."""
        return self.way[-1] if self.about is None else self.about

    @property
    def points(self) -> Float[np.ndarray, "N 2"]:
        """All that it takes up, m."""
        return np.vstack([self.way, self.grasp, self.label])


@dataclass(frozen=True, eq=False)
class PlanShown:
    """A plan of T touches."""

    shape: ObjectShape
    actions: tuple[Action, ...]
    errors: Float[np.ndarray, "T+1 n_m"]
    """Standard error of each group's mass that is expected, kg: after the weighing, then after each touch."""
    weight: float
    """M, kg."""
    title: str
    words: tuple[str, ...] = ()
    """Each touch in words."""

    @property
    def touches(self) -> dict[int, TouchShown]:
        """Those that move the object over the table, by their number from 1."""
        numbered = enumerate(self.actions, start=1)
        return {n: TouchShown.of(self.shape, a) for n, a in numbered if isinstance(a, Rotate | Accelerate | Slide)}

    @property
    def lifts(self) -> dict[int, Float[np.ndarray, "2"]]:
        """Where those hold it that lift it, m, by their number from 1."""
        numbered = enumerate(self.actions, start=1)
        return {n: self.shape.grasps[a.grasp].position for n, a in numbered if isinstance(a, Lift)}
