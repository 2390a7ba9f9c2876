"""Choice of actions as a Markov decision process: an object, a belief about its masses, and robot time."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Literal, get_args

import gymnasium
import numpy as np
from gymnasium import spaces
from jaxtyping import Float
from matplotlib.backends.backend_agg import FigureCanvasAgg

from estimators.action_selection.box import SIZE, ActionBox
from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import RobotTime
from estimators.action_selection.design import Design, Guess, prior_belief
from estimators.action_selection.online import expansion_point
from estimators.base import Estimator, robot_seconds
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.identifiability.information import predicted_information, shown_information
from estimators.particles.observe import observe
from estimators.testing.analytic_world import analytic_trial
from scenarios.environment.observation import MOST_GRASPS, MOST_GROUPS, observation, observation_space
from scenarios.policies import Policy
from scenarios.runners import feasible_grasps, redacted
from testbed.actions.base import Action
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import MassDistribution, ObjectModel
from testbed.objects.random import Family
from testbed.sensing.noise import draw_sensing, read_scale
from testbed.sensing.presets import preset
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from testbed.validation import check_positive
from viz.figures.maps import error_figure

Backend = Literal["expected", "analytic", "mujoco"]
"""Result of an action: predicted information alone, a record of exact friction, or a simulated trial."""
Reward = Literal["nad", "log_nad", "final"]
"""Fall of the expected NAD or of its logarithm per robot second, or minus the true NAD at the end."""
ATTEMPTS = 100
"""Largest number of draws of an object that the hand can grip."""


class PlanningEnv(gymnasium.Env[dict[str, np.ndarray], np.ndarray]):
    """Episode of actions on one object, truncated when the robot time is spent.

    An action is a point of `ActionBox`. One that is refused ends nothing: it costs the way to the grasp and the time of
    a trial beside the motion. `info` has `seconds` of robot time, `why` the action was refused or failed (else empty),
    `action`, and `expected_nad` as a ratio. Neither it nor the observation holds masses or friction. With "expected"
    an action that nearly repeats another adds nothing, as in a plan: it would repeat the error of the model.

    Args:
        backend: what an action gives. The analytic record has the white noise of the sensor and no other error.
        reward: per step; the sum over steps of "nad" times `info["seconds"]` is the fall of the expected NAD.
        budget_s: robot time of an episode [s].
        object: object or its name; a drawn one in every episode if left out.
        blocks: least and greatest number of blocks of a drawn object, at most 8.
        sensing: preset of the sensor.
        family: actions, without lifts and pushes.
        estimator: method that gives masses from trials.
        render_mode: "rgb_array" for a map of standard errors.
    """

    metadata: ClassVar[dict[str, Any]] = {"render_modes": ["rgb_array"], "render_fps": 1}  # pyright: ignore[reportIncompatibleVariableOverride]

    def __init__(
        self,
        backend: Backend = "expected",
        reward: Reward = "nad",
        budget_s: float = 110.0,
        object: str | ObjectModel | None = None,
        blocks: tuple[int, int] = (2, MOST_GROUPS),
        sensing: str = "ft300s",
        family: ActionFamily | None = None,
        estimator: Estimator | None = None,
        render_mode: str | None = None,
    ):
        for name, value, kind in (("backend", backend, Backend), ("reward", reward, Reward)):
            if value not in get_args(kind):
                raise InvalidValueError(f"PlanningEnv.{name}", value, f"one of {', '.join(get_args(kind))}")
        if reward == "final" and backend == "expected":
            raise InvalidValueError("PlanningEnv.reward", reward, "nad or log_nad: without trials there is no answer")
        check_positive("PlanningEnv.budget_s", budget_s)
        if not 1 < blocks[0] <= blocks[1] <= MOST_GROUPS:
            raise InvalidValueError("PlanningEnv.blocks", blocks, f"the least and the most, from 2 to {MOST_GROUPS}")
        self.backend, self.reward_kind, self.budget_s, self.render_mode = backend, reward, budget_s, render_mode
        self.blocks, self.sensing, self.family = (*blocks,), preset(sensing), family or ActionFamily()
        self.estimator = estimator or HiddenStates()
        self._given = load_object(object) if isinstance(object, str) else object
        groups, grasps = MOST_GROUPS, MOST_GRASPS
        if self._given is not None:
            if not self._given.shape.stands_in_groups or self._given.shape.chain is not None:
                allowed = "a rigid object each of whose mass groups touches the table"
                raise InvalidValueError("PlanningEnv.object", self._given.name, allowed)
            groups, grasps = max(groups, self._given.shape.n_m), max(grasps, len(self._given.shape.grasps))
        self.observation_space = observation_space(groups, grasps)  # pyright: ignore[reportAttributeAccessIssue]
        self.action_space = spaces.Box(-1.0, 1.0, (SIZE,), np.float32)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[dict[str, np.ndarray], dict[str, Any]]:
        """Start an episode with another object, drawn and weighed by the seed."""
        super().reset(seed=seed)
        drawn, weighed, self._noise = (int(n) for n in self.np_random.integers(2**31, size=3))
        mujoco = self.backend == "mujoco"
        self._model, grasps = _drawn(drawn, self.blocks, mujoco) if self._given is None else (self._given, None)
        if grasps is None:
            grasps = _usable(self._model, mujoco)
        self.guess = Guess(read_scale(self._model.total_mass, self.sensing, weighed), self.sensing.stated)
        self.box = ActionBox(self._model.shape, grasps, self.family)
        self.belief = self._prior = prior_belief(self.box.shape, self.guess)
        self.answer: MassDistribution | None = None
        self.left, self.done = self.budget_s, list[Action]()
        self.predictions: dict[Action, Float[np.ndarray, "S U U"]] = {}
        """Predicted information by action; a planner that has it already may add it."""
        self._points, self._trials = list[np.ndarray](), list[Trajectory]()
        return self._observation(), {"expected_nad": self.belief.expected_nad, "seconds": 0.0, "why": "", "action": ""}

    def step(self, action: np.ndarray) -> tuple[dict[str, np.ndarray], float, bool, bool, dict[str, Any]]:
        """Do one action, if it is feasible and the robot time suffices."""
        chosen, before = self.box.action(action), self.belief.expected_nad
        seconds, why = self._attempt(chosen)
        self.left = max(self.left - seconds, 0.0)
        self._points.append(np.append(np.clip(action, -1.0, 1.0), -1.0 if why else 1.0))
        truncated, after = self.left == 0, self.belief.expected_nad
        if self.reward_kind == "final":
            reward = -self._true_nad() if truncated else 0.0
        else:
            reward = (before - after if self.reward_kind == "nad" else float(np.log(before / after))) / seconds
        words = " ".join(part for part in chosen.words(self.box.shape) if part)
        info = {"expected_nad": after, "seconds": seconds, "why": why, "action": words}
        return self._observation(), reward, False, truncated, info

    def render(self) -> np.ndarray | None:  # pyright: ignore[reportIncompatibleMethodOverride]
        """Map of the masses' standard errors, (height, width, 3)."""
        if self.render_mode is None:
            return None
        title = f"expected NAD {100 * self.belief.expected_nad:.2g} %, {self.left:.0f} s left"
        held = ObjectModel("belief", self.box.shape, self.guess.uniform(self.box.shape), masses_known=False)
        canvas = FigureCanvasAgg(error_figure(held, self.belief.standard_error, title))
        canvas.draw()
        return np.asarray(canvas.buffer_rgba())[..., :3].copy()

    def _attempt(self, action: Action) -> tuple[float, str]:
        """Robot time of an action [s], and the reason of a refusal or failure; updates the belief."""
        time = RobotTime()
        way = time.between(self.box.shape, self.done[-1] if self.done else None, action)
        seconds, why = way + time.of(action), self.box.refusal(action)
        if not why and seconds > self.left:
            why = f"it takes {seconds:.0f} s, and {self.left:.0f} s are left"
        if why:
            return way + time.around, why
        if self.backend == "expected":
            if Design(self.box.shape, (action,), ()).unlike(self.done)[0]:
                self.belief = self.belief.after(self._predicted(action))
        else:
            try:
                trial = self._trial(action)
            except InfeasibleTrialError as error:
                return way + time.around, redacted(str(error))
            self._learn(trial)
            why = "" if trial.ok else trial.reason or trial.status
            if self.backend == "mujoco":
                seconds = way + robot_seconds([trial])
        self.done.append(action)
        return seconds, why

    def _predicted(self, action: Action) -> Float[np.ndarray, "S U U"]:
        """Expected information of an action, at uniform masses."""
        if action not in self.predictions:
            shape, at = self.box.shape, self.guess.uniform(self.box.shape)
            each = [predicted_information(shape, at, [action], self.guess.sensing, a) for a in self.guess.assumptions()]
            self.predictions[action] = np.stack([trials.information() for trials in each])
        return self.predictions[action]

    def _trial(self, action: Action) -> Trajectory:
        """Record of an action on the true object, by a sensor with errors.

        Raises:
            InfeasibleTrialError: the simulated robot cannot do it.
        """
        seed = self._noise + len(self._points)
        if self.backend == "analytic":
            noise = (*self.sensing.force_noise, *self.sensing.torque_noise)
            return analytic_trial(self._model, action, noise=noise, seed=seed)  # pyright: ignore[reportArgumentType]
        from testbed.simulation.runner import SimulationRunner  # noqa: PLC0415  without MuJoCo until it is needed

        return draw_sensing(SimulationRunner().run_clean(Trial(self._model, action)), self.sensing, seed)

    def _learn(self, trial: Trajectory) -> None:
        """Update the answer and the belief by one more trial."""
        shape, guess = self.box.shape, self.guess
        self._trials.append(trial)
        estimate = self.estimator.estimate(shape, guess.weight, self._trials, 0)
        at = expansion_point(shape, guess, observe(shape, self._trials), estimate)
        each = [shown_information(shape, at, self._trials, assumed) for assumed in guess.assumptions()]
        self.belief = self._prior.after(np.stack([shown.information() for shown in each]))
        self.answer = estimate.distribution

    def _true_nad(self) -> float:
        """NAD of the answer, or of uniform masses where there is none, as a ratio."""
        shape = self.box.shape
        return normalized_absolute_difference(shape, self.answer or self.guess.uniform(shape), self._model.truth)

    def _observation(self) -> dict[str, np.ndarray]:
        shape = self.box.shape
        mean = (self.answer or self.guess.uniform(shape)).group_mass(shape) / self.guess.weight
        left = self.left / self.budget_s
        return observation(self.observation_space, self.box, self.belief, mean, left, self._points)  # pyright: ignore[reportArgumentType]


@lru_cache(maxsize=64)
def _drawn(seed: int, blocks: tuple[int, int], mujoco: bool) -> tuple[ObjectModel, tuple[int, ...]]:
    """Random block object that the hand can grip, and its usable grasps."""
    family = Family(name="drawn", count=1, seed=seed, blocks=list(blocks))
    for attempt in range(ATTEMPTS):
        model = family.draw(0, attempt).build(3, Path())
        try:
            return model, _usable(model, mujoco)
        except InfeasibleTrialError:
            continue
    raise InfeasibleTrialError(f"none of {ATTEMPTS} objects of {blocks[0]} to {blocks[1]} blocks can be gripped")


def _usable(model: ObjectModel, mujoco: bool) -> tuple[int, ...]:
    """Grasps that may be used; with MuJoCo those about which the robot can turn the object.

    Raises:
        InfeasibleTrialError: there is none.
    """
    if mujoco:
        return feasible_grasps(model.name, Policy().check(model, SimulationSettings(), "environment"))
    if not model.shape.grasps:
        raise InfeasibleTrialError(f"{model.name}: nothing can be gripped")
    return tuple(range(len(model.shape.grasps)))
