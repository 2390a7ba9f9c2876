"""Estimates of a scenario: every method gets the same trials, and is compared with the truth."""

from __future__ import annotations

import math
import os
from collections import Counter, deque
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout
from dataclasses import dataclass, field
from functools import cached_property, lru_cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import torch

from estimators.action_selection.cost import spent_seconds
from estimators.base import Estimate, check_estimate, robot_seconds
from estimators.evaluation.judged import judged
from estimators.evaluation.metrics import hinge_columns, mean_particle_distance, normalized_absolute_difference
from estimators.evaluation.statistics import axis_columns
from estimators.registry import METHODS, build_method, code_of, estimates_many, kind_of
from estimators.wrench.support import LOADS
from scenarios.execution.executor import Executor, Failure
from scenarios.results.files import tally
from scenarios.results.store import Store, key_of, keys_of_seeds, object_request
from scenarios.results.table import ResultTable
from scenarios.results.trials import sensed_trials
from scenarios.study.experiment import Experiment, InfeasibleExperiment, Progress, ResultCallback
from testbed.errors import InvalidValueError
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.plugins import placed_errors
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory

_Draw = tuple[tuple[int, ...], "EstimateTask", str]
"""Place among the rows (sensing, method, experiment, seed), task and content key."""
MOST_PARTICLES = 1000
"""Draws of a batch times particles: more gain nothing, and would take memory and leave other workers idle."""


@dataclass(eq=False)
class EstimateRun:
    """Estimates of experiments by every method and sensing, started as soon as the trials of an experiment exist."""

    experiments: Sequence[Experiment]
    store: Store
    table: ResultTable
    """Receives a row for each draw."""
    executor: Executor
    progress: Progress
    on_result: ResultCallback | None = None
    failed: int = 0
    """Estimates that have failed."""
    total: int = field(init=False)
    """Estimates of all experiments."""
    waiting: deque[list[_Draw]] = field(default_factory=deque)
    """Batches of draws to start: draws of one object for a method with `estimate_many`, otherwise single draws."""
    _open: dict[str, dict[str, list[_Draw]]] = field(default_factory=dict)
    """Incomplete batches by object and method, open until the last experiment of the object is added."""
    _objects: dict[Experiment, str] = field(init=False)
    _left: Counter[str] = field(init=False)
    """Number of experiments of each object that are not yet added."""
    _index: dict[Experiment, int] = field(init=False)

    def __post_init__(self) -> None:
        self._index = {experiment: index for index, experiment in enumerate(self.experiments)}
        self._objects = {each: key_of(object_request(each.particles)) for each in self.experiments}
        self._left = Counter(self._objects.values())
        self.total = sum(len(task.seeds) for each in self.experiments for _, task in self._tasks(each))

    def add(self, experiment: Experiment) -> None:
        """Add an experiment whose trials exist, or that has failed."""
        of_object = self._objects[experiment]
        batches = self._open.setdefault(of_object, {})
        for place, task in self._tasks(experiment):
            for seed, key in zip(task.seeds, task.result_keys(self.store.draws), strict=True):
                draw = ((*place, seed), task, key)
                if task.failure:
                    self._put(draw, _failed(seed, task.failure))
                elif self.table.recall(draw[0], task.labels, key):
                    self._show()
                elif (row := self.store.sound_result(key, self.table.marks)) is not None:
                    self._put(draw, row)
                elif not estimates_many(task.method, task.settings):
                    self.waiting.append([draw])
                else:
                    name = key_of({"method": task.method, "settings": task.settings})
                    batches.setdefault(name, []).append(draw)
                    if len(batches[name]) >= MOST_PARTICLES // len(task.truth.shape.particles):
                        self.waiting.append(batches.pop(name))
        self._left[of_object] -= 1
        if not self._left[of_object]:
            left = self._open.pop(of_object).values()
            self.waiting.extend(sorted(left, key=lambda batch: batch[0][1].kind != "diff_lcp"))  # the slowest first

    def start(self) -> bool:
        """Start the next batch; False where none waits."""
        if not self.waiting:
            return False
        batch = self.waiting.popleft()
        draws = [(task, place[-1], key) for place, task, key in batch]
        self.executor.start(partial(self._take, batch), estimate, draws, self.store)
        return True

    def _tasks(self, experiment: Experiment) -> Iterator[tuple[tuple[int, int, int], EstimateTask]]:
        index = self._index[experiment]
        for s, sensing in enumerate(experiment.scenario.sensing):
            if not experiment.draw or experiment.draw[0] == sensing:
                for m, method in enumerate(experiment.scenario.methods):
                    yield (s, m, index), EstimateTask.of(experiment, sensing, method)

    def _take(self, batch: list[_Draw], value: Failure | None) -> None:
        """Store the outcome of a batch; the draws of a failed batch are started again one by one."""
        if isinstance(value, Failure) and len(batch) > 1:
            self.waiting.extendleft([draw] for draw in reversed(batch))
            return
        for draw in batch:
            place, task, key = draw
            if isinstance(value, Failure):
                for trial in task.keys + task.held_out:  # one of them may be damaged: the next run reads them again
                    self.table.marks.pop(f"trials/{trial}", None)
                self.store.put_error("estimates", key, value.detail)
                self._put(draw, _failed(place[-1], value.reason))
            else:  # the row as the next run will read it
                if self.on_result is not None:
                    self.on_result("estimate", key)
                row = self.store.sound_result(key, self.table.marks)
                self._put(draw, row or _failed(place[-1], "it cannot be read back"))

    def _put(self, draw: _Draw, row: dict[str, Any]) -> None:
        place, task, key = draw
        self.table.add(place, task.labels, row | {"key": key})
        self.failed += row.get("status") == "failed"
        self._show()

    def _show(self) -> None:
        self.progress("estimates", len(self.table), self.total, self.failed)


NO_ANSWER = {
    "assumes": "",
    **dict.fromkeys(("nad", "mpd_m", "mpd_open_loop_m", "mpd_turn_m"), math.nan),
    **dict.fromkeys(("mpd_of_truth_m", "mpd_open_loop_of_truth_m", "mpd_turn_of_truth_m"), math.nan),
    **dict.fromkeys(("friction", "mass_kg", "mass_error_kg")),
    **dict.fromkeys(("misfit", "com_error_m", "inertia_error"), math.nan),
    **hinge_columns((), {}),
    "unobserved": "",
    "optimizer": "",
    "loss": math.nan,
}
"""Columns of an answer, for a row without an answer."""
NOT_RUN = dict.fromkeys(("rollouts", "seconds", "trials", "robot_s", "weight_kg"), math.nan) | dict.fromkeys(
    ("group_names", "true_mass_kg", "true_hinge_Nm", "key", "trial_keys", "held_out_keys")
)
"""Further columns, for a row of an estimate that did not finish."""


def _failed(seed: int, why: str) -> dict[str, Any]:
    return NO_ANSWER | NOT_RUN | {"seed": seed, "status": "failed", "message": why}


@dataclass(frozen=True, eq=False)
class EstimateTask:
    """One method on the trials of one experiment under one sensing: all that a worker needs."""

    truth: ObjectModel
    """Object with the estimator's particles."""
    support: str
    axes: dict[str, Any]
    keys: tuple[str, ...]
    held_out: tuple[str, ...]
    failure: str
    """Reason why there are no trials; empty if there are."""
    sensing: str
    seeds: tuple[int, ...]
    """Seeds of the draws."""
    method: str
    """Label of the method."""
    settings: dict[str, Any]
    reference: bool
    """True if the row has the prediction of the held-out turns by the truth: the first method's rows have it."""

    @staticmethod
    def of(experiment: Experiment, sensing: str, method: str) -> EstimateTask:
        """The task of one method on an experiment."""
        scenario = experiment.scenario
        return EstimateTask(
            experiment.particles,
            experiment.support.name,
            experiment.axes,
            tuple(experiment.keys),
            tuple(experiment.held_out_keys),
            experiment.failure,
            sensing,
            (experiment.draw[1],) if experiment.draw else tuple(range(scenario.draws(sensing))),
            method,
            dict(scenario.methods[method]),
            method == next(iter(scenario.methods)),
        )

    @property
    def kind(self) -> str:
        """Name of the method behind the label."""
        return kind_of(self.method, self.settings)

    @property
    def true_support(self) -> str | None:
        """Support under which the truth predicts the held-out turns; None on springs, whose loads no model gives."""
        return self.support if self.reference and self.support in LOADS else None

    def result_keys(self, draws: dict[str, str]) -> list[str]:
        """Content keys of the estimates, one per draw; `draws` is the store's."""
        content = {
            "trials": list(self.keys),
            "held_out": list(self.held_out),
            "sensing": self.sensing,
            "method": self.kind,
            "settings": {k: v for k, v in self.settings.items() if k != "method"},
            "object": object_request(self.truth),
            "reference": self.reference,
            "version": _version(),
        }
        return keys_of_seeds(content | draws | code_of(self.method, self.settings), self.seeds)

    @cached_property
    def labels(self) -> dict[str, Any]:
        """Columns that place a row in the scenario."""
        return {
            "object": self.truth.name,
            "support": self.support,
            "sensing": self.sensing,
            "method": self.method,
            "kind": self.kind,
        } | axis_columns(self.axes)


def estimate(draws: Sequence[tuple[EstimateTask, int, str]], store: Store) -> None:
    """Worker's task: the estimates of some draws of one object by one method: task, seed and content key of each."""
    trials = [sensed_trials(store, task.keys + task.held_out, task.sensing, seed) for task, seed, _ in draws]
    inputs = [drawn[: len(task.keys)] for drawn, (task, _, _) in zip(trials, draws, strict=True)]
    task = draws[0][0]
    truth = _kept(_ByContent(key_of(object_request(task.truth)), task.truth))
    with nullcontext() if task.kind in METHODS else printing_into(store.log(task.method)):
        weights, moved = [weight_of(given[0]) for given in inputs], [given[1:] for given in inputs]
        seeds = [seed for _, seed, _ in draws]
        answers = judged_answers(task.method, task.settings, truth.shape, weights, moved, seeds)
    for (task, seed, key), drawn, given, answer in zip(draws, trials, inputs, answers, strict=True):
        labels = task.labels | {"trial_keys": list(task.keys), "held_out_keys": list(task.held_out)}
        judged = judge(truth, answer, given, drawn[len(given) :], task.true_support)
        store.put_estimate(key, {"seed": seed} | labels | judged, answer, truth.shape)


@dataclass(frozen=True)
class _ByContent:
    """Object model that equals another of the same content."""

    key: str
    """Content key."""
    model: ObjectModel = field(compare=False)


@lru_cache(maxsize=8)
def _kept(given: _ByContent) -> ObjectModel:
    """Model shared by all tasks on an object: each task has a copy, and caches are keyed by the shape's identity."""
    return given.model


@contextmanager
def printing_into(path: Path) -> Iterator[None]:
    """Append the output of another package's code to a file, apart from the tables and safe in a crash."""
    path.parent.mkdir(exist_ok=True)
    with path.open("a", encoding="utf-8", buffering=1) as log, redirect_stdout(log), redirect_stderr(log):
        yield


@contextmanager
def _restored() -> Iterator[None]:
    """Restore the state of the process at the end, which a method may have changed, for later estimates."""
    folder, environment, dtype, errors = Path.cwd(), dict(os.environ), torch.get_default_dtype(), np.geterr()
    try:
        yield
    finally:
        os.chdir(folder)
        os.environ.clear()
        os.environ.update(environment)
        torch.set_default_dtype(dtype)
        np.seterr(**errors)


def judged_answers(
    label: str,
    settings: Mapping[str, Any],
    shape: ObjectShape,
    weights: Sequence[float],
    moved: Sequence[Sequence[Trajectory]],
    seeds: Sequence[int],
) -> list[Estimate]:
    """Answers of a method on draws of one object's trials, judged by their misfit.

    Args:
        label: label of the method.
        settings: its settings.
        shape: geometry and groups.
        weights: M as weighed of each draw, kg.
        moved: trials of each draw, without the weighing.
        seeds: seed of each draw.

    Raises:
        HeftError: the method raised an error, or an answer does not fit the object.
    """
    method: Any = build_method(label, settings)
    called = f"{kind_of(label, settings)}.estimate{'_many' if len(moved) > 1 else ''}()"
    with placed_errors(type(method)), _restored():
        if len(moved) > 1:
            answers = list(method.estimate_many(shape, weights, moved, seeds))
        else:
            answers = [method.estimate(shape, *one) for one in zip(weights, moved, seeds, strict=True)]
    if len(answers) != len(moved):
        raise InvalidValueError(called, f"{len(answers)} answers", f"{len(moved)}, one per draw")
    checked = [check_estimate(called, answer, shape) for answer in answers]
    return [judged(each, shape, weight, given) for each, weight, given in zip(checked, weights, moved, strict=True)]


def infeasible_row(experiment: InfeasibleExperiment) -> tuple[dict[str, Any], dict[str, Any]]:
    """Labels and row of an experiment that the robot cannot do."""
    labels = {"object": experiment.name, "support": experiment.support, "sensing": "", "method": "", "kind": ""}
    row = NO_ANSWER | NOT_RUN | {"seed": 0, "status": "infeasible", "message": experiment.reason}
    return labels | axis_columns(experiment.axes), row


def _unusable(trials: Sequence[Trajectory]) -> str:
    """Numbers of unusable trials by status, for the end of a message; empty where all are ok."""
    amiss = tally(trial.status for trial in trials)
    return f" (of {len(trials)} trials: {amiss})" if amiss else ""


def judge(
    truth: ObjectModel, answer: Estimate, given: list[Trajectory], held_out: list[Trajectory], true_support: str | None
) -> dict[str, Any]:
    """Row of an estimate: its errors against the truth, if known, and of its prediction of the held-out turns.

    With `true_support`, also the errors of the prediction by the truth, which are the same for every method.
    """
    shape = truth.shape
    support = true_support if truth.masses_known else None
    best = mean_particle_distance(shape, truth.truth, held_out, support) if support else None
    row: dict[str, Any] = (
        NO_ANSWER
        | {
            "status": answer.status,
            "message": answer.message + (_unusable(given) if answer.status == "no_data" else ""),
            "assumes": answer.assumes,
            "mpd_of_truth_m": math.nan if best is None else best.end,
            "mpd_open_loop_of_truth_m": math.nan if best is None else best.open_loop,
            "mpd_turn_of_truth_m": math.nan if best is None else best.turn,
            "seconds": answer.seconds,
            "trials": len(given),
            "robot_s": robot_seconds(given[:1]) + spent_seconds(shape, given[1:]),
            "weight_kg": weight_of(given[0]),
            "group_names": list(shape.group_names),
            "true_mass_kg": truth.group_mass.tolist() if truth.masses_known else None,
            "true_hinge_Nm": list(truth.hinge_friction) or None,
            "optimizer": answer.traces[0].method if answer.traces else "",
            "loss": min((min(trace.loss) for trace in answer.traces), default=math.nan),
            "rollouts": answer.diagnostics.get("rollouts", 0.0),
            "misfit": answer.diagnostics.get("misfit", math.nan),
        }
        | hinge_columns(truth.hinge_friction, answer.diagnostics)
    )
    if (error := answer.group_error(shape)) is not None:
        row["mass_error_kg"] = error.tolist()
    if answer.distribution is not None:
        if truth.masses_known:
            row["nad"] = normalized_absolute_difference(shape, answer.distribution, truth.truth)
        row["mass_kg"] = answer.distribution.group_mass(shape).tolist()
        row["friction"] = answer.distribution.friction.tolist()
        predicted = mean_particle_distance(shape, answer.distribution, held_out)
        if predicted is not None:
            row |= {"mpd_m": predicted.end, "mpd_open_loop_m": predicted.open_loop, "mpd_turn_m": predicted.turn}
    if answer.hidden is not None:
        if truth.masses_known:
            row["com_error_m"] = float(np.linalg.norm(answer.hidden.center_of_mass - truth.center_of_mass))
            row["inertia_error"] = answer.hidden.inertia_cm / truth.inertia_cm - 1
        row["unobserved"] = answer.hidden.unobserved
    return row


@lru_cache(maxsize=1)
def _version() -> str:
    return version("heft-testbed")
