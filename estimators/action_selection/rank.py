"""The paper's choice of actions: random turns, preferred to slides, until Q has full rank (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from estimators.particles.friction_system import LoadGroups, rank_of
from estimators.particles.model import ParticleModel, cross, direction, turned
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class RankDriven:
    """Accelerated turns for I_j, then turns about random grasps until rank(Q) is full and `pivots` turns were made.

    Every turn goes there and back in one grasp: friction flips and a constant bias does not. Every grasp is used once
    before any is used again.
    """

    pivots: int = 6
    """Least number of turns there and back at constant speed: twice as many turns of the paper."""
    duration: float = 18.0
    """Time of a turn each way [s]; 18 in the paper."""
    accelerated: int = 6
    """Number of accelerated turns; k >= 3 in the paper."""
    most: int = 40
    """Greatest number of trials."""
    seed: int = 0
    """Seed of the random order of grasps."""
    grasps: tuple[int, ...] | None = None
    """Allowed grasps; None is all."""

    def __post_init__(self) -> None:
        for name in ("pivots", "accelerated", "most"):
            if getattr(self, name) < (1 if name == "most" else 0):
                raise InvalidValueError(f"RankDriven.{name}", getattr(self, name), "an integer >= 0 (most: >= 1)")

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next accelerated turn or turn; None when done, without an allowed grasp, or after `most` trials."""
        return self._after(shape, [t.action for t in trajectories], [t.action for t in trajectories if t.ok])

    def predicted_actions(self, shape: ObjectShape) -> list[Action]:
        """Actions that it asks for where every trial ends well."""
        done: list[Action] = []
        while (action := self._after(shape, done, done)) is not None:
            done.append(action)
        return done

    def _after(self, shape: ObjectShape, tried: Sequence[Action], good: Sequence[Action]) -> Action | None:
        allowed = range(len(shape.grasps)) if self.grasps is None else self.grasps
        if not allowed or len(tried) >= self.most:
            return None
        accelerated = sum(action.accelerated for action in tried)
        if accelerated < self.accelerated:
            grasp = _drawn(allowed, accelerated, [self.seed, 1])
            action = Accelerate(grasp)
            if (accelerated + accelerated // len(allowed)) % 2:
                return action.reversed()
            return action
        turns = sum(isinstance(action, Rotate) for action in tried)  # the policy's own, as is `done`
        if turns >= self.pivots:
            done = [action for action in good if isinstance(action, Rotate)]
            within_reach = predicted_rank(shape, [Rotate(grasp) for grasp in allowed])
            if predicted_rank(shape, done) == within_reach:
                return None
        grasp = _drawn(allowed, turns, [self.seed, 2])
        pivot = between_particles(shape, shape.grasps[grasp].position)
        return Rotate(grasp, duration=self.duration, pivot=pivot, back=True)


def between_particles(shape: ObjectShape, point: np.ndarray) -> tuple[float, float] | None:
    """Point half a cell beside `point` [m, object frame], or None where `point` is itself well between particles.

    A particle at the very centre of a turn has no direction of motion: its friction is anything up to mu m g, any way.
    """
    nearest = np.linalg.norm(shape.particles - point, axis=1).min()
    if nearest > shape.cell / 4:
        return None
    x, y = point + shape.cell / 2
    return float(x), float(y)


def held_out_turns(shape: ObjectShape, grasps: Sequence[int], count: int, duration: float, seed: int) -> list[Rotate]:
    """Turns one way about points that `RankDriven` never uses, for predictions on trials that no method was given.

    Args:
        shape: the object.
        grasps: allowed grasps.
        count: number of turns.
        duration: time of each [s].
        seed: seed of the draw.
    """
    turns = []
    for index in range(count):
        grasp = _drawn(grasps, index, [seed, 3])
        rng = np.random.default_rng([seed, 4, index])
        sides = ((1, -1), (-1, 1), (-1, -1))[rng.integers(3)]
        x, y = shape.grasps[grasp].position + shape.cell / 2 * np.array(sides)
        speed = Rotate(grasp).speed * rng.choice((-1, 1))
        turns.append(Rotate(grasp, speed=float(speed), duration=duration, pivot=(float(x), float(y))))
    return turns


def _drawn(allowed: Sequence[int], index: int, stream: list[int]) -> int:
    """Grasp at an index of an endless run of shuffles of the allowed ones."""
    rng = np.random.default_rng([*stream, index // len(allowed)])
    return int(rng.permutation(np.asarray(allowed))[index % len(allowed)])


def predicted_rank(shape: ObjectShape, turns: Sequence[Rotate]) -> int:
    """Predicted rank(Q) of turns, from geometry alone."""
    if not turns:
        return 0
    model = ParticleModel.of(shape)
    points = torch.tensor(np.array([shape.grasps[t.grasp].position if t.pivot is None else t.pivot for t in turns]))
    lever = model.particles - points[:, None]
    unit = direction(turned(lever), 1e-9)
    rows = torch.stack([unit[..., 0], unit[..., 1], cross(lever, unit)], 1)
    groups = LoadGroups.of(model)
    return rank_of(groups.gather(rows).reshape(-1, len(groups.pairs)).numpy())
