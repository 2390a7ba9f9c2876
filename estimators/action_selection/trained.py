"""Trained policy: greedy by an index whose weights a search has found, in place of the gain per second."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from jaxtyping import Float

from estimators.action_selection.design import Belief, Criterion, Design, Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.plan import Goal, always_feasible
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.files import read_file, write_whole
from testbed.objects.model import ObjectShape
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory
from testbed.validation import check_positive_fields

SHIPPED = Path(__file__).with_name("trained.json")
"""Weights that heft ships; `python -m scenarios.environment.train` makes them."""
SHAPE = (3, 3)
"""Number of features of an action, and of the plan's state."""
TYPICAL_SECONDS = 15.0
"""Robot time at which the feature of time is zero [s]."""
LEAST = 1e-6
"""Lower bound of a gain before its logarithm is taken."""


@dataclass(frozen=True)
class TrainedIndex:
    """Logarithm of the gain per second, plus weights times three features of an action and three of the plan's state.

    Features of an action: log of the gain of the masses' volume (criterion D) and of their trace (A) over that of the
    design's own criterion, and log of its robot time. Features of the state: 1, the remaining part of the robot
    time, and the decades by which the expected NAD has fallen below 100 %. Weights of zero are the greedy policy.
    """

    weights: tuple[tuple[float, ...], ...] = ((0.0,) * SHAPE[1],) * SHAPE[0]
    """Weights: a row for each feature of an action."""
    budget_s: float = 110.0
    """Robot time of the whole plan [s]."""

    def __post_init__(self) -> None:
        values = np.array(self.weights, dtype=float)
        if values.shape != SHAPE or not np.isfinite(values).all():
            raise InvalidValueError("TrainedIndex.weights", self.weights, f"{SHAPE[0]} rows of {SHAPE[1]} numbers")
        check_positive_fields(self, "budget_s")

    def __call__(
        self, design: Design, belief: Belief, gain: Float[np.ndarray, "C"], seconds: Float[np.ndarray, "C"], left: float
    ) -> Float[np.ndarray, "C"]:
        """Index of every candidate."""
        own = np.log(np.maximum(gain, LEAST))
        others: list[Criterion] = ["D", "A"]
        features = [np.log(np.maximum(_gain(design, belief, each), LEAST)) - own for each in others]
        features.append(np.log(seconds / TYPICAL_SECONDS))
        of_state = np.array([1.0, min(left / self.budget_s, 1.0), -np.log10(belief.expected_nad)])
        return own - np.log(seconds) + of_state @ np.array(self.weights).T @ np.array(features)

    @staticmethod
    def load(path: Path) -> TrainedIndex:
        """Index with the weights of a file.

        Raises:
            InvalidValueError: no such file, or not one that `save` wrote.
        """
        try:
            found = json.loads(read_file(path))
            return TrainedIndex(tuple(tuple(map(float, row)) for row in found["weights"]), float(found["budget_s"]))
        except (OSError, ValueError, TypeError, KeyError) as error:
            raise InvalidValueError("file", str(path), f"a file of weights ({error})") from None

    def save(self, path: Path, **beside: object) -> None:
        """Write the weights and further entries."""
        text = json.dumps({"weights": self.weights, "budget_s": self.budget_s, **beside}, indent=2) + "\n"
        write_whole(path, lambda part: part.write_text(text, encoding="utf-8"))


def _gain(design: Design, belief: Belief, criterion: Criterion) -> Float[np.ndarray, "C"]:
    """Fall of the logarithm of a criterion with every candidate."""
    other = replace(design, criterion=criterion)
    return np.log(other.value(belief) / np.maximum(other.values_after(belief), 1e-300))


@dataclass(frozen=True)
class TrainedPolicy:
    """Plan before the first trial, each action of the largest trained index."""

    weight_kg: float = 1.0
    """M as weighed [kg]; heft fills it in."""
    grasps: tuple[int, ...] | None = None
    """Usable grasps; heft fills them in."""
    feasible: Callable[[Action], str] = always_feasible
    """Check of an action; heft fills it in."""
    file: str = str(SHIPPED)
    """File of weights."""
    plan_for: str = "ft300s"
    """Sensor that the plan expects."""
    most: int = 20
    """Greatest number of trials."""
    candidates: int = 4000
    """Number of actions to consider."""

    @cached_property
    def policy(self) -> PlannedPolicy:
        """The plan's policy."""
        index = TrainedIndex.load(Path(self.file))
        guess, goal = Guess(self.weight_kg, preset(self.plan_for).stated), Goal(budget_s=index.budget_s, most=self.most)
        searched = {"candidates": self.candidates, "grasps": self.grasps, "feasible": self.feasible}
        return PlannedPolicy(guess, goal=goal, index=index, **searched)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action of the plan."""
        return self.policy.next(shape, trajectories)
