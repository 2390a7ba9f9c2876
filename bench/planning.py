"""Planning: its speed, and what it saves: python bench/planning.py WHAT [options].

speed      sampling, information of all candidates, the next action, plans of six actions; with brute force beside it
length     what the model misses in turns of 4, 8 and 16 s each way, noise-free, both ways' mean and half difference
policies   NAD against robot seconds for every policy, expected against achieved, in simulation under a sensor
more       what more turns buy: expected NAD after 1 to 8 planned turns

Options: --objects N drawn objects, in turn with the library's six (4), --first N of these (all), --draws N of the
sensor (4), --workers N (2), --sensing (ft300s), --policies NAMES (all), --figure FILE, --rows FILE (keeps what was
measured; goes on from it).
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import replace
from functools import cache
from itertools import product, zip_longest
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np
import torch
from matplotlib.figure import Figure

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.cost import spent_seconds
from estimators.action_selection.design import Design, Guess, prior_belief
from estimators.action_selection.greedy import PlannedPolicy, batch_plan, greedy_choice, greedy_plan
from estimators.action_selection.online import OnlinePolicy
from estimators.action_selection.plan import FeasibilityLog, Goal
from estimators.action_selection.rank import RANK_DRIVEN, RankDriven
from estimators.action_selection.trained import SHIPPED, TrainedIndex
from estimators.base import ActionPolicy
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.trial_windows import TrialWindows
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.wrench.model import ModelErrors
from scenarios.policies import Policy
from scenarios.runners import FeasibilityCheck, feasible_grasps, redacted
from testbed.actions.base import Action
from testbed.errors import HeftError, InfeasibleTrialError
from testbed.files import write_whole
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


def speed(options: argparse.Namespace) -> None:
    """Seconds of one core, best of three, for 10 000 candidates."""
    for name in ("L2", "hammer"):
        model = load_object(name)
        shape, guess = model.shape, Guess(model.total_mass, preset(options.sensing))
        family, grasps = ActionFamily(), range(len(shape.grasps))
        candidates = family.sample(shape, grasps, 10_000, 0)
        design, before = Design.of(shape, candidates, guess), prior_belief(shape, guess)
        few = design.of_some(range(200))
        print(f"{name}: {len(candidates)} candidates")
        print(f"  sampling {_best(lambda: family.sample(shape, grasps, 10_000, 0)):.3f} s")  # noqa: B023
        print(f"  information of all {_best(lambda: Design.of(shape, candidates, guess)):.3f} s")  # noqa: B023
        goal, free = Goal(most=6), FeasibilityLog
        one = _best(lambda: greedy_choice(design, before, [], Goal(), np.inf, free()))  # noqa: B023
        print(f"  next action {one:.3f} s")
        print(f"  greedy plan of six {_best(lambda: greedy_plan(design, before, goal, free())):.3f} s")  # noqa: B023
        print(f"  batch plan of six {_best(lambda: batch_plan(design, before, goal, free())):.3f} s")  # noqa: B023
        update = _best(lambda: few.values_after(before))  # noqa: B023
        afresh = _best(lambda: [few.value(before.after(few.information_of([i]))) for i in range(200)])  # noqa: B023
        print(f"  against an inverse a candidate: {afresh / update:.0f} times as fast (200 candidates)")


def _best(call: Callable[[], object]) -> float:
    found = []
    for _ in range(3):
        begin = time.perf_counter()
        call()
        found.append(time.perf_counter() - begin)
    return min(found)


def length(options: argparse.Namespace) -> None:
    """Wrenches less the model's at the true masses, as parts of the drag and of the torque of turning in place."""
    runner, table = SimulationRunner(), {seconds: list[np.ndarray]() for seconds in (4.0, 8.0, 16.0)}
    for model, seconds in product(drawn(options.objects, options.seed), table):
        shape, family = model.shape, ActionFamily(duration=(seconds - 0.01, seconds), slides=False, accelerated=False)
        for action in family.sample(shape, range(len(shape.grasps)), 5, options.seed):
            try:
                windows = observe(shape, [draw_sensing(runner.run_clean(Trial(model, action)), preset("ideal"), 0)])
            except InfeasibleTrialError:
                continue
            if windows is not None and len(windows) == 2:
                table[seconds].append(_missed(model, windows))
    print("root mean square, %: force x, force y, torque")
    for seconds, found in table.items():
        there, back = np.moveaxis(np.array(found), 1, 0)
        parts = [", ".join(f"{100 * v:.3f}" for v in np.sqrt((x**2).mean(0))) for x in (there + back, there - back)]
        print(
            f"{seconds:4.0f} s each way, {len(found)} turns: mean of both {parts[0]}; half their difference {parts[1]}"
        )


def _missed(model: ObjectModel, windows: Observations) -> np.ndarray:
    """Wrench of a turn there and back, halved, (2, 3)."""
    trials = TrialWindows.about(model.shape, model.total_mass, windows, ModelErrors())
    equations, loads = trials.friction_equations(model.truth), torch.tensor(trials.friction_loads(model.truth))
    scale = trials.linear_rows(model.truth, windows).sum_of_drag[0]
    return ((equations.b - equations.q @ loads).reshape(2, 3) / scale / 2).numpy()


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
                _keep(rows, options.rows)
    _told(rows)
    if options.figure is not None:
        _draw(rows, options.figure)


def _keep(rows: list[dict[str, Any]], path: Path) -> None:
    write_whole(path, lambda part: part.write_text(json.dumps(rows)))


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


def _told(rows: list[dict[str, Any]]) -> None:
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


def _draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Median and quartiles of NAD against robot time, logarithmic."""
    objects, kinds = (list(dict.fromkeys(row[key] for row in rows)) for key in ("object", "policy"))
    figure = Figure(figsize=(7.2, 3.6), layout="constrained")
    axis, grid = figure.subplots(), np.arange(15, 235, 2.0)
    for kind in kinds:
        runs = [[r for r in rows if (r["object"], r["policy"]) == (o, kind)] for o in objects]
        found = 100 * np.array([[_at(one, t) for t in grid] for one in runs])
        shown = np.isfinite(found).mean(axis=0) > 0.5
        low, middle, high = np.nanpercentile(found[:, shown], [25, 50, 75], axis=0)
        axis.plot(grid[shown], middle, label=kind, drawstyle="steps-post")
        axis.fill_between(grid[shown], low, high, step="post", alpha=0.12)
    axis.set_yscale("log")
    axis.set_xlabel("robot time, s")
    axis.set_ylabel("NAD, %")
    axis.set_title(f"median and quartiles of {len(objects)} objects")
    figure.legend(loc="outside right upper", fontsize=8)
    figure.savefig(path, dpi=150)


def main() -> None:
    """Choose what to measure."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    kinds = {"speed": speed, "length": length, "policies": policies, "more": more}
    parser.add_argument("what", choices=kinds)
    parser.add_argument("--objects", type=int, default=4)
    parser.add_argument("--first", type=int, default=None)
    parser.add_argument("--draws", type=int, default=4)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--sensing", default="ft300s")
    parser.add_argument("--policies", nargs="+", choices=COMPARED, default=COMPARED)
    parser.add_argument("--figure", type=Path, default=None)
    parser.add_argument("--rows", type=Path, default=None)
    options = parser.parse_args()
    torch.set_num_threads(1)
    try:
        kinds[options.what](options)
    except HeftError as error:
        parser.error(str(error))


if __name__ == "__main__":
    main()
