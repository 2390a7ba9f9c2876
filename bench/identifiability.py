"""Honesty of the error bars, and distance of the answers from the limit: python bench/identifiability.py WHAT FOLDER.

coverage FOLDER  how often the 90 % intervals of Algorithm 1 hold the truth, object by object of a results folder, under
                 fresh draws of a sensor's errors over its trials
bound FOLDER     root mean square error of every method over the Cramer-Rao bound, with the model errors and without
errors FOLDER    the model errors that explain noise-free trials best, at the true masses (maximum likelihood)

Options: --draws N (8), --objects N (all), --support, --sensing.
"""

from __future__ import annotations

import argparse
import math
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from statistics import median

import numpy as np
import torch
from scipy.optimize import minimize
from shared import parser_of, show

from estimators.evaluation.statistics import NINETY
from estimators.hidden_states.equations import FrictionEquations
from estimators.hidden_states.estimator import HiddenStates
from estimators.hidden_states.masses import friction_loads
from estimators.identifiability.information import Assumptions, observed
from estimators.particles.load_groups import LoadGroups
from estimators.particles.observe import observe
from estimators.particles.windows import Observations
from estimators.posterior.on_table import OnTable
from estimators.wrench.model import EXACT, ModelErrors
from scenarios.cli.terminal import open_table
from scenarios.results.estimates import load_results
from scenarios.results.files import read_json
from scenarios.results.store import Store
from scenarios.results.table import rows_of
from scenarios.results.trials import sensed_trials
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class Tried:
    """An object of a results folder, and its trials: the weighing first, turns held out for prediction left out."""

    model: ObjectModel
    store: Store
    keys: tuple[str, ...]

    def draw(self, sensing: str, seed: int) -> tuple[float, list[Trajectory]]:
        """M as weighed and the trials, as one draw of a sensor's errors has them."""
        weighed, *trials = sensed_trials(self.store, self.keys, sensing, seed)
        return weight_of(weighed), trials


def tried(folder: Path, options: argparse.Namespace) -> Iterator[Tried]:
    """Objects with the trials that every method was given, in the order of their names."""
    files = {path.stem: path for path in folder.glob("objects/*/*.toml")}
    for name, keys in sorted(_given(folder, options.support).items())[: options.objects]:
        yield Tried(load_object(str(files.get(name, name))), Store(folder), keys)


def _given(folder: Path, support: str) -> dict[str, tuple[str, ...]]:
    """Trials by object as the estimates name them, a trial that was asked for twice twice."""
    rows = filter(None, map(read_json, sorted(folder.glob("estimates/*/result.json"))))
    named = [row for row in rows if row.get("trial_keys") and row.get("support") == support]
    return {row["object"]: tuple(row["trial_keys"]) for row in named}


def coverage(folder: Path, options: argparse.Namespace) -> None:
    """A row per object."""
    title = f"90 % intervals of hidden_states, {options.support}, {options.sensing}, {options.draws} draws"
    table = open_table("object", "blocks", "held, %", "error over claimed", "NAD, %", title=title)
    scores, draws = [], 1 if options.sensing == "ideal" else options.draws
    for each in tried(folder, options):
        truth, off = each.model.truth.mass, []
        claimed, unanswered = [], 0
        for seed in range(draws):
            answer = HiddenStates().estimate(each.model.shape, *each.draw(options.sensing, seed), seed)
            if answer.distribution is None or answer.covariance is None or not np.isfinite(answer.covariance).all():
                unanswered += 1
                continue
            off.append(answer.distribution.mass - truth)
            claimed.append(np.sqrt(np.diagonal(answer.covariance)))
        if not off:
            table.add_row(each.model.name, str(len(truth)), f"no answer in {unanswered}", "", "")
            continue
        score = np.array(off) / np.array(claimed)
        scores.append(score)
        nad = 100 * np.mean(np.abs(off) @ each.model.shape.particles_per_group) / each.model.total_mass
        row = f"{100 * _held(score):.0f}", f"{math.sqrt(np.mean(score**2)):.2f}", f"{nad:.2f}"
        table.add_row(each.model.name, str(len(truth)), *row)
    show(table)
    if not scores:
        return
    by_object = np.array([_held(score) for score in scores])
    whole = np.concatenate([score.ravel() for score in scores])
    error = by_object.std(ddof=1) / math.sqrt(len(by_object)) if len(by_object) > 1 else math.nan
    print(
        f"{len(scores)} objects, {len(whole)} intervals: {100 * _held(whole):.1f} % hold the truth (by object "
        f"{100 * by_object.mean():.1f} +- {100 * error:.1f}); error over claimed {math.sqrt(np.mean(whole**2)):.2f}"
    )


def _held(score: np.ndarray) -> float:
    return float((np.abs(score) < NINETY).mean())


def bound(folder: Path, options: argparse.Namespace) -> None:
    """Pooled over objects: sum of squared errors over sum of squared bounds, and the median object."""
    objects = list(tried(folder, options))
    limits, of_sensor, own = {}, {}, {}
    for each in objects:
        name, shape, truth = each.model.name, each.model.shape, each.model.truth
        answers, stated, sensor = [], [], []
        for seed in range(options.draws):
            weight, trials = each.draw(options.sensing, seed)
            if seed == 0:
                stated.append(observed(shape, truth, trials).standard_error)
                sensor.append(observed(shape, truth, trials, Assumptions(errors=EXACT)).standard_error)
            answer = HiddenStates().estimate(shape, weight, trials, seed)
            if answer.distribution is not None:
                answers.append((answer.distribution.mass - truth.mass) * shape.particles_per_group)
        limits[name], of_sensor[name], own[name] = stated[0], sensor[0], np.array(answers)
    errors = {"hidden_states (fresh draws)": own} | _stored(folder, options, set(limits))
    title = f"error over the Cramer-Rao bound, {options.support}, {options.sensing}, {len(objects)} objects"
    columns = ("method", "objects", "pooled", "median", "sensor alone: pooled", "median")
    table = open_table(*columns, left=("method",), title=title)
    for method, off in errors.items():
        cells = []
        for limit in (limits, of_sensor):
            parts = [(np.mean(off[n] ** 2, axis=0).sum(), (limit[n] ** 2).sum()) for n in off if len(off[n])]
            pooled = math.sqrt(np.mean([a / b for a, b in parts]))
            cells += [f"{pooled:.2f}", f"{median(math.sqrt(a / b) for a, b in parts):.2f}"]
        table.add_row(method, str(sum(len(each) > 0 for each in off.values())), *cells)
    show(table)


def _stored(folder: Path, options: argparse.Namespace, names: set[str]) -> dict[str, dict[str, np.ndarray]]:
    """Errors of the answers in the folder, kg per group: by method and object."""
    found: dict[str, dict[str, list[np.ndarray]]] = defaultdict(lambda: defaultdict(list))
    for row in rows_of(load_results(folder)):
        if row["object"] not in names or row["mass_kg"] is None:
            continue
        if (row["support"], row["sensing"]) == (options.support, options.sensing):
            found[row["method"]][row["object"]].append(np.subtract(row["mass_kg"], row["true_mass_kg"]))
    return {method: {name: np.array(off) for name, off in by.items()} for method, by in sorted(found.items())}


def errors(folder: Path, options: argparse.Namespace) -> None:
    """Maximum likelihood of (force, torque, pivot, height), with the loads at the truth, over noise-free trials."""
    cases: list[tuple[ObjectModel, Observations]] = []
    for each in tried(folder, options):
        windows = observe(each.model.shape, each.draw("ideal", 0)[1])
        if windows is not None and not each.model.solids:
            cases.append((each.model, windows.where(~windows.accelerated)))

    def minus_log_likelihood(logs: np.ndarray) -> float:
        force, torque, pivot, height = np.exp(logs)
        total = 0.0
        for model, windows in cases:
            q, b, log_volume = _at_truth(model, windows, force, torque, pivot, height)
            missing = b - q
            total += float(missing @ missing) / 2 + log_volume
        return total

    start = np.log([5e-4, 1e-3, 1e-4, 1e-3])
    found = minimize(minus_log_likelihood, start, method="Nelder-Mead", options={"xatol": 0.02, "fatol": 0.3})
    force, torque, pivot, height = np.exp(found.x)
    print(
        f"{len(cases)} objects: force {force:.2g} of the drag, torque {torque:.2g} of itself, pivot {pivot:.2g} m, "
        f"height {height:.2g} m"
    )
    lifts = torch.cat([windows.lift for _, windows in cases]).numpy()
    print(
        f"lift of the nulled gripper: mean {lifts.mean():.3f} N, root mean square {math.sqrt(np.mean(lifts**2)):.3f} N"
    )


def _at_truth(
    model: ObjectModel, windows: Observations, force: float, torque: float, pivot: float, height: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Whitened Q s and b at the true loads, and half the log determinant of the covariance."""
    errors = ModelErrors(pivot_error=pivot, force_error=force, torque_error=torque, height_error=height)
    on_table = OnTable.of(model.shape, windows, "own_weight", errors)
    system = FrictionEquations.about(on_table, model.total_mass, model.truth, errors).whitened()
    loads = friction_loads(model.shape, LoadGroups.of(on_table.table.model).pairs, model.truth)
    return system.q.numpy() @ loads, system.b.numpy(), -float(torch.linalg.slogdet(system.whiten)[1])


def main() -> None:
    """Run one of the measurements."""
    torch.set_num_threads(1)
    parser = parser_of(__doc__, draws=8, objects=10_000, support="own_weight", sensing="ft300s")
    parser.add_argument("what", choices=("coverage", "bound", "errors"))
    parser.add_argument("folder", type=Path)
    options = parser.parse_args()
    {"coverage": coverage, "bound": bound, "errors": errors}[options.what](options.folder, options)


if __name__ == "__main__":
    main()
