"""The next action from all that was felt so far: the answer, how sure it is, and what would make it surer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
from jaxtyping import Float

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import (
    Belief,
    Criterion,
    Design,
    Guess,
    expected_nad,
    prior_belief,
    steady,
)
from estimators.action_selection.greedy import MOST_ASKED, FeasibilityLog, Feasible, Goal, anything, greedy_choice
from estimators.base import Estimate, Estimator
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.masses import friction_loads
from estimators.identifiability.information import trial_information
from estimators.particles.lifts import lifts_among
from estimators.particles.windows import Observations, observe, robot_seconds
from estimators.support_models.estimator import SupportAware
from estimators.support_models.selection import DECISIVE
from testbed.actions.base import Accelerate, Action, Rotate
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory

DISAGREE = 5.0
"""Mean squared misfit from which trials disagree by more than their stated errors; about 1 where the model holds."""
LOWEST_FRICTION = 0.02
"""No guess of a friction is lower."""
SMALLEST_PART = 0.05
"""And none of a mass, as a part of the mean particle's."""


@dataclass(frozen=True, eq=False)
class Decision:
    """What to do next, and why."""

    action: Action | None
    """None where there is nothing more to do."""
    why: str
    """Why there is nothing more to do, or why a trial is done again; else empty."""
    estimate: Estimate | None
    """From what was felt so far; None before anything was."""
    nad: float
    """Expected of the answer as it is, or of even masses where there is none; a part of 1."""
    standard_error: Float[np.ndarray, "n_m"]
    """Of each group's mass, kg: the answer's own, or the planner's where that is wider."""
    nad_after: float
    """Expected once the action is done."""
    supports: tuple[str, ...]
    """Support models that are still thought possible."""
    rejected: tuple[tuple[Action, str], ...] = ()
    """What would have taught more, and why the bench cannot do it."""

    @property
    def answered(self) -> bool:
        """Whether there is an answer, and one that leaves nothing open without bound."""
        return _covariance(self.estimate) is not None


@dataclass(frozen=True)
class OnlinePolicy:
    """After every trial the action that teaches most a second, given the answer so far and how sure it is."""

    guess: Guess
    """M, the sensor, and who may carry the weight until the trials tell."""
    goal: Goal = field(default_factory=Goal)
    """When to stop."""
    criterion: Criterion = "I"
    """What is made small."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Which actions are thought of."""
    candidates: int = 4000
    """How many actions are thought of."""
    grasps: tuple[int, ...] | None = None
    """Grasps that may be used; None is all."""
    seed: int = 0
    """Of the draw of candidates."""
    estimator: Estimator = field(default_factory=SupportAware)
    """Who is asked after every trial."""
    feasible: Feasible = anything
    """What the bench says of an action: empty, or why it cannot be done."""

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """As `decide`."""
        return self.decide(shape, trajectories).action

    def decide(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Decision:
        """The next action, or why there is none.

        Args:
            shape: geometry and grasps.
            trajectories: what was felt, the weighing left out.
        """
        windows = observe(shape, trajectories)
        estimate = self.estimator.estimate(shape, self.guess.weight, trajectories, self.seed) if trajectories else None
        guess = replace(self.guess, supports=_supports(self.guess, estimate))
        at = _where(shape, guess, windows, estimate)
        misfit = estimate.diagnostics.get("loss", 1.0) if estimate is not None else 1.0
        own = guess.supports == ("own_weight",)
        contradicted = estimate is not None and estimate.status == "contradictory"
        belief = prior_belief(shape, guess)
        if not contradicted:  # else nothing that was felt can be believed
            inflated = misfit if own and misfit > DISAGREE else 1.0
            belief = belief.after(_felt(shape, guess, at, windows, trajectories) / inflated)
        nad, error = _sure(belief, estimate)
        done = [trajectory.action for trajectory in trajectories]

        def say(action: Action | None, why: str, after: float = nad, asked: FeasibilityLog | None = None) -> Decision:
            rejected = asked.rejected if asked else ()
            return Decision(action, why, estimate, nad, error, after, guess.supports, rejected)

        if self.goal.met(nad) and _covariance(estimate) is not None:
            return say(None, "the target is met")
        if len(trajectories) >= self.goal.most:
            return say(None, f"{self.goal.most} trials were made, the most that may be")
        left = self.goal.left(spent_seconds(shape, trajectories))
        if own and misfit > DISAGREE and windows is not None:
            worst = trajectories[_least_explained(shape, guess.weight, trajectories, windows, at)].action
            if done.count(worst) == 1 and RobotTime().of(worst) <= left:
                return say(worst, f"the trials disagree (misfit {misfit:.0f}); the one that fits least is done again")
        failed = {trajectory.action for trajectory in trajectories if not trajectory.ok}
        grasps = range(len(shape.grasps)) if self.grasps is None else self.grasps
        candidates = [a for a in self.family.sample(shape, grasps, self.candidates, self.seed) if a not in failed]
        design, asked = Design.of(shape, candidates, guess, self.criterion, at), FeasibilityLog(self.feasible)
        if self.goal.met(nad) or contradicted:
            index, why = _for_an_answer(design, done, left, asked), "there is no answer, and nothing feasible gives one"
        else:
            index, why = greedy_choice(design, belief, done, self.goal, left, asked)
        if index is None:
            return say(None, why, nad, asked)
        after = belief.after(design.taught(index)).expected_nad
        return say(design.candidates[index], "", after, asked)


def _for_an_answer(design: Design, done: Sequence[Action], left: float, asked: FeasibilityLog) -> int | None:
    """What is known well enough may not yet be enough for a method: the shortest touch of the kind that is missing.

    First a turn or a slide, then an accelerated turn, which parts masses from frictions, then other turns, as long as
    there are fewer of them than could be needed.
    """
    turned = sum(steady(action) for action in done)
    accelerate = turned > 0 and not any(isinstance(action, Accelerate) for action in done)
    if not accelerate and turned > design.shape.n_m + design.shape.n_mu:
        return None
    seconds = design.seconds(done[-1] if done else None)
    for index in np.argsort(seconds):
        action = design.candidates[index]
        kind = isinstance(action, Accelerate) if accelerate else isinstance(action, Rotate)
        if seconds[index] > left or len(asked.answers) >= MOST_ASKED:
            return None
        if kind and action not in done and not asked.refused(action):
            return int(index)
    return None


def spent_seconds(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> float:
    """Robot time so far, the ways between grasps included, s."""
    time, actions = RobotTime(), [None, *(t.action for t in trajectories)]
    ways = sum(time.between(shape, a, b) for a, b in pairwise(actions) if b is not None)
    return robot_seconds(trajectories) + ways


def _supports(guess: Guess, estimate: Estimate | None) -> tuple[str, ...]:
    """Who may carry the weight, by the test where it is decisive."""
    factor = 0.0 if estimate is None else estimate.diagnostics.get("log10_bayes_factor", 0.0)
    if len(guess.supports) == 1 or abs(factor) < DECISIVE:
        return guess.supports
    return ("own_weight",) if factor > 0 else ("rigid",)


def _where(
    shape: ObjectShape, guess: Guess, windows: Observations | None, estimate: Estimate | None
) -> MassDistribution:
    """Where information is taken: the answer, or uniform masses and the friction that the drag felt makes likely.

    An answer that is any of many may have a mass at zero, where nothing depends on its friction: it would seem known.
    """
    if estimate is not None and estimate.distribution is not None and estimate.status != "underdetermined":
        found = estimate.distribution
        mass = np.maximum(found.mass, SMALLEST_PART * guess.weight / len(shape.particles))
        return MassDistribution(mass, np.maximum(found.friction, LOWEST_FRICTION))
    if windows is not None and not bool(windows.accelerated.all()):
        drag = float(windows.wrench[~windows.accelerated][:, :2].norm(dim=1).max())
        guess = replace(guess, friction=max(drag / (guess.weight * GRAVITY), LOWEST_FRICTION))
    return guess.uniform(shape)


def _felt(
    shape: ObjectShape,
    guess: Guess,
    at: MassDistribution,
    windows: Observations | None,
    trajectories: Sequence[Trajectory],
) -> Float[np.ndarray, "S U U"]:
    """Information of all trials felt, under each support model."""
    count = len(trajectories)
    lifts = lifts_among(shape, trajectories)
    return np.stack(
        [trial_information(shape, at, windows, count, question, lifts).information() for question in guess.questions()]
    )


def _covariance(estimate: Estimate | None) -> Float[np.ndarray, "n_m n_m"] | None:
    """Of the answer, by itself; None where there is no answer, or one that leaves something open without bound."""
    found = None if estimate is None or estimate.distribution is None else estimate.covariance
    return found if found is not None and np.isfinite(found).all() else None


def _sure(belief: Belief, estimate: Estimate | None) -> tuple[float, Float[np.ndarray, "n_m"]]:
    """Expected NAD, and the standard error of each group, kg: the wider of what the planner and the answer say.

    The answer's knows of support models that disagree, and of masses that cannot be below zero: under one rigid body it
    alone counts.
    """
    covariance = _covariance(estimate)
    if estimate is None or covariance is None:
        return belief.expected_nad, belief.standard_error
    its_own = covariance * np.outer(belief.count, belief.count)
    nad = float(expected_nad(its_own, belief.weight))
    if estimate.status != "assumption_violated" and nad <= belief.expected_nad:
        return belief.expected_nad, belief.standard_error
    return nad, np.sqrt(np.diag(its_own))


def _least_explained(
    shape: ObjectShape,
    weight: float,
    trajectories: Sequence[Trajectory],
    windows: Observations,
    at: MassDistribution,
) -> int:
    """The trial whose windows are least what those before them, and the answer, would have them be."""
    evidence = HiddenStates().likelihood(shape, weight, trajectories, at)
    loads = friction_loads(shape, evidence.pairs, at)
    misses = ((evidence.q @ loads - evidence.b) ** 2).reshape(-1, 3).mean(axis=1)
    trial = windows.trial[~windows.accelerated].numpy()
    return int(np.argmax(np.bincount(trial, misses) / np.maximum(np.bincount(trial), 1)))
