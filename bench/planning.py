"""Robot time that planning saves: python bench/planning.py WHAT [options].

policies   NAD against robot seconds for every policy, expected against achieved, in simulation under a sensor
more       what more turns buy: expected NAD after 1 to 8 planned turns

Options: --objects N drawn objects, in turn with the library's six (4), --first N of these (all), --draws N of the
sensor (4), --workers N (2), --sensing (ft300s), --policies NAMES (all), --rows FILE (keeps what was measured; goes on
from it).
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache
from itertools import zip_longest
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import torch
from shared import parser_of

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import spent_seconds
from estimators.action_selection.design import Guess
from estimators.action_selection.greedy import PlannedPolicy
from estimators.action_selection.online import OnlinePolicy
from estimators.action_selection.plan import Goal
from estimators.action_selection.rank import RANK_DRIVEN, RankDriven
from estimators.action_selection.trained import SHIPPED, TrainedIndex
from estimators.base import ActionPolicy
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from scenarios.policies import Policy
from scenarios.runners import FeasibilityCheck, feasible_grasps, redacted
from testbed.actions.base import Action
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.files import write_text
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.objects.random import Family
from testbed.sensing.noise import draw_sensing, read_scale
from testbed.sensing.presets import Sensing, preset
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial

LIBRARY = ("I1", "I2", "L1", "L2", "F1", "F2")
COMPARED = ("published", "reversed_pairs", "random", "greedy", "batch", "trained", "online")
TURNS = 5
"""There and back, so ten of the paper's."""
BUDGET = 110.0
"""Robot time of a planned run, s."""
TIMES = (20, 30, 45, 60, 75, 90, 110, 180, 240)
"""At which policies are compared, s."""


@cache
def drawn(count: int, seed: int) -> tuple[ObjectModel, ...]:
    """Random block objects that the bench can turn about some grasp."""
    family, found = Family(name="drawn", count=count, seed=seed), []
    for index in range(count):
        for attempt in range(100):
            model = family.draw(index, attempt).build(3, Path())
            try:
                feasible_grasps(model.name, Policy().check(model, SimulationSettings(), "bench"))
            except InfeasibleTrialError:
                continue
            found.append(model)
            break
    return tuple(found)


def more(options: argparse.Namespace) -> None:
    """Expected NAD in percent after each turn of a greedy plan."""
    print("expected NAD, %, after so many planned turns; robot seconds")
    for name in LIBRARY:
        model = load_object(name)
        guess = Guess(model.total_mass, preset(options.sensing))
        family = ActionFamily(slides=False, accelerated=False)
        plan = PlannedPolicy(
            guess, goal=Goal(most=8), family=family, feasible=FeasibilityCheck(model.shape, guess)
        ).plan(model.shape)
        spent = np.cumsum([step.seconds for step in plan.steps])
        row = [f"{100 * s.belief.expected_nad:.2f} ({t:.0f} s)" for s, t in zip(plan.steps, spent, strict=True)]
        print(f"| {name} | " + " | ".join(row) + " |")


def policies(options: argparse.Namespace) -> None:
    """Run every policy on every object, then tell."""
    rows: list[dict[str, Any]] = []
    if options.rows is not None and options.rows.is_file():
        rows = json.loads(options.rows.read_text())
    known = {row["object"] for row in rows}
    library = [load_object(name) for name in LIBRARY]
    both = [m for pair in zip_longest(drawn(options.objects, options.seed), library) for m in pair if m]
    asked = [model for model in both[: options.first] if model.name not in known]
    begin = time.perf_counter()
    with ProcessPoolExecutor(options.workers, get_context("spawn"), torch.set_num_threads, (1,)) as pool:
        tasks = [pool.submit(_runs, model, options.sensing, options.draws, options.policies) for model in asked]
        for count, task in enumerate(as_completed(tasks), 1):
            rows += task.result()
            print(f"{count} of {len(asked)} objects, {time.perf_counter() - begin:.0f} s", flush=True)
            if options.rows is not None:
                write_text(options.rows, json.dumps(rows))
    _show(rows)


def _runs(model: ObjectModel, sensing_name: str, draws: int, kinds: Sequence[str]) -> list[dict[str, Any]]:
    """Result of one object."""
    return list(_rows(model, sensing_name, draws, kinds))


def _rows(model: ObjectModel, sensing_name: str, draws: int, kinds: Sequence[str]) -> Iterator[dict[str, Any]]:
    """Rows of an object: NAD after each trial of each policy, mean over draws; 1 draw where the policy sees it."""
    shape, sensing = model.shape, preset(sensing_name)
    weight = read_scale(model.total_mass, sensing, crc32(model.name.encode()))
    guess, runner = Guess(weight, sensing.stated), SimulationRunner()
    grasps = feasible_grasps(model.name, Policy().check(model, SimulationSettings(), "bench"))
    made = cache(lambda action: runner.run_clean(Trial(model, action)))  # greedy and batch have actions in common
    refused: dict[Action, str] = {}

    def tried(action: Action) -> Iterator[Trajectory]:
        """The trial, or none where the bench refuses it at the true masses."""
        try:
            yield made(action)
        except InfeasibleTrialError as error:
            refused[action] = redacted(str(error))

    check = FeasibilityCheck(shape, guess, refused=refused)
    goal = Goal(budget_s=BUDGET, most=20)
    ahead: dict[str, ActionPolicy] = {
        "published": replace(RANK_DRIVEN["published"], accelerated=0, grasps=grasps),
        "reversed_pairs": RankDriven(TURNS, accelerated=0, grasps=grasps, most=TURNS),
        **{
            kind: PlannedPolicy(guess, kind, goal=goal, feasible=check)  # pyright: ignore[reportArgumentType]
            for kind in ("random", "greedy", "batch")
        },
        "trained": PlannedPolicy(guess, goal=goal, index=TrainedIndex.load(SHIPPED), feasible=check),
    }
    for name, policy in ahead.items():
        if name not in kinds:
            continue
        clean: list[Trajectory] = []
        refused.clear()
        while (action := policy.next(shape, clean)) is not None and action not in refused:
            clean += tried(action)
        drawn_ = [[_felt(t, sensing, model, name, draw, i) for i, t in enumerate(clean)] for draw in range(draws)]
        plan = policy.plan(shape, tuple(refused)) if isinstance(policy, PlannedPolicy) else None
        for count in range(1, len(clean) + 1):
            as_planned = plan is not None and plan.actions[:count] == tuple(t.action for t in clean[:count])
            yield {
                "object": model.name,
                "policy": name,
                "robot_s": spent_seconds(shape, clean[:count]),
                "nad": float(np.mean([_nad(model, weight, seen[:count]) for seen in drawn_])),
                "expected": plan.steps[count - 1].belief.expected_nad if plan is not None and as_planned else None,
            }
    if "online" not in kinds:
        return
    online = OnlinePolicy(guess, goal, feasible=check, estimator=HiddenStates())
    felt: list[Trajectory] = []
    refused.clear()
    decision = online.decide(shape, felt)
    while (action := decision.action) is not None:
        felt += [_felt(trial, sensing, model, "online", 0, len(felt)) for trial in tried(action)]
        decision = online.decide(shape, felt)
        if action in refused:
            continue
        yield {
            "object": model.name,
            "policy": "online",
            "robot_s": spent_seconds(shape, felt),
            "nad": _nad(model, weight, felt),
            "expected": decision.nad,
        }


def _felt(clean: Trajectory, sensing: Sensing, model: ObjectModel, policy: str, draw: int, trial: int) -> Trajectory:
    """With errors that no other trial of any object has: else every median would be over the same few draws."""
    return draw_sensing(clean, sensing, crc32(f"{model.name} {policy} {draw} {trial}".encode()))


def _nad(model: ObjectModel, weight: float, felt: Sequence[Trajectory]) -> float:
    """NAD of Algorithm 1's answer, or of uniform masses where it has none."""
    shape = model.shape
    answer = HiddenStates().estimate(shape, weight, felt, 0)
    found = answer.distribution
    if found is None:
        found = Guess(weight, preset("ideal")).uniform(shape)
    return normalized_absolute_difference(shape, found, model.truth)


def _at(rows: Sequence[dict[str, Any]], seconds: float) -> float:
    """NAD of one run as it is after so much robot time; NaN before its first trial."""
    done = [row["nad"] for row in rows if row["robot_s"] <= seconds]
    return done[-1] if done else math.nan


def _show(rows: list[dict[str, Any]]) -> None:
    """NAD over time, the time to the NAD of the rank-driven policies, and expected over achieved."""
    objects, kinds = (list(dict.fromkeys(row[key] for row in rows)) for key in ("object", "policy"))
    run = {(o, k): [r for r in rows if (r["object"], r["policy"]) == (o, k)] for o in objects for k in kinds}
    print(f"NAD, %, after so many robot seconds: median [quartiles] of {len(objects)} objects")
    for kind in kinds:
        cells = []
        for seconds in TIMES:
            found = np.array([_at(run[o, kind], seconds) for o in objects])
            found = 100 * found[np.isfinite(found)]
            cells.append("-" if len(found) < len(objects) / 2 else _band(found))
        print(f"| {kind} | " + " | ".join(cells) + " |")
    for against in sorted({"reversed_pairs", "published"} & {*kinds}):
        last = {o: run[o, against][-1] for o in objects if run[o, against]}
        median = np.median([row["robot_s"] for row in last.values()])
        print(f"robot time to the final NAD of {against}, as a part of its own (median {median:.0f} s)")
        for kind in kinds:
            parts = []
            for o, row in last.items():
                there = [r["robot_s"] for r in run[o, kind] if r["nad"] <= row["nad"]]
                parts.append(there[0] / row["robot_s"] if there else math.inf)
            reached = np.isfinite(parts).sum()
            half = sum(part <= 0.5 for part in parts)
            print(f"| {kind} | {_band(np.array(parts))} | reached on {reached} of {len(parts)}, in half on {half} |")
    for kind in kinds:
        pairs = [
            (r["nad"], r["expected"]) for r in rows if r["policy"] == kind and r["expected"] and r["expected"] < 0.05
        ]
        if pairs:
            ratio = np.array([achieved / expected for achieved, expected in pairs])
            print(f"{kind}: achieved over expected NAD (where below 5 %): {_band(ratio)}, {len(ratio)} steps")


def _band(values: np.ndarray) -> str:
    low, middle, high = np.percentile(values, [25, 50, 75], method="nearest")  # a run that never gets there is infinite
    return f"{middle:.2g} [{low:.2g} {high:.2g}]"


def main() -> None:
    """Choose what to measure."""
    parser = parser_of(__doc__, objects=4, draws=4, workers=2, seed=0, sensing="ft300s")
    kinds = {"policies": policies, "more": more}
    parser.add_argument("what", choices=kinds)
    parser.add_argument("--first", type=int, default=None)
    parser.add_argument("--policies", nargs="+", choices=COMPARED, default=COMPARED)
    parser.add_argument("--rows", type=Path, default=None)
    options = parser.parse_args()
    torch.set_num_threads(1)
    try:
        kinds[options.what](options)
    except HeftError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
