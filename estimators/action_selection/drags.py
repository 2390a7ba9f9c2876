"""Random slides and turns as a policy: of an object in links, whose other links trail behind the one in the hand."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.action_selection.pushes import TRIES, untried
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory

BESIDE = 0.03
"""Greatest distance of the center of a turn from the grasp, along each axis [m]."""


@dataclass(frozen=True)
class RandomDrags:
    """Slides and turns at constant speed by random grasps, in random directions and about random points beside them."""

    drags: int = 8
    """Slides and turns that end well, every other one a turn."""
    grasps: tuple[int, ...] | None = None
    """Allowed grasps; None is all."""
    seed: int = 0
    """Seed of the draws."""
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """Actions that the bench refused, and why; grows as trials are made."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next slide or turn; None when done."""
        if sum(t.ok for t in trajectories) >= self.drags:
            return None
        grasps = tuple(range(len(shape.grasps))) if self.grasps is None else self.grasps
        return untried(random_drags(shape, grasps, TRIES * self.drags, self.seed), self.refused, trajectories)


def random_drags(shape: ObjectShape, grasps: Sequence[int], count: int, seed: int) -> list[Slide | Rotate]:
    """Random slides and turns: the first ones of a longer list are the same."""
    rng = np.random.default_rng(seed)
    found: list[Slide | Rotate] = []
    for index in range(count):
        grasp = int(rng.choice(grasps))
        way, beside = float(rng.uniform(-math.pi, math.pi)), rng.uniform(-BESIDE, BESIDE, 2)
        if index % 2 == 0:
            found.append(Slide(grasp, way))
            continue
        x, y = shape.grasps[grasp].position + beside
        found.append(Rotate(grasp, math.copysign(Rotate.speed, way), 9.0, (float(x), float(y))))
    return found
