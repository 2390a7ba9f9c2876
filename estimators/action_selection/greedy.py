"""A plan: actions one after the other until the goal is met, time is up, or nothing feasible teaches more."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float, Int

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import (
    LEAST_GAIN,
    Belief,
    Criterion,
    Design,
    Guess,
    PlanStep,
    prior_belief,
    steady,
)
from estimators.action_selection.rank import RankDriven
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import is_number

MOST_ASKED = 60
"""Candidates whose feasibility is asked for one choice, before it is given up."""
PASSES = 4
"""Of exchanges over a whole plan."""
STARTS = 2
"""Plans that exchange begins with."""
Feasible = Callable[[Action], str]
"""Whether the bench can do an action: empty, or why not."""


def anything(_: Action) -> str:
    """A bench that can do everything."""
    return ""


@dataclass(frozen=True)
class Goal:
    """When to stop."""

    until: float | None = None
    """Expected NAD that is good enough, a part of 1."""
    budget_s: float | None = None
    """Robot time that may be used, s."""
    most: int = 12
    """Trials at most."""

    def __post_init__(self) -> None:
        for name in ("until", "budget_s"):
            value = getattr(self, name)
            if value is not None and not (is_number(value) and value > 0):
                raise InvalidValueError(f"Goal.{name}", value, "a finite number > 0, or None")
        if isinstance(self.most, bool) or not (isinstance(self.most, int) and self.most >= 1):
            raise InvalidValueError("Goal.most", self.most, "an integer >= 1")

    def met(self, nad: float) -> bool:
        """Whether an expected NAD is good enough."""
        return self.until is not None and nad <= self.until

    def left(self, spent: float) -> float:
        """Robot time that is left, s."""
        return np.inf if self.budget_s is None else self.budget_s - spent


@dataclass(eq=False)
class FeasibilityLog:
    """What the bench has said of candidates; each is asked at most once."""

    feasible: Feasible = anything
    answers: dict[Action, str] = field(default_factory=dict)

    def refused(self, action: Action) -> str:
        """Why the bench cannot do an action; empty where it can."""
        if action not in self.answers:
            self.answers[action] = self.feasible(action)
        return self.answers[action]

    @property
    def rejected(self) -> tuple[tuple[Action, str], ...]:
        """Candidates that were asked for and refused, with the reason."""
        return tuple((action, why) for action, why in self.answers.items() if why)


@dataclass(frozen=True, eq=False)
class Plan:
    """What to do, what it is expected to teach, and why it ends there."""

    before: Belief
    """After the weighing alone."""
    steps: tuple[PlanStep, ...]
    """In order."""
    why: str
    """Why it ends."""
    rejected: tuple[tuple[Action, str], ...]
    """What would have taught more, and why the bench cannot do it."""

    @property
    def seconds(self) -> float:
        """Of the robot, travel included, without the weighing."""
        return sum(step.seconds for step in self.steps)

    @property
    def actions(self) -> tuple[Action, ...]:
        """In order."""
        return tuple(step.action for step in self.steps)

    @property
    def after(self) -> Belief:
        """What would be known in the end."""
        return self.steps[-1].belief if self.steps else self.before


def greedy_choice(
    design: Design, belief: Belief, done: Sequence[Action], goal: Goal, left: float, asked: FeasibilityLog
) -> tuple[int | None, str]:
    """The candidate that teaches most a second of robot time, and if none, why there is none.

    Where a candidate meets the goal by itself, the shortest that does is taken.
    """
    if not design.candidates:
        return None, "there is nothing to grip, or nothing within reach"
    after, seconds = design.values_after(belief), design.seconds(done[-1] if done else None)
    now = design.value(belief)
    gain = np.log(now / np.maximum(after, 1e-300))
    useful = design.unlike(done) & (gain > LEAST_GAIN)
    if not useful.any():
        return None, "no action teaches more"
    affordable = useful & (seconds <= left)
    if not affordable.any():
        return None, f"the budget is spent: {left:.0f} s are left, and the shortest trial that teaches takes " + (
            f"{seconds[useful].min():.0f} s"
        )
    score = np.where(affordable, gain / seconds, -np.inf)
    if goal.until is not None and design.criterion == "I" and now > goal.until:
        ends = affordable & (after <= goal.until)
        score = np.where(ends, 1e6 / seconds, score)
    for count, index in enumerate(_in_order(score)):
        if count == MOST_ASKED:
            break
        if not asked.refused(design.candidates[index]):
            return index, ""
    return None, f"the bench can do none of the {min(MOST_ASKED, int(affordable.sum()))} best"


def greedy_plan(design: Design, before: Belief, goal: Goal, asked: FeasibilityLog) -> Plan:
    """One action after the other, each the best of its moment."""
    steps: list[PlanStep] = []
    belief, spent, why = before, 0.0, ""
    while not why:
        why = _ended(belief, len(steps), goal)
        if not why:
            done = [step.action for step in steps]
            index, why = greedy_choice(design, belief, done, goal, goal.left(spent), asked)
            if index is not None:
                steps.append(_step(design, belief, done, index))
                belief, spent = steps[-1].belief, spent + steps[-1].seconds
    return Plan(before, tuple(steps), why, asked.rejected)


def random_plan(design: Design, before: Belief, goal: Goal, asked: FeasibilityLog) -> Plan:
    """Candidates as they come, where the bench can do them and there is time for them."""
    steps: list[PlanStep] = []
    belief, spent, why = before, 0.0, "there is nothing to grip, or nothing within reach"
    for index, action in enumerate(design.candidates):
        why = _ended(belief, len(steps), goal)
        if why:
            break
        step = _step(design, belief, [step.action for step in steps], index)
        if step.seconds <= goal.left(spent) and not asked.refused(action):
            steps.append(step)
            belief, spent = step.belief, spent + step.seconds
    else:
        why = why or "no other action was drawn that the bench can do in the time that is left"
    return Plan(before, tuple(steps), why, asked.rejected)


def batch_plan(design: Design, before: Belief, goal: Goal, asked: FeasibilityLog) -> Plan:
    """The greedy plan, made better by exchange: each trial against every candidate, the others held fast.

    Where a target is met it is made shorter; else what it leaves unknown is made less, within its time. Exchange ends
    where no single one is better, so it begins anew with a greedy plan of what no plan before began with, and the best
    of all ends is taken.
    """
    index_of = {action: i for i, action in enumerate(design.candidates)}
    first = greedy_plan(design, before, goal, asked)
    left = goal.budget_s if goal.budget_s is not None else first.seconds
    starts = [[index_of[action] for action in first.actions]]
    while len(starts) < STARTS:
        begun = {index for chosen in starts for index in chosen}
        rest = [i for i in range(len(design.candidates)) if i not in begun]
        start = greedy_plan(design.of_some(rest), before, replace(goal, budget_s=left), asked)
        starts.append([index_of[action] for action in start.actions])
    ends = [_settled(design, before, chosen, goal, left, asked) for chosen in starts]
    best = min(ends, key=lambda chosen: _rank(design, before, chosen, goal))
    return as_plan(design, before, best, first.why, asked)


def exhaustive(design: Design, before: Belief, size: int) -> tuple[tuple[int, ...], float]:
    """The best set of so many candidates by trying them all, and the criterion after it: for small designs."""
    from itertools import combinations  # noqa: PLC0415

    best = min(combinations(range(len(design.candidates)), size), key=lambda s: _value(design, before, s))
    return best, _value(design, before, best)


def _settled(
    design: Design, before: Belief, chosen: list[int], goal: Goal, left: float, asked: FeasibilityLog
) -> list[int]:
    """The set when no exchange makes it better."""
    for _ in range(PASSES):
        settled, place = True, 0
        while place < len(chosen):
            better = _exchanged(design, before, chosen, place, goal, left, asked)
            place += better is None or len(better) == len(chosen)
            if better is not None:
                chosen, settled = better, False
        if settled:
            break
    return chosen


def _rank(design: Design, before: Belief, chosen: list[int], goal: Goal) -> tuple[bool, float]:
    """Less is better: whether the target is missed, then time where it is met, else what is left unknown."""
    if goal.met(before.after(_taught(design, chosen)).expected_nad):
        return False, _seconds(design, chosen)
    return True, _value(design, before, chosen)


def _exchanged(
    design: Design, before: Belief, chosen: list[int], place: int, goal: Goal, left: float, asked: FeasibilityLog
) -> list[int] | None:
    """The set with one trial exchanged or dropped, where that is better."""
    others = [c for i, c in enumerate(chosen) if i != place]
    without = before.after(_taught(design, others))
    spent = _seconds(design, others)
    now, mine = _value(design, before, chosen), _seconds(design, chosen)
    meets = goal.until is not None and design.criterion == "I" and now <= goal.until
    if meets and goal.met(design.value(without)) and any(steady(design.candidates[c]) for c in others):
        return others
    after = design.values_after(without)
    seconds = spent + design.seconds(design.candidates[others[-1]] if others else None)
    allowed = design.unlike([design.candidates[c] for c in others])
    if meets:
        score = np.where(allowed & (after <= (goal.until or 0.0)), mine - seconds, -np.inf)
        least = 1e-3
    else:
        score = np.where(allowed & (seconds <= left + 1e-9), np.log(now / np.maximum(after, 1e-300)), -np.inf)
        least = LEAST_GAIN
    for count, index in enumerate(_in_order(score)):
        if score[index] <= least or count == MOST_ASKED:
            return None
        new = [*chosen[:place], index, *chosen[place + 1 :]]
        if _seconds(design, new) <= left + 1e-9 and not asked.refused(design.candidates[index]):
            return new
    return None


def _ended(belief: Belief, trials: int, goal: Goal) -> str:
    """Why no more trials are wanted; empty where they are."""
    if goal.met(belief.expected_nad):
        return "the target is met"
    return f"{goal.most} trials, the most that may be" if trials >= goal.most else ""


def _in_order(score: Float[np.ndarray, "C"]) -> Iterator[int]:
    """Indices by falling score, as long as it is finite."""
    for index in np.argsort(-score, kind="stable"):
        if not np.isfinite(score[index]):
            return
        yield int(index)


def _step(design: Design, belief: Belief, done: Sequence[Action], index: int) -> PlanStep:
    action = design.candidates[index]
    last = done[-1] if done else None
    after = belief.after(design.taught(index))
    seconds = design.time.of(action) + design.time.between(design.shape, last, action)
    return PlanStep(action, seconds, after, design.value(after))


def as_plan(design: Design, before: Belief, chosen: Sequence[int], why: str, asked: FeasibilityLog) -> Plan:
    """Candidates in that order, whatever they teach."""
    steps: list[PlanStep] = []
    for index in chosen:
        done = [step.action for step in steps]
        steps.append(_step(design, steps[-1].belief if steps else before, done, index))
    return Plan(before, tuple(steps), why, asked.rejected)


def rank_driven_plan(shape: ObjectShape, guess: Guess, goal: Goal, grasps: tuple[int, ...], seed: int) -> Plan:
    """The rank-driven policy's actions, as far as the goal goes."""
    actions = RankDriven(grasps=grasps, seed=seed).predicted_actions(shape)
    design, before = Design.of(shape, actions, guess), prior_belief(shape, guess)
    if not actions:
        return Plan(before, (), "there is nothing to grip", ())
    whole = as_plan(design, before, range(len(actions)), "the policy has all that it wants", FeasibilityLog())
    kept, spent = 0, 0.0
    for step in whole.steps:
        last = whole.steps[kept - 1].belief if kept else before
        if kept == goal.most or goal.met(last.expected_nad) or step.seconds > goal.left(spent):
            return Plan(before, whole.steps[:kept], "the goal's trials or time are used, or its target is met", ())
        kept, spent = kept + 1, spent + step.seconds
    return whole


def _taught(design: Design, chosen: Sequence[int] | Int[np.ndarray, "N"]) -> Float[np.ndarray, "S U U"]:
    return np.stack([teaches.information(list(chosen)) for teaches in design.teaches])


def _value(design: Design, before: Belief, chosen: Sequence[int]) -> float:
    return design.value(before.after(_taught(design, chosen)))


def _seconds(design: Design, chosen: Sequence[int]) -> float:
    return design.time.total(design.shape, [design.candidates[c] for c in chosen])


Kind = Literal["random", "greedy", "batch"]
LOOKED_AT = 20
"""Actions that `random` may draw for each that it does."""


@dataclass(frozen=True)
class PlannedPolicy:
    """Actions planned before anything is felt, from uniform masses. A trial that goes wrong is planned around."""

    guess: Guess
    """M, the sensor, and who may carry the weight."""
    kind: Kind = "greedy"
    """greedy: each the best of its moment; batch: the whole exchanged until nothing is better; random: any."""
    criterion: Criterion = "I"
    """What is made small."""
    goal: Goal = field(default_factory=Goal)
    """When to stop."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Which actions are thought of."""
    candidates: int = 4000
    """How many actions are thought of."""
    grasps: tuple[int, ...] | None = None
    """Grasps that may be used; None is all."""
    seed: int = 0
    """Of the draw of candidates, and of `random`'s order."""
    feasible: Feasible = anything
    """What the bench says of an action: empty, or why it cannot be done."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InvalidValueError("PlannedPolicy.kind", self.kind, f"one of {', '.join(get_args(Kind))}")
        if self.candidates < 1:
            raise InvalidValueError("PlannedPolicy.candidates", self.candidates, "an integer >= 1")

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """The first action of the plan that was not tried; where trials failed, of a plan that does without them.

        So it is where the bench has come to refuse an action that it was asked of before. The goal's trials and time
        hold for all that is done.
        """
        failed = tuple(t.action for t in trajectories if not t.ok)
        tried = [t.action for t in trajectories]
        if len(tried) >= self.goal.most:
            return None
        while True:
            action = next((a for a in self.plan(shape, failed).actions if a not in tried), None)
            if action is None or not self.feasible(action):
                break
            failed = (*failed, action)
        if action is None or (failed and self.goal.left(RobotTime().total(shape, [*tried, action])) < 0):
            return None
        return action

    def plan(self, shape: ObjectShape, without: tuple[Action, ...] = ()) -> Plan:
        """What to do, without actions that have come to nothing, and what it is expected to teach."""
        return _planned(self, shape, without)

    def sampled(self, shape: ObjectShape) -> tuple[Action, ...]:
        """The candidates."""
        grasps = range(len(shape.grasps)) if self.grasps is None else self.grasps
        return self.family.sample(shape, grasps, self.candidates, self.seed)


@lru_cache(maxsize=8)
def _planned(policy: PlannedPolicy, shape: ObjectShape, failed: tuple[Action, ...]) -> Plan:
    candidates = tuple(action for action in policy.sampled(shape) if action not in failed)
    if policy.kind == "random":  # those that it will look at
        order = np.random.default_rng(policy.seed).permutation(len(candidates))
        candidates = tuple(candidates[i] for i in order[: LOOKED_AT * policy.goal.most])
    design = Design.of(shape, candidates, policy.guess, policy.criterion)
    return _SEARCHES[policy.kind](
        design, prior_belief(shape, policy.guess), policy.goal, FeasibilityLog(policy.feasible)
    )


_SEARCHES = {"random": random_plan, "greedy": greedy_plan, "batch": batch_plan}
