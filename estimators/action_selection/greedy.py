"""Plans by greedy search, with or without improvement by exchange."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import Literal, get_args

import numpy as np
from jaxtyping import Float

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import (
    LEAST_GAIN,
    Belief,
    Criterion,
    Design,
    Guess,
    check_criterion,
    prior_belief,
    steady,
)
from estimators.action_selection.plan import FeasibilityLog, Feasible, Goal, Plan, PlanStep, always_feasible, plan_step
from estimators.action_selection.rank import RANK_DRIVEN, allowed_grasps
from testbed.actions.base import Action
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer

Kind = Literal["random", "greedy", "batch"]
Index = Callable[[Design, Belief, np.ndarray, np.ndarray, float], np.ndarray]
"""Index of each candidate, the largest first, from design, belief, the fall of the criterion's logarithm, the robot
time of each [s], and the robot time that is left [s]."""
MOST_CHECKS = 60
"""Greatest number of candidates whose feasibility is checked for one choice."""
PASSES = 4
"""Passes of exchange over a whole plan."""
STARTS = 2
"""Number of plans from which exchange starts."""
NOTHING = "there is nothing to grip or to push, or nothing within reach"
"""Reason for an empty plan."""
DRAWN_PER_TRIAL = 20
"""Actions that a random plan may draw for each trial."""


def gain_rate(
    design: Design, belief: Belief, gain: Float[np.ndarray, "C"], seconds: Float[np.ndarray, "C"], left: float
) -> Float[np.ndarray, "C"]:
    """Fall of the criterion's logarithm per second of robot time."""
    return gain / seconds


@dataclass(frozen=True)
class PlannedPolicy:
    """Actions planned before the first trial, from uniform masses; failed actions are replaced by a new plan."""

    guess: Guess
    """Weight, sensor and assumed support models."""
    kind: Kind = "greedy"
    """greedy: the best action at each step; batch: greedy, improved by exchange; random: candidates at random."""
    criterion: Criterion = "I"
    """Quantity to minimize."""
    goal: Goal = field(default_factory=Goal)
    """Conditions under which it ends."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Actions to consider."""
    candidates: int = 4000
    """Number of actions to consider."""
    grasps: tuple[int, ...] | None = None
    """Allowed grasps; None is all."""
    seed: int = 0
    """Seed of the candidates, and of the order of `random`."""
    feasible: Feasible = always_feasible
    """Check of an action by the robot or simulator."""
    index: Index = gain_rate
    """Value by which greedy chooses."""

    def __post_init__(self) -> None:
        if self.kind not in get_args(Kind):
            raise InvalidValueError("PlannedPolicy.kind", self.kind, f"one of {', '.join(get_args(Kind))}")
        check_criterion("PlannedPolicy.criterion", self.criterion)
        check_integer("PlannedPolicy.candidates", self.candidates)
        if not isinstance(self.grasps, tuple | None):
            raise InvalidValueError("PlannedPolicy.grasps", self.grasps, "a tuple of indices, or None for all")
        for grasp in self.grasps or ():
            check_integer("PlannedPolicy.grasps", grasp, 0)
        if not callable(self.feasible):
            allowed = "a function of an action: empty where it can be done, otherwise why not"
            raise InvalidValueError("PlannedPolicy.feasible", self.feasible, allowed)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """First action of the plan that was not tried; None when done.

        Failed actions, and actions that the robot or simulator now refuses, are excluded from a new plan. The goal's
        number of trials and robot time include failed trials.
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
        """Plan without the given actions, which failed."""
        return _planned(self, shape, without)


@lru_cache(maxsize=8)
def _planned(policy: PlannedPolicy, shape: ObjectShape, failed: tuple[Action, ...]) -> Plan:
    design, log = _prepared(policy, shape)
    kept = [index for index, action in enumerate(design.candidates) if action not in failed]
    if policy.kind == "random":
        order = np.random.default_rng(policy.seed).permutation(len(kept))
        kept = [kept[i] for i in order[: DRAWN_PER_TRIAL * policy.goal.most]]
    greedy = partial(greedy_plan, index=policy.index)
    search = {"random": random_plan, "greedy": greedy, "batch": batch_plan}[policy.kind]
    return search(design.of_some(kept), prior_belief(shape, policy.guess), policy.goal, log)


@lru_cache(maxsize=2)
def _prepared(policy: PlannedPolicy, shape: ObjectShape) -> tuple[Design, FeasibilityLog]:
    """All candidates and their feasibility checks, shared by the plans after failures."""
    alike = replace(policy, kind="greedy", index=gain_rate, goal=Goal(), feasible=always_feasible)
    return _predicted(alike, shape), FeasibilityLog(policy.feasible)


@lru_cache(maxsize=2)
def _predicted(policy: PlannedPolicy, shape: ObjectShape) -> Design:
    """All candidates, shared by the kinds of search."""
    candidates = policy.family.sample(shape, allowed_grasps(shape, policy.grasps), policy.candidates, policy.seed)
    return Design.of(shape, candidates, policy.guess, policy.criterion)


def greedy_choice(
    design: Design,
    belief: Belief,
    done: Sequence[Action],
    goal: Goal,
    left: float,
    log: FeasibilityLog,
    index: Index = gain_rate,
) -> tuple[int | None, str]:
    """Candidate of the largest index, by default the gain per second; or None and the reason.

    If candidates meet the target by themselves, the shortest of them is chosen.
    """
    if not design.candidates:
        return None, NOTHING
    after, seconds = design.values_after(belief), design.seconds(done[-1] if done else None)
    now = design.value(belief)
    gain = np.log(now / np.maximum(after, 1e-300))
    useful = design.novel(done) & (gain > LEAST_GAIN)
    if not useful.any():
        return None, "no action teaches more"
    affordable = useful & (seconds <= left)
    if not affordable.any():
        least = f"{seconds[useful].min():.0f} s"
        return None, f"the budget is spent: {left:.0f} s are left, and the shortest trial that teaches takes {least}"
    score = np.where(affordable, index(design, belief, gain, seconds, left), -np.inf)
    if goal.until is not None and design.criterion == "I" and now > goal.until:
        ends = affordable & (after <= goal.until)
        score = np.where(ends, 1e6 / seconds, score)
    for count, best in enumerate(_in_order(score)):
        if count == MOST_CHECKS:
            break
        if not log.refusal(design.candidates[best]):
            return best, ""
    return None, f"the bench can do none of the {min(MOST_CHECKS, int(affordable.sum()))} best"


def greedy_plan(design: Design, before: Belief, goal: Goal, log: FeasibilityLog, index: Index = gain_rate) -> Plan:
    """Plan of the best action at each step."""
    steps: list[PlanStep] = []
    belief, spent = before, 0.0
    while not (why := goal.ended(belief, len(steps))):
        done = [step.action for step in steps]
        best, why = greedy_choice(design, belief, done, goal, goal.left(spent), log, index)
        if best is None:
            break
        steps.append(plan_step(design, belief, done[-1] if done else None, best))
        belief, spent = steps[-1].belief, spent + steps[-1].seconds
    return Plan(before, tuple(steps), why, log.rejected)


def random_plan(design: Design, before: Belief, goal: Goal, log: FeasibilityLog) -> Plan:
    """Plan of the candidates in their order, without those that are infeasible or too long."""
    steps: list[PlanStep] = []
    belief, spent, why = before, 0.0, NOTHING
    for index, action in enumerate(design.candidates):
        if why := goal.ended(belief, len(steps)):
            break
        step = plan_step(design, belief, steps[-1].action if steps else None, index)
        if step.seconds <= goal.left(spent) and not log.refusal(action):
            steps.append(step)
            belief, spent = step.belief, spent + step.seconds
    why = why or "no other action was drawn that the bench can do in the time that is left"
    return Plan(before, tuple(steps), why, log.rejected)


def rank_driven_plan(
    shape: ObjectShape, guess: Guess, goal: Goal, kind: str, grasps: tuple[int, ...], seed: int
) -> Plan:
    """Plan of a rank-driven policy's actions, up to the limits of the goal."""
    actions = replace(RANK_DRIVEN[kind], grasps=grasps, seed=seed).predicted_actions(shape)
    before = prior_belief(shape, guess)
    if not actions:
        return Plan(before, (), NOTHING)
    whole = Plan.of(Design.of(shape, actions, guess), before, range(len(actions)), "the policy asks for no more")
    belief, spent = before, 0.0
    for count, step in enumerate(whole.steps):
        if goal.ended(belief, count) or step.seconds > goal.left(spent):
            return Plan(before, whole.steps[:count], "the goal's trials or time are used, or its target is met")
        belief, spent = step.belief, spent + step.seconds
    return whole


def batch_plan(design: Design, before: Belief, goal: Goal, log: FeasibilityLog) -> Plan:
    """Greedy plan improved by exchange of each trial for every candidate, the others fixed.

    Where a target is met, exchange shortens the plan; else it lowers the criterion within the plan's time. Exchange
    ends at a local optimum, so it starts again from a greedy plan of the candidates that no earlier start has; the best
    result is returned.
    """
    index_of = {action: i for i, action in enumerate(design.candidates)}
    first = greedy_plan(design, before, goal, log)
    if not first.steps:
        return first
    left = goal.budget_s if goal.budget_s is not None else first.seconds
    starts = [[index_of[action] for action in first.actions]]
    while len(starts) < STARTS:
        in_starts = {index for chosen in starts for index in chosen}
        rest = [i for i in range(len(design.candidates)) if i not in in_starts]
        start = greedy_plan(design.of_some(rest), before, replace(goal, budget_s=left), log)
        starts.append([index_of[action] for action in start.actions])
    exchange = _Exchange(design, before, goal, left, log)
    best = min((exchange.settled(chosen) for chosen in starts), key=exchange.rank)
    return Plan.of(design, before, best, first.why, log)


@dataclass(frozen=True, eq=False)
class _Exchange:
    """Exchange of single trials of a plan, which is a list of candidate indices."""

    design: Design
    before: Belief
    goal: Goal
    left: float
    """Robot time that may be used [s]."""
    log: FeasibilityLog

    def settled(self, chosen: list[int]) -> list[int]:
        """Plan after exchanges until none improves it, at most `PASSES` passes."""
        for _ in range(PASSES):
            settled, place = True, 0
            while place < len(chosen):
                better = self.exchanged(chosen, place)
                place += better is None or len(better) == len(chosen)
                if better is not None:
                    chosen, settled = better, False
            if settled:
                break
        return chosen

    def rank(self, chosen: list[int]) -> tuple[bool, float]:
        """Rank of a plan, less is better: target missed, then time where it is met, else the criterion."""
        after = self.after(chosen)
        met = self.goal.met(after.expected_nad)
        return not met, self.seconds(chosen) if met else self.design.value(after)

    def exchanged(self, chosen: list[int], place: int) -> list[int] | None:
        """Plan with the trial at one place exchanged or dropped, where that improves it."""
        design, until = self.design, self.goal.until
        others = [c for i, c in enumerate(chosen) if i != place]
        without = self.after(others)
        now, seconds_now = design.value(self.after(chosen)), self.seconds(chosen)
        meets = until is not None and design.criterion == "I" and now <= until
        if meets and self.goal.met(design.value(without)) and any(steady(design.candidates[c]) for c in others):
            return others
        after = design.values_after(without)
        seconds = self.seconds(others) + design.seconds(design.candidates[others[-1]] if others else None)
        allowed = design.novel([design.candidates[c] for c in others])
        if meets:
            score, least = np.where(allowed & (after <= (until or 0.0)), seconds_now - seconds, -np.inf), 1e-3
        else:
            gain = np.log(now / np.maximum(after, 1e-300))
            score, least = np.where(allowed & (seconds <= self.left + 1e-9), gain, -np.inf), LEAST_GAIN
        for count, index in enumerate(_in_order(score)):
            if score[index] <= least or count == MOST_CHECKS:
                return None
            new = [*chosen[:place], index, *chosen[place + 1 :]]
            if self.seconds(new) <= self.left + 1e-9 and not self.log.refusal(design.candidates[index]):
                return new
        return None

    def after(self, chosen: Sequence[int]) -> Belief:
        return self.before.after(self.design.information_of(chosen))

    def seconds(self, chosen: Sequence[int]) -> float:
        return self.design.time.total(self.design.shape, [self.design.candidates[c] for c in chosen])


def _in_order(score: Float[np.ndarray, "C"]) -> Iterator[int]:
    """Indices by falling score, as long as it is finite."""
    for index in np.argsort(-score, kind="stable"):
        if not np.isfinite(score[index]):
            return
        yield int(index)
