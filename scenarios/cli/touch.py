"""`heft touch`: a whole active run in simulation: weigh, then plan, touch and estimate until the masses are sure."""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.design import THOUGHT, Guess
from estimators.action_selection.greedy import Goal
from estimators.action_selection.online import DISAGREE, Decision, OnlineTouches, spent_seconds
from scenarios.cli.plan import family_of, in_words, named_grasps, percent, seconds, sentence
from scenarios.cli.view import record_all, record_results
from scenarios.config import Scenario
from scenarios.results.lock import exclusive
from scenarios.results.store import Store, key_of, trial_request, write_json
from scenarios.study.benches import BenchCheck
from scenarios.study.estimates import Asked, estimate, sensed
from scenarios.study.run import manifest
from scenarios.study.trials import simulate
from testbed.actions.base import Action, Weigh
from testbed.errors import HeftError, InfeasibleTrialError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import preset
from testbed.sensing.windows import weight_of
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial, parse_support

METHOD = "support_aware"
"""Who answers: Algorithm 1 where every group rests on its own weight, else what physics allows."""


@dataclass(frozen=True)
class Wish:
    """What the run is for, and what is true of the simulated table."""

    until: str | None = "5%"
    budget: str | None = None
    sensing: str = "ft300s"
    support: str = "own_weight"
    thought: str = "either"
    most: int = 20
    candidates: int = 4000
    grasps: tuple[str, ...] | None = None
    seed: int = 0
    out: Path | None = None
    record: bool = False
    lifts: bool = False


@dataclass(frozen=True, eq=False)
class Outcome:
    """A run that is over."""

    folder: Path
    keys: tuple[str, ...]
    """Of its trials, the weighing first."""
    last: Decision
    robot_s: float
    row: dict[str, Any]
    """The answer's row of results.parquet."""


def touch(console: Console, name: str, wish: Wish) -> Outcome:
    """Weigh, then plan, touch and estimate in turn until the policy is content; write it all as a results folder.

    Raises:
        InvalidValueError: a grasp, sensor, support or amount that is not there.
    """
    if wish.thought not in THOUGHT:
        raise InvalidValueError("support", wish.thought, f"one of {', '.join(THOUGHT)}")
    model, begin = load_object(name), time.monotonic()
    folder = wish.out or Path("results") / f"touch_{model.name}"
    goal = Goal(percent(wish.until, "--until"), seconds(wish.budget, "--budget"), wish.most)
    family = family_of(wish.thought, lifts=wish.lifts)
    parse_support(wish.support)  # before anything is written
    preset(wish.sensing)
    store = Store(folder.absolute())
    with exclusive(folder):
        store.remove_leftovers()
        run = _Run(console, model, wish, store, family)
        last, keys = run.until(goal)
        row = _answer(model, wish, keys, store)
        scenario = Scenario(objects=[name], support=[wish.support], sensing=[wish.sensing], seeds=1)
        said = manifest(scenario) | {"name": folder.name, "command": f"heft touch {name}"}
        write_json(folder / "manifest.json", said | {"wall_s": round(time.monotonic() - begin, 1)})
        store.put_table([row])
    outcome = Outcome(folder, tuple(keys), last, run.robot_s, row)
    _tell(console, model, outcome, goal)
    if wish.record:
        record_all(folder, console)
    try:
        console.print(f"recording: {record_results(folder)}", highlight=False, soft_wrap=True)
    except HeftError as error:
        console.print(f"no recording: {error}", highlight=False, soft_wrap=True)
    console.print(f"look: heft view {folder}", highlight=False, soft_wrap=True)
    return outcome


@dataclass(eq=False)
class _Run:
    """Trials one after the other, as the policy asks."""

    console: Console
    model: ObjectModel
    wish: Wish
    store: Store
    family: ActionFamily
    robot_s: float = 0.0

    def until(self, goal: Goal) -> tuple[Decision, list[str]]:
        """The last decision, and the keys of all trials."""
        keys = [self._made(Weigh())]
        weight = weight_of(self._felt(keys)[0])
        self.console.print(f"weighed: {weight:.3f} kg", highlight=False)
        guess = Guess(weight, preset(self.wish.sensing), supports=THOUGHT[self.wish.thought])
        shape, refused = self.model.shape, dict[Action, str]()
        policy = OnlineTouches(
            guess,
            goal,
            family=self.family,
            candidates=self.wish.candidates,
            grasps=named_grasps(self.model, self.wish.grasps),
            seed=self.wish.seed,
            feasible=BenchCheck(shape, guess, refused=refused),
        )
        while True:
            felt = self._felt(keys)[1:]
            decision = policy.decide(shape, felt)
            self.robot_s = spent_seconds(shape, felt)
            if felt:
                self._say(len(felt), felt[-1], decision)
            if decision.action is None:
                return decision, keys
            try:
                keys.append(self._made(decision.action))
            except InfeasibleTrialError as error:  # at the true masses; nothing has moved
                refused[decision.action] = str(error)

    def _made(self, action: Action) -> str:
        trial = Trial(self.model, action, parse_support(self.wish.support))
        settings = SimulationSettings()
        simulate(trial, settings, self.store)
        return key_of(trial_request(trial, settings))

    def _felt(self, keys: list[str]) -> list[Trajectory]:
        """As the sensor has it: one draw of its errors."""
        return sensed(self.store, tuple(keys), self.wish.sensing, self.wish.seed)

    def _say(self, number: int, trial: Trajectory, decision: Decision) -> None:
        what = sentence(self.model.shape, trial.action)
        went = "" if trial.ok else f" [{trial.status}: {trial.reason}]"
        again = f"; {decision.why}" if decision.action is not None and decision.why else ""
        sure = f"{self.robot_s:.0f} s of the robot, expected NAD {100 * decision.nad:.3g} %"
        self.console.print(f"{number}: {what}{went}; {sure}{again}", highlight=False, markup=False)


def _answer(model: ObjectModel, wish: Wish, keys: list[str], store: Store) -> dict[str, Any]:
    """Ask the method about all trials as a sweep would, and read its row back."""
    asked = Asked(
        truth=model,
        support=parse_support(wish.support).name,
        axes={},
        keys=tuple(keys),
        held_out=(),
        failure="",
        sensing=wish.sensing,
        seeds=(wish.seed,),
        method=METHOD,
        settings={},
        reference=False,
    )
    key = asked.result_keys()[0]
    estimate(asked, wish.seed, key, store)
    row = store.result(key)
    assert row is not None
    return row | asked.labels() | {"key": key}


def _tell(console: Console, model: ObjectModel, outcome: Outcome, goal: Goal) -> None:
    """How it ended, what the masses are and whether they can be trusted, and what stays unknown."""
    last, row, answer = outcome.last, outcome.row, outcome.last.estimate
    answered = last.answered
    console.print(f"stopped: {last.why}", highlight=False)
    reached = f"expected NAD {100 * last.nad:.3g} %"
    if not answered:
        why = (answer.message if answer is not None else "") or "nothing was felt"
        console.print(f"there is no answer: {why}", highlight=False)
        best = f"the best to be had is the weight, {row['weight_kg']:.3f} kg, and even masses"
        console.print(f"{best}: {reached}", highlight=False)
    elif goal.until is not None and not goal.met(last.nad):
        console.print(f"the target of {100 * goal.until:g} % is not reached: {reached} is the best to be had")
    if answered and np.isfinite(row["nad"]):
        reached += f", against the truth {100 * row['nad']:.3g} %"
    console.print(f"{len(outcome.keys) - 1} touches, {outcome.robot_s:.0f} s of the robot; {reached}", highlight=False)
    misfit = answer.diagnostics.get("loss", 1.0) if answer is not None else 1.0
    if answered and last.supports == ("own_weight",) and misfit > DISAGREE:
        said = "the touches disagree by more than their errors, which are taken to be as much larger"
        console.print(f"{said}: mean squared misfit {misfit:.3g} where about 1 is expected", highlight=False)
    if answered and row.get("mass_kg") is not None:
        masses = zip(row["group_names"], row["mass_kg"], last.standard_error, strict=True)
        console.print(", ".join(f"{g} {m:.3f} ± {e:.3f}" for g, m, e in masses) + " kg", highlight=False)
    open_ = answer.identifiability.unobservable if answer is not None and answer.identifiability is not None else ()
    for part in open_:
        console.print(f"not known: {part}", highlight=False)
    if answered and row.get("message"):
        console.print(f"{row['status']}: {row['message']}", highlight=False)
    for action, why in last.rejected[:3]:
        console.print(f"not feasible: {in_words(model.shape, action)[0]}: {why}", highlight=False)
