"""Online choice of actions, each from the estimate of all trials so far and its errors."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Float

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime, spent_seconds
from estimators.action_selection.design import (
    Belief,
    Criterion,
    Design,
    Guess,
    check_criterion,
    expected_nad,
    prior_belief,
    steady,
)
from estimators.action_selection.greedy import MOST_CHECKS, greedy_choice
from estimators.action_selection.plan import FeasibilityLog, Feasible, Goal, always_feasible
from estimators.action_selection.rank import allowed_grasps
from estimators.base import Estimate, Estimator
from estimators.identifiability.information import shown_information
from estimators.identifiability.trailing import GUESS
from estimators.particles.misfit import UNEXPLAINED
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.posterior.estimator import posterior_of
from estimators.posterior.support import DECISIVE
from estimators.support_models.estimator import SupportAware
from testbed.actions.base import Action
from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from testbed.validation import check_integer

LOWEST_FRICTION = 0.02
"""Least friction at which information is taken."""
SMALLEST_PART = 0.05
"""Least particle mass at which information is taken, as a part of the mean."""


@dataclass(frozen=True, eq=False)
class Decision:
    """Next action, and the state of knowledge before it."""

    action: Action | None
    """Next action; None where the run ends."""
    why: str
    """Reason why the run ends, or why a trial is made again; else empty."""
    estimate: Estimate | None
    """Answer to the trials so far; None before the first."""
    nad: float
    """Expected NAD of the answer, or of the planner's belief where there is no answer, as a ratio."""
    even_nad: float
    """Expected NAD of even masses, known from the weight alone, as a ratio."""
    standard_error: Float[np.ndarray, "n_m"]
    """Standard error of each group's mass [kg]: the answer's own, or the planner's where that is larger."""
    supports: tuple[str, ...]
    """Support models that are still assumed."""
    rejected: tuple[tuple[Action, str], ...] = ()
    """More informative actions that were refused, with the reason."""

    @property
    def answered(self) -> bool:
        """True if there is an answer with a finite covariance."""
        return _covariance(self.estimate) is not None


@dataclass(frozen=True)
class OnlinePolicy:
    """Choice, after every trial, of the action with the largest gain per second, given the estimate so far."""

    guess: Guess
    """Weight, sensor, and the support models assumed until the trials decide."""
    goal: Goal = field(default_factory=Goal)
    """Conditions under which it ends."""
    criterion: Criterion = "I"
    """Quantity to minimize."""
    family: ActionFamily = field(default_factory=ActionFamily)
    """Actions to consider."""
    candidates: int = 4000
    """Number of actions to consider."""
    grasps: tuple[int, ...] | None = None
    """Allowed grasps; None is all."""
    seed: int = 0
    """Seed of the candidates."""
    estimator: Estimator = field(default_factory=SupportAware)
    """Method that answers after every trial."""
    feasible: Feasible = always_feasible
    """Check of an action by the robot or simulator."""

    def __post_init__(self) -> None:
        check_criterion("OnlinePolicy.criterion", self.criterion)
        check_integer("OnlinePolicy.candidates", self.candidates)

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action of `decide`."""
        return self.decide(shape, trajectories).action

    def decide(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Decision:
        """Next action, or why there is none.

        Args:
            shape: geometry and grasps.
            trajectories: trials so far, without the weighing.
        """
        grasps, windows = allowed_grasps(shape, self.grasps), observe(shape, trajectories)
        estimate = self.estimator.estimate(shape, self.guess.weight, trajectories, self.seed) if trajectories else None
        setup = self.guess.setup if windows is None else windows.setup
        hinges = _hinges(shape, self.guess, estimate)
        guess = replace(self.guess, supports=_supports(self.guess, estimate), setup=setup, hinge_friction=hinges)
        at = expansion_point(shape, guess, windows, estimate)
        misfit = estimate.diagnostics.get("misfit", 1.0) if estimate is not None else 1.0
        disagree = guess.supports == ("own_weight",) and misfit > UNEXPLAINED
        contradictory = estimate is not None and estimate.status == "contradictory"
        belief = prior = prior_belief(shape, guess)
        if not contradictory:  # else the trials carry no information
            trials = [shown_information(shape, at, trajectories, each) for each in guess.assumptions()]
            information = np.stack([each.information() for each in trials])
            belief = belief.after(information / (misfit if disagree else 1.0))
        nad, error = _uncertainty(belief, estimate)
        answered = _covariance(estimate) is not None
        done = [trajectory.action for trajectory in trajectories]
        log = FeasibilityLog(self.feasible)

        def decision(action: Action | None, why: str) -> Decision:
            return Decision(action, why, estimate, nad, prior.expected_nad, error, guess.supports, log.rejected)

        if self.goal.met(nad) and answered:
            return decision(None, "the target is met")
        if len(trajectories) >= self.goal.most:
            return decision(None, f"the limit of trials ({self.goal.most}) is reached")
        left = self.goal.left(spent_seconds(shape, trajectories))
        if disagree and (fitted := posterior_of(shape, guess.weight, trajectories)) is not None:
            worst = trajectories[max(fitted.by_trial, key=fitted.by_trial.__getitem__)].action
            if done.count(worst) == 1 and RobotTime().of(worst) <= left:
                why = f"the trials disagree (misfit {misfit:.0f}); the one that fits least is done again"
                return decision(worst, why)
        failed = {trajectory.action for trajectory in trajectories if not trajectory.ok}
        candidates = [a for a in self.family.sample(shape, grasps, self.candidates, self.seed) if a not in failed]
        design = Design.of(shape, candidates, guess, self.criterion, at)
        if self.goal.met(nad) or contradictory:
            index = _needed_for_estimate(design, done, left, log)
            why = "there is no answer, and nothing feasible gives one"
        else:
            index, why = greedy_choice(design, belief, done, self.goal, left, log)
        return decision(None, why) if index is None else decision(design.candidates[index], "")


def _needed_for_estimate(design: Design, done: Sequence[Action], left: float, log: FeasibilityLog) -> int | None:
    """Index of the shortest action of the kind that an estimate still needs, where the belief meets the target.

    First a turn, then an accelerated turn, which separates masses from frictions, then other turns, up to the number of
    masses and frictions. For an object without a grasp, pushes.
    """
    turned = sum(steady(action) for action in done)
    allowed = bool(design.shape.grasps) and design.shape.chain is None
    accelerate = allowed and turned > 0 and not any(action.accelerated for action in done)
    if not accelerate and turned > design.shape.n_m + design.shape.n_mu:
        return None
    seconds = design.seconds(done[-1] if done else None)
    for index in np.argsort(seconds):
        action = design.candidates[index]
        kind = (action.turns or not design.shape.grasps) and action.accelerated == accelerate
        if seconds[index] > left or len(log.answers) >= MOST_CHECKS:
            return None
        if kind and action not in done and not log.refusal(action):
            return int(index)
    return None


def _supports(guess: Guess, estimate: Estimate | None) -> tuple[str, ...]:
    """Assumed support models; the one that the test selects, if it is decisive."""
    factor = 0.0 if estimate is None else estimate.diagnostics.get("log10_bayes_factor", 0.0)
    if len(guess.supports) == 1 or abs(factor) < DECISIVE:
        return guess.supports
    return ("own_weight",) if factor > 0 else ("rigid",)


def _hinges(shape: ObjectShape, guess: Guess, estimate: Estimate | None) -> tuple[float, ...] | None:
    """Friction of each hinge [N m], as estimated or guessed."""
    if shape.chain is None or estimate is None:
        return guess.hinge_friction
    guessed = guess.hinge_friction or (GUESS,) * len(shape.chain.hinges)
    return tuple(max(estimate.diagnostics.get(f"hinge_{h}_Nm", each), 0.0) for h, each in enumerate(guessed))


def expansion_point(
    shape: ObjectShape, guess: Guess, windows: Observations | None, estimate: Estimate | None
) -> MassDistribution:
    """Point at which information is taken: the answer, or uniform masses with the friction of the measured drag.

    An underdetermined answer may have a mass of zero. Nothing depends on the friction of that mass, so it would count
    as known.
    """
    if estimate is not None and estimate.distribution is not None and estimate.status != "underdetermined":
        found = estimate.distribution
        mass = np.maximum(found.mass, SMALLEST_PART * guess.weight / len(shape.particles))
        return MassDistribution(mass, np.maximum(found.friction, LOWEST_FRICTION))
    if windows is not None and not bool(windows.accelerated.all()):
        guess = replace(guess, friction=max(windows.drag / (guess.weight * GRAVITY), LOWEST_FRICTION))
    return guess.uniform(shape)


def _covariance(estimate: Estimate | None) -> Float[np.ndarray, "n_m n_m"] | None:
    """Covariance of the answer's particle masses [kg^2]; None without an answer, or where it is not finite."""
    found = None if estimate is None or estimate.distribution is None else estimate.covariance
    return found if found is not None and np.isfinite(found).all() else None


def _uncertainty(belief: Belief, estimate: Estimate | None) -> tuple[float, Float[np.ndarray, "n_m"]]:
    """Expected NAD, and the standard error of each group [kg]: the larger of the planner's and the answer's.

    The answer's errors include the choice of the support model and the bound of masses at zero. Under one rigid body
    they alone count.
    """
    covariance = _covariance(estimate)
    if estimate is None or covariance is None:
        return belief.expected_nad, belief.standard_error
    own = covariance * np.outer(belief.count, belief.count)
    nad = float(expected_nad(own, belief.weight))
    if estimate.status != "assumption_violated" and nad <= belief.expected_nad:
        return belief.expected_nad, belief.standard_error
    return nad, np.sqrt(np.diag(own))
