"""An active run in simulation: weigh an object, then choose, simulate and estimate, one trial after the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import spent_seconds
from estimators.action_selection.design import Guess
from estimators.action_selection.online import Decision, OnlinePolicy
from estimators.action_selection.plan import Goal
from scenarios.results.store import Store
from scenarios.results.trials import sensed_trials
from scenarios.runners import FeasibilityCheck, redacted
from scenarios.study.estimates import EstimateTask, estimate
from scenarios.study.trials import simulate
from testbed.actions.base import Action
from testbed.actions.weigh import Weigh
from testbed.errors import InfeasibleTrialError
from testbed.objects.model import ObjectModel
from testbed.sensing.noise import check_reading
from testbed.sensing.presets import preset
from testbed.sensing.windows import weight_of
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Support, Trial

METHOD = "support_aware"
"""Method of the answer: Algorithm 1 where every group rests on its own weight, else what physics allows."""
OnTrial = Callable[[int, Trajectory, Decision, float], None]
"""Callback after each trial: its number, its record, the decision after it, and the robot time so far [s]."""


@dataclass(frozen=True, eq=False)
class ActiveResult:
    """Result of an active run."""

    keys: tuple[str, ...]
    """Keys of its trials, the weighing first."""
    last: Decision
    """Last decision of the policy."""
    robot_s: float
    """Robot time, travel included [s]."""
    row: dict[str, Any]
    """The answer's row of results.parquet."""


@dataclass(frozen=True, eq=False)
class ActiveRun:
    """Settings of an active run."""

    model: ObjectModel
    store: Store
    goal: Goal
    family: ActionFamily
    support: Support
    """True support of the simulated object."""
    assumed: tuple[str, ...]
    """Support models that the policy assumes."""
    sensing: str
    """Name of the sensor's preset."""
    candidates: int
    grasps: tuple[int, ...]
    seed: int
    """Seed of the sensor's errors and of the candidates."""

    def carry_out(self, on_trial: OnTrial, on_weight: Callable[[float], None]) -> ActiveResult:
        """Weigh, then choose and simulate trials until the policy ends, and estimate from all of them.

        Args:
            on_trial: called after each trial.
            on_weight: called with the measured mass [kg].
        """
        keys = [self._simulated(Weigh())]
        weight = weight_of(self._measured(keys)[0])
        check_reading(self.model.name, weight, preset(self.sensing))
        on_weight(weight)
        guess = Guess(weight, preset(self.sensing).stated, supports=self.assumed)
        shape, refused = self.model.shape, dict[Action, str]()
        policy = OnlinePolicy(
            guess,
            self.goal,
            family=self.family,
            candidates=self.candidates,
            grasps=self.grasps,
            seed=self.seed,
            feasible=FeasibilityCheck(shape, guess, refused=refused),
        )
        while True:
            trials = self._measured(keys)[1:]
            decision, spent = policy.decide(shape, trials), spent_seconds(shape, trials)
            if trials:
                on_trial(len(trials), trials[-1], decision, spent)
            if decision.action is None:
                return ActiveResult(tuple(keys), decision, spent, self._answer(keys))
            try:
                keys.append(self._simulated(decision.action))
            except InfeasibleTrialError as error:  # at the true masses; nothing has moved
                refused[decision.action] = redacted(str(error))

    def _simulated(self, action: Action) -> str:
        """Simulate and store a trial; return its key."""
        return simulate(Trial(self.model, action, self.support), SimulationSettings(), self.store)

    def _measured(self, keys: list[str]) -> list[Trajectory]:
        """Trials under one draw of the sensor's errors."""
        return sensed_trials(self.store, tuple(keys), self.sensing, self.seed)

    def _answer(self, keys: list[str]) -> dict[str, Any]:
        """Row of the answer to all trials, estimated and stored as in a sweep."""
        task = EstimateTask(
            truth=self.model,
            support=self.support.name,
            axes={},
            keys=tuple(keys),
            held_out=(),
            failure="",
            sensing=self.sensing,
            seeds=(self.seed,),
            method=METHOD,
            settings={},
            reference=False,
        )
        key = task.result_keys(self.store.draws)[0]
        estimate([(task, self.seed, key)], self.store)
        row = self.store.result(key)
        assert row is not None
        return row | task.labels | {"key": key}
