"""The paper's choice of actions: random turns, preferred to slides, until Q has full rank (Algorithm 1)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import torch

from estimators.particles.load_groups import LoadGroups, rank_of
from estimators.wrench.model import ParticleModel, cross, direction, turned
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer


@dataclass(frozen=True)
class RankDriven:
    """Accelerated turns for I_j, then turns about random grasps until rank(Q) is full and `pivots` turns were made.

    Every grasp is used once before any is used again. `RANK_DRIVEN` has the paper's settings and ours.
    """

    pivots: int = 6
    """Least number of turns at constant speed. Six there and back are twelve of the paper's, which has n_s / 3 of them,
    and another turn while the rank is not full."""
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
    back: bool = True
    """True turns there and back in one grasp: friction flips and a constant bias does not."""
    beside: bool = True
    """True turns about a point beside the grasped particle, which has no direction of motion at the center."""
    refused: Mapping[Action, str] = field(default_factory=dict, compare=False)
    """Actions that the bench refused, and why: their grasps are used no more; grows as trials are made."""

    def __post_init__(self) -> None:
        for name, least in (("pivots", 0), ("accelerated", 0), ("most", 1)):
            check_integer(f"RankDriven.{name}", getattr(self, name), least)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action; None when done, without an allowed grasp, or after `most` trials.

        Raises:
            InfeasibleTrialError: actions about all allowed grasps were refused.
            InvalidValueError: a grasp that the shape does not have.
        """
        return self._after(shape, [t.action for t in trajectories], [t.action for t in trajectories if t.ok])

    def predicted_actions(self, shape: ObjectShape) -> list[Action]:
        """Actions of the policy if every trial ends well."""
        done: list[Action] = []
        while (action := self._after(shape, done, done)) is not None:
            done.append(action)
        return done

    def _after(self, shape: ObjectShape, tried: Sequence[Action], good: Sequence[Action]) -> Action | None:
        barred = {action.grasp for action in self.refused if action.on_table}
        grasps = allowed_grasps(shape, self.grasps)
        allowed = [grasp for grasp in grasps if grasp not in barred]
        if grasps and not allowed:
            raise InfeasibleTrialError("the bench refused an action about every grasp")
        if not allowed or len(tried) >= self.most:
            return None
        accelerated = sum(action.accelerated for action in tried)
        if accelerated < self.accelerated:
            grasp = _drawn(allowed, accelerated, [self.seed, 1])
            action, rounds = Accelerate(grasp), accelerated // len(allowed)
            # half of the turns backward: an even number of grasps needs a shift in each round
            backward = (accelerated + rounds * (len(allowed) % 2 == 0)) % 2
            return action.reversed() if backward else action
        moved = sum(action.dragged_steadily for action in tried)
        grasp = _drawn(allowed, moved, [self.seed, 2])
        if moved >= self.pivots:
            done = [action for action in good if action.dragged_steadily]
            turns = [Rotate(grasp) for grasp in allowed]
            slides = [] if self.back else [Slide(allowed[0]), Slide(allowed[0], np.pi / 2)]
            rank = predicted_rank(shape, done)
            if rank >= predicted_rank(shape, [*turns, *slides]):
                return None
            if slides and rank >= predicted_rank(shape, turns):
                return Slide(grasp, np.random.default_rng([self.seed, 5, moved]).uniform(0, 2 * np.pi))
        pivot = between_particles(shape, shape.grasps[grasp].position) if self.beside else None
        return Rotate(grasp, duration=self.duration, pivot=pivot, back=self.back)


RANK_DRIVEN: dict[str, RankDriven] = {
    "published": RankDriven(1, accelerated=3, back=False, beside=False),
    "published_back": RankDriven(1, accelerated=3, beside=False),
    "published_back_beside": RankDriven(1, accelerated=3),
    "reversed_pairs": RankDriven(),
}
"""Rank-driven policies by name: Algorithm 1 as printed, one way about the grasp point; two steps to ours; and ours.

Full rank takes n_s / 3 turns or more, as each adds three rows to Q, so `published` states no number. Slides have the
lower priority there: they come where one-way turns about all grasps leave the rank open.
"""


def between_particles(shape: ObjectShape, point: np.ndarray) -> tuple[float, float] | None:
    """Point half a cell beside `point` [m, object frame], or None where `point` is itself well between particles.

    A particle at the center of a turn has no direction of motion: its friction has any size up to mu m g and any
    direction.
    """
    nearest = np.linalg.norm(shape.particles - point, axis=1).min()
    if nearest > shape.cell / 4:
        return None
    x, y = point + shape.cell / 2
    return float(x), float(y)


def allowed_grasps(shape: ObjectShape, grasps: Sequence[int] | None) -> tuple[int, ...]:
    """Grasps that a policy may use; None is all.

    Raises:
        InvalidValueError: a grasp that the shape does not have.
    """
    count = len(shape.grasps)
    if grasps is None:
        return tuple(range(count))
    for grasp in grasps:
        if check_integer("grasps", grasp, 0) >= count:
            raise InvalidValueError("grasps", grasp, f"some of the shape's {count} grasps, counted from 0")
    return tuple(map(int, grasps))


HELD_OUT_SIDES = (1, -1), (-1, 1), (-1, -1)
"""Directions from a grasp to the points about which held-out turns go."""
FEWEST_GRASPS = 3
"""Least number of grasps for trials where one grasp is held out: k >= 3 of Algorithm 1."""


def held_out_grasp(shape: ObjectShape, grasps: Sequence[int], seed: int) -> int | None:
    """Grasp that trials can omit: turns about the others show as many friction loads. None if there is no such grasp.

    Args:
        shape: the object.
        grasps: feasible grasps.
        seed: seed of the draw.
    """
    if len(grasps) <= FEWEST_GRASPS:
        return None
    whole = predicted_rank(shape, [Rotate(grasp) for grasp in grasps])
    for grasp in np.random.default_rng([seed, 6]).permutation(np.asarray(grasps)).tolist():
        if predicted_rank(shape, [Rotate(other) for other in grasps if other != grasp]) == whole:
            return grasp
    return None


def held_out_turns(shape: ObjectShape, grasps: Sequence[int], count: int, duration: float, seed: int) -> list[Rotate]:
    """Turns one way about points that `RankDriven` never uses, for predictions on trials that no method was given.

    Those by one grasp differ, up to six of them.

    Args:
        shape: the object.
        grasps: grasps to turn by.
        count: number of turns.
        duration: time of each [s].
        seed: seed of the draw.
    """
    turns = []
    for index in range(count):
        grasp = _drawn(grasps, index, [seed, 3])
        order = np.random.default_rng([seed, 4, grasp]).permutation(2 * len(HELD_OUT_SIDES))
        side, backward = divmod(int(order[index // len(grasps) % len(order)]), 2)
        place = shape.grasps[grasp].position
        away = shape.cell if between_particles(shape, place) is None else shape.cell / 2
        x, y = place + away * np.array(HELD_OUT_SIDES[side])
        speed = -Rotate(grasp).speed if backward else Rotate(grasp).speed
        turns.append(Rotate(grasp, speed=speed, duration=duration, pivot=(float(x), float(y))))
    return turns


def _drawn(allowed: Sequence[int], index: int, stream: list[int]) -> int:
    """Grasp at an index of an endless sequence of random permutations of the allowed ones."""
    rng = np.random.default_rng([*stream, index // len(allowed)])
    return int(rng.permutation(np.asarray(allowed))[index % len(allowed)])


def sees_every_load(shape: ObjectShape, actions: Sequence[Action]) -> bool:
    """True if the predicted rank(Q) of turns and slides is n_s, the number of friction loads."""
    return predicted_rank(shape, actions) == len(LoadGroups.of(ParticleModel.of(shape)).pairs)


def predicted_rank(shape: ObjectShape, actions: Sequence[Action]) -> int:
    """Predicted rank(Q) of turns and slides at constant speed, from geometry alone."""
    if not actions:
        return 0
    model = ParticleModel.of(shape)
    lever = model.particles - torch.tensor(np.array([action.center(shape) for action in actions]))[:, None]
    turning = torch.tensor([float(action.turns) for action in actions], dtype=torch.float64)[:, None, None]
    heading = torch.tensor(np.array([action.heading for action in actions]))
    unit = direction(turning * turned(lever) + heading[:, None], 1e-9)
    rows = torch.stack([unit[..., 0], unit[..., 1], cross(lever, unit)], 1)
    groups = LoadGroups.of(model)
    return rank_of(groups.gather(rows).reshape(-1, len(groups.pairs)).numpy())
