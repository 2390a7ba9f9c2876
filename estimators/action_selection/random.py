"""Random actions as policies.

Pushes of faces, points and directions as published for pushed objects, alone or after turns. Slides and turns of an
object in links, whose other links trail behind the one in the hand.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field

import numpy as np

from estimators.action_selection.rank import allowed_grasps, sees_every_load
from estimators.base import ActionPolicy
from testbed.actions.base import Action
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InfeasibleTrialError
from testbed.objects.faces import faces
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer

AIM = math.radians(30)
"""Greatest angle between a push and the face's normal [rad]."""
CURVED = 3.0
"""Greatest curvature of a path, either way [rad/m]."""
EDGE = 0.05
"""Part of a face at either end without pushes: the fingertip would soon slide off."""
TRIES = 5
"""Actions tried for each one requested, refused and failed actions included."""
BESIDE = 0.03
"""Greatest distance of the center of a turn from the grasp, along each axis [m]."""


@dataclass(frozen=True)
class RandomPushes:
    """Pushes at points drawn evenly along the outline, in directions about the normal, along arcs (Song, Boularias).

    The published pushes are of random faces and directions; that a path bends is ours.
    """

    pushes: int = 12
    """Pushes that end well."""
    seed: int = 0
    """Seed of the draws."""
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """Actions that the bench refused, and why; grows as trials are made."""
    before: ActionPolicy | None = None
    """Policy of turns that come first: pushes follow where those that ended well leave rank(Q) open."""

    def __post_init__(self) -> None:
        check_integer("RandomPushes.pushes", self.pushes, 0)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action; None when done."""
        made = [t for t in trajectories if t.action.pushes]
        if self.before is not None and not made:
            with suppress(InfeasibleTrialError):  # every grasp was refused: only pushes remain
                if (action := self.before.next(shape, trajectories)) is not None:
                    return action
            turned = [t.action for t in trajectories if t.ok and t.action.dragged_steadily]
            if sees_every_load(shape, turned):
                return None
        if sum(t.ok for t in made) >= self.pushes:
            return None
        return untried(random_pushes(shape, TRIES * self.pushes, self.seed), self.refused, made)


def untried(
    drawn: Sequence[Action], refused: Mapping[Action, str], trajectories: Sequence[Trajectory]
) -> Action | None:
    """First drawn action that was neither refused nor made; None if there is none."""
    tried = {*refused, *(t.action for t in trajectories)}
    return next((action for action in drawn if action not in tried), None)


def random_pushes(shape: ObjectShape, count: int, seed: int) -> list[Push]:
    """Random pushes of an object; a longer list begins with the same pushes."""
    rng, every = np.random.default_rng(seed), faces(shape)
    share = np.array([face.length for face in every])
    found = []
    for _ in range(count):
        face = every[rng.choice(len(every), p=share / share.sum())]
        part, angle, curvature = rng.uniform(EDGE, 1 - EDGE), rng.uniform(-AIM, AIM), rng.uniform(-CURVED, CURVED)
        found.append(Push.into(face, part, angle, curvature))
    return found


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

    def __post_init__(self) -> None:
        check_integer("RandomDrags.drags", self.drags, 0)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next slide or turn; None when done, or without an allowed grasp."""
        grasps = allowed_grasps(shape, self.grasps)
        if not grasps or sum(t.ok for t in trajectories) >= self.drags:
            return None
        return untried(random_drags(shape, grasps, TRIES * self.drags, self.seed), self.refused, trajectories)


def random_drags(shape: ObjectShape, grasps: Sequence[int], count: int, seed: int) -> list[Slide | Rotate]:
    """Random slides and turns; a longer list begins with the same actions."""
    rng = np.random.default_rng(seed)
    found: list[Slide | Rotate] = []
    for index in range(count):
        grasp = int(rng.choice(grasps))
        way, offset = float(rng.uniform(-math.pi, math.pi)), rng.uniform(-BESIDE, BESIDE, 2)
        if index % 2 == 0:
            found.append(Slide(grasp, way))
            continue
        x, y = shape.grasps[grasp].position + offset
        found.append(Rotate(grasp, math.copysign(Rotate.speed, way), 9.0, (float(x), float(y))))
    return found
