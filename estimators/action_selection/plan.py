"""A plan of actions: its goal, its steps, and the candidates that the robot or simulator refuses."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from estimators.action_selection.design import Belief, Design
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.validation import check_integer, is_number

Feasible = Callable[[Action], str]
"""Check of an action by the robot or simulator: empty where it can be done, else why not."""


def always_feasible(_: Action) -> str:
    """Pass every action."""
    return ""


@dataclass(frozen=True)
class Goal:
    """Conditions under which a plan ends."""

    until: float | None = None
    """Expected NAD to reach, as a ratio."""
    budget_s: float | None = None
    """Robot time that may be used [s]."""
    most: int = 12
    """Greatest number of trials."""

    def __post_init__(self) -> None:
        limits = (("until", 1.0, "a ratio above 0, up to 1"), ("budget_s", np.inf, "a finite number > 0"))
        for name, most, allowed in limits:
            value = getattr(self, name)
            if value is not None and not (is_number(value) and 0 < value <= most):
                raise InvalidValueError(f"Goal.{name}", value, f"{allowed}, or None")
        check_integer("Goal.most", self.most)

    def met(self, nad: float) -> bool:
        """True if an expected NAD reaches the target."""
        return self.until is not None and nad <= self.until

    def left(self, spent: float) -> float:
        """Remaining robot time [s]; infinite without a budget."""
        return np.inf if self.budget_s is None else self.budget_s - spent

    def ended(self, belief: Belief, trials: int) -> str:
        """Reason to end after a number of `trials`; empty without one."""
        if self.met(belief.expected_nad):
            return "the target is met"
        return f"the limit of trials ({self.most}) is reached" if trials >= self.most else ""


@dataclass(eq=False)
class FeasibilityLog:
    """Answers of a feasibility check; each action is checked at most once."""

    feasible: Feasible = always_feasible
    answers: dict[Action, str] = field(default_factory=dict)

    def refusal(self, action: Action) -> str:
        """Reason why an action cannot be done; empty where it can."""
        if action not in self.answers:
            self.answers[action] = self.feasible(action)
        return self.answers[action]

    @property
    def rejected(self) -> tuple[tuple[Action, str], ...]:
        """Refused candidates, with the reason."""
        return tuple((action, why) for action, why in self.answers.items() if why)


@dataclass(frozen=True, eq=False)
class PlanStep:
    """One action of a plan."""

    action: Action
    """Action to make."""
    seconds: float
    """Robot time, travel included [s]."""
    belief: Belief
    """Belief after it."""
    criterion: float
    """Value of the criterion after it."""


@dataclass(frozen=True, eq=False)
class Plan:
    """Actions in order, the beliefs expected after them, and why the plan ends there."""

    before: Belief
    """Belief after the weighing alone."""
    steps: tuple[PlanStep, ...]
    """Actions in order."""
    why: str
    """Reason why it ends."""
    rejected: tuple[tuple[Action, str], ...] = ()
    """More informative actions that were refused, with the reason."""

    @staticmethod
    def of(design: Design, before: Belief, chosen: Sequence[int], why: str, log: FeasibilityLog | None = None) -> Plan:
        """Plan of the chosen candidates of a design, in that order."""
        steps: list[PlanStep] = []
        for index in chosen:
            last = steps[-1].action if steps else None
            steps.append(plan_step(design, steps[-1].belief if steps else before, last, index))
        return Plan(before, tuple(steps), why, log.rejected if log is not None else ())

    @property
    def seconds(self) -> float:
        """Robot time, travel included, without the weighing [s]."""
        return sum(step.seconds for step in self.steps)

    @property
    def actions(self) -> tuple[Action, ...]:
        """Actions in order."""
        return tuple(step.action for step in self.steps)

    @property
    def after(self) -> Belief:
        """Belief after the last step."""
        return self.steps[-1].belief if self.steps else self.before


def plan_step(design: Design, belief: Belief, last: Action | None, index: int) -> PlanStep:
    """Step that adds a candidate to a plan whose last action is `last`."""
    action = design.candidates[index]
    after = belief.after(design.information_of([index]))
    seconds = design.time.of(action) + design.time.between(design.shape, last, action)
    return PlanStep(action, seconds, after, design.value(after))
