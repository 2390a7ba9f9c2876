"""Pushes against turns at equal robot time: python bench/pushes.py [--objects N] [--workers N].

Drawn objects of the scenario `random`, with those that no hand can turn, for which it draws others. Each is turned as
there, where it can be, and pushed for as long: at random places (`pushes`), or where a greedy plan has it for an
FT-300S and its camera (`planned pushes`); `planned turns` are such a plan, and `planned` is of both. An object
without turns has as long as the turns of another in the middle. Answers are of `hidden_states` in an ideal world,
under an FT-300S and a camera that sees exactly, and under one with a camera of 30 frames a second. Columns: objects
with an answer that has status ok, median NAD of these in percent and of those that turns leave without one, and the
90 % intervals that hold.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.action_selection.candidates import MOST_PUSHES, ActionFamily
from estimators.action_selection.cost import spent_seconds
from estimators.action_selection.design import Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.plan import Goal
from estimators.action_selection.pushes import RandomPushes
from estimators.action_selection.rank import RANK_DRIVEN
from estimators.base import ActionPolicy, Estimate
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from scenarios.config import load_scenario
from scenarios.policies import Policy
from scenarios.runners import FeasibilityCheck, feasible_grasps, redacted
from testbed.actions.base import Action
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.objects.files import asset_folder
from testbed.objects.model import ObjectModel
from testbed.sensing.noise import draw_sensing, read_scale
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial

SENSORS = ("ideal", "ft300s:camera=exact", "ft300s")
"""Sensors of the rows."""
KINDS = ("turns", "pushes", "planned turns", "planned pushes", "planned")
"""Kinds of trials of the rows."""
CANDIDATES = 2000
"""Actions that a plan of pushes and turns considers."""
TURNING_S = 160.0
"""Robot time of pushes of an object that nobody can turn [s]: the median of turns, as the bench prints it."""


class Judged(NamedTuple):
    """One answer: status ok or not, NAD [%], and the part of its 90 % intervals that hold."""

    ok: bool
    nad: float
    hold: float


def made(model: ObjectModel, policy: ActionPolicy, refused: dict[Action, str], seconds: float) -> list[Trajectory]:
    """Clean trials that a policy asks for, until it is content or the robot time is over."""
    found: list[Trajectory] = []
    with SimulationRunner() as runner:
        while spent_seconds(model.shape, found) < seconds and (action := policy.next(model.shape, found)) is not None:
            try:
                found.append(runner.run_clean(Trial(model, action)))
            except InfeasibleTrialError as error:
                refused[action] = redacted(str(error))
    return [trial for trial in found if trial.ok]


def turns_of(model: ObjectModel) -> list[Trajectory]:
    """Turns and accelerated turns as the scenario `random` has them; none where no grasp can be used."""
    try:
        grasps = feasible_grasps(model.name, Policy().check(model, SimulationSettings(), "bench"))
    except InfeasibleTrialError:
        return []
    refused: dict[Action, str] = {}
    turning = replace(RANK_DRIVEN["reversed_pairs"], pivots=4, duration=9.0, accelerated=4, grasps=grasps)
    return made(model, replace(turning, refused=refused), refused, np.inf)


def planned(model: ObjectModel, seconds: float, grasps: tuple[int, ...], *, pushes: bool = True) -> list[Trajectory]:
    """Trials of a greedy plan of pushes, of turns and slides by the grasps if there are any, or of both, in so long."""
    sensing = preset(SENSORS[-1])
    guess = Guess(read_scale(model.total_mass, sensing, [0]), sensing.stated)
    count = CANDIDATES if grasps else MOST_PUSHES
    refused: dict[Action, str] = {}
    check = FeasibilityCheck(model.shape, guess, refused=refused)
    family, goal = ActionFamily(pushes=pushes), Goal(budget_s=seconds, most=100)
    policy = PlannedPolicy(guess, goal=goal, family=family, candidates=count, grasps=grasps, feasible=check)
    return made(model, policy, refused, seconds)


def answered(model: ObjectModel, clean: Sequence[Trajectory], sensor: str) -> Estimate:
    """The estimate from trials under one draw of a sensor."""
    sensing = preset(sensor)
    trials = [draw_sensing(trial, sensing, index) for index, trial in enumerate(clean)]
    return HiddenStates().estimate(model.shape, read_scale(model.total_mass, sensing, [0]), trials, 0)


def judged(model: ObjectModel, clean: Sequence[Trajectory], sensor: str) -> Judged:
    """The answer from trials under one draw of a sensor; not ok without trials."""
    try:
        return compared(model, answered(model, clean, sensor))
    except HeftError:
        return Judged(False, np.nan, np.nan)


def compared(model: ObjectModel, found: Estimate) -> Judged:
    """The estimate against the truth."""
    if found.distribution is None or found.covariance is None:
        return Judged(False, np.nan, np.nan)
    off = np.abs(found.distribution.mass - model.truth.mass)
    hold = float(np.mean(off <= 1.645 * np.sqrt(np.diag(found.covariance)) + 1e-9))
    nad = normalized_absolute_difference(model.shape, found.distribution, model.truth)
    return Judged(found.status == "ok", 100 * nad, hold)


def answers(index: int) -> tuple[str, float, dict[tuple[str, str], Judged]]:
    """An object's name, the robot time of its turns [s], and its answers by kind of trial and sensor."""
    torch.set_num_threads(1)
    family = load_scenario("random")[1].random[0]
    model = family.draw(index, 0).build(3, Path(asset_folder("objects")))
    turned = turns_of(model)
    seconds = spent_seconds(model.shape, turned)
    allowed = seconds or TURNING_S
    refused: dict[Action, str] = {}
    kinds = {"turns": turned, "pushes": made(model, RandomPushes(100, index, refused), refused, allowed)}
    by = tuple(sorted({trial.action.grasp for trial in turned if trial.action.grasp is not None}))
    kinds["planned pushes"] = planned(model, allowed, ())
    kinds["planned turns"] = planned(model, allowed, by, pushes=False) if by else []
    kinds["planned"] = planned(model, allowed, by) if by else kinds["planned pushes"]
    return (
        model.name,
        seconds,
        {(kind, sensor): judged(model, kinds[kind], sensor) for kind in kinds for sensor in SENSORS},
    )


def rows(every: Sequence[dict[tuple[str, str], Judged]]) -> Iterator[tuple[str, ...]]:
    """Rows of the table."""
    for sensor in SENSORS:
        open_to = [not each["turns", sensor].ok for each in every]
        for kind in KINDS:
            found = [each[kind, sensor] for each in every]
            known = [one for one in found if one.ok]
            others = [one.nad for one, turned in zip(found, open_to, strict=True) if turned and one.ok]
            yield (
                sensor,
                kind,
                f"{len(known)} of {len(found)}",
                f"{np.median([one.nad for one in known]):.2g}" if known else "-",
                f"{np.median(others):.2g} ({len(others)})" if others else "-",
                f"{100 * np.mean([one.hold for one in known]):.0f}" if known else "-",
            )


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--objects", type=int, default=20)
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    every, turning = [], []
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        for name, seconds, found in pool.map(answers, range(given.objects)):
            print(f"{name}: turns of {seconds:.0f} s", *(f"{one.nad:.2g}" for one in found.values()), flush=True)
            every.append(found)
            turning += [seconds] * (seconds > 0)
    table = Table(box=box.SIMPLE, title=f"NAD, %, in equal robot time, {np.median(turning):.0f} s in the median")
    for heading in ("sensor", "trials", "ok", "NAD", "NAD without turns", "90 % hold"):
        table.add_column(heading, justify="left" if heading in ("sensor", "trials") else "right")
    for row in rows(every):
        table.add_row(*row)
    Console(width=110).print(table)


if __name__ == "__main__":
    main()
