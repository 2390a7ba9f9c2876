"""The estimates of a scenario: every method answers from the same trials, and is held against the truth."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version
from typing import Any

import numpy as np

from estimators.base import Estimate
from estimators.evaluation.metrics import mean_particle_distance, normalized_absolute_difference
from estimators.evaluation.statistics import axis_columns
from estimators.registry import build_method, code_of, kind_of
from scenarios.execution.executor import Executor, Failure
from scenarios.results.store import Store, key_of, object_request
from scenarios.study.experiment import Cell, Infeasible, Made, Progress
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import draw_sensing, preset
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory


def run_estimates(
    cells: list[Cell],
    left_out: list[Infeasible],
    store: Store,
    executor: Executor,
    progress: Progress,
    made: Made | None = None,
) -> list[dict[str, Any]]:
    """Ask every method about every cell and sensing; a row a draw, in the scenario's order."""
    rows: dict[tuple[int, ...], dict[str, Any]] = {}
    waiting: list[tuple[tuple[int, ...], Asked]] = []
    for index, cell in enumerate(cells):
        for s, sensing in enumerate(cell.scenario.sensing):
            if cell.felt and cell.felt[0] != sensing:
                continue
            for m, method in enumerate(cell.scenario.methods):
                waiting.append(((s, m, index), Asked.of(cell, sensing, method)))
    total, failed = sum(len(asked.seeds) for _, asked in waiting), 0
    waiting.sort(key=lambda item: item[1].kind != "diff_lcp")  # the slowest first

    def take(place: tuple[int, ...], asked: Asked, key: str, row: dict[str, Any]) -> None:
        nonlocal failed
        rows[place] = row | asked.labels() | {"key": key}
        failed += row.get("status") == "failed"
        progress("estimates", len(rows), total, failed)

    def wait() -> None:
        (place, asked, key), value = executor.wait()
        if isinstance(value, Failure):
            store.put_error(key, value.detail)
            take(place, asked, key, _failed(place[-1], value.reason))
        else:  # the row as the next run will read it
            if made is not None:
                made("estimate", key)
            take(place, asked, key, store.result(key) or _failed(place[-1], "its result.json cannot be read back"))

    for place, asked, key in _draws(waiting):
        row = _failed(place[-1], asked.failure) if asked.failure else store.result(key)
        if row is not None:
            take(place, asked, key, row)
            continue
        while executor.running >= executor.capacity:
            wait()
        executor.start((place, asked, key), estimate, asked, place[-1], key, store)
    while executor.running:
        wait()
    return [rows[place] for place in sorted(rows)] + [_infeasible(cell) for cell in left_out]


def _failed(seed: int, why: str) -> dict[str, Any]:
    return {"seed": seed, "status": "failed", "message": why}


def _draws(waiting: Iterable[tuple[tuple[int, ...], Asked]]) -> Iterator[tuple[tuple[int, ...], Asked, str]]:
    """Place, question and content key of every draw; a task each, so that one that hangs takes no other with it."""
    for place, asked in waiting:
        for seed, key in zip(asked.seeds, asked.result_keys(), strict=True):
            yield (*place, seed), asked, key


@dataclass(frozen=True, eq=False)
class Asked:
    """One method on one cell's trials under one sensing: all that a task is told."""

    truth: ObjectModel
    """With the estimator's particles."""
    support: str
    axes: dict[str, Any]
    keys: tuple[str, ...]
    held_out: tuple[str, ...]
    failure: str
    """Why there are no trials, if there are none."""
    sensing: str
    seeds: tuple[int, ...]
    """Of the draws that are asked about."""
    method: str
    """Its label."""
    settings: dict[str, Any]
    reference: bool
    """Whether to say how the truth itself predicts the held-out turns: it is the same for every method."""

    @staticmethod
    def of(cell: Cell, sensing: str, method: str) -> Asked:
        """Of a cell."""
        scenario = cell.scenario
        return Asked(
            cell.particles,
            cell.support.name,
            cell.axes,
            tuple(cell.keys),
            tuple(cell.held_out_keys),
            cell.failure,
            sensing,
            (cell.felt[1],) if cell.felt else tuple(range(scenario.draws(sensing))),
            method,
            dict(scenario.methods[method]),
            method == next(iter(scenario.methods)),
        )

    @property
    def kind(self) -> str:
        """Which method the label stands for."""
        return kind_of(self.method, self.settings)

    def result_keys(self) -> list[str]:
        """Content key of every draw's answer."""
        said = {
            "trials": list(self.keys),
            "held_out": list(self.held_out),
            "sensing": self.sensing,
            "method": self.kind,
            "settings": {k: v for k, v in self.settings.items() if k != "method"},
            "object": object_request(self.truth),
            "reference": self.reference,
            "version": _version(),
        } | code_of(self.kind)
        return [key_of(said | {"seed": seed}) for seed in self.seeds]

    def labels(self) -> dict[str, Any]:
        """What a row says of where it belongs."""
        return {
            "object": self.truth.name,
            "support": self.support,
            "sensing": self.sensing,
            "method": self.method,
            "kind": self.kind,
        } | axis_columns(self.axes)


def estimate(asked: Asked, seed: int, key: str, store: Store) -> None:
    """Task: the answer to one draw."""
    drawn = sensed(store, asked.keys + asked.held_out, asked.sensing, seed)
    seen, held_out = drawn[: len(asked.keys)], drawn[len(asked.keys) :]
    method = build_method(asked.method, asked.settings)
    answer = method.estimate(asked.truth.shape, weight_of(seen[0]), seen[1:], seed)
    said = asked.labels() | {"trial_keys": list(asked.keys), "held_out_keys": list(asked.held_out)}
    row = {"seed": seed} | said | judge(asked.truth, answer, seen, held_out, reference=asked.reference)
    store.put_estimate(key, row, answer, asked.truth.shape)


def sensed(store: Store, keys: tuple[str, ...], sensing: str, seed: int) -> list[Trajectory]:
    """Trials as one draw of a sensor's errors has them; measured ones as they are.

    Args:
        store: where they are.
        keys: in the order in which they were asked for, the weighing first, the held-out ones last.
        sensing: name of the preset.
        seed: of the draw.
    """
    return [as_felt(t, sensing, seed, i, keys[i]) for i, t in enumerate(_trajectories(store, keys))]


def as_felt(trajectory: Trajectory, sensing: str, seed: int, index: int, key: str) -> Trajectory:
    """One of them, the `index`-th of its cell."""
    if not is_simulated(trajectory):
        return trajectory
    return draw_sensing(trajectory, preset(sensing), _draw_seed(seed, index, key))


def is_simulated(trajectory: Trajectory) -> bool:
    """Whether a record is a simulation's, whose sensor had no errors."""
    return trajectory.provenance.get("runner") == "simulation"


@lru_cache(maxsize=1)
def _trajectories(store: Store, keys: tuple[str, ...]) -> tuple[Trajectory, ...]:
    """Of one cell: a worker is mostly asked about the same cell as just before."""
    return tuple(store.trajectory(key) for key in keys)


def _infeasible(cell: Infeasible) -> dict[str, Any]:
    said = {"object": cell.name, "support": cell.support, "sensing": "", "seed": 0, "method": "", "kind": ""}
    return said | axis_columns(cell.axes) | {"status": "infeasible", "message": cell.reason}


def judge(
    truth: ObjectModel, answer: Estimate, seen: list[Trajectory], held_out: list[Trajectory], *, reference: bool
) -> dict[str, Any]:
    """Hold an answer against the truth, and against turns that it has not seen.

    With `reference`, also say how the truth itself predicts those turns: it is the same for every method.
    """
    shape = truth.shape
    best = mean_particle_distance(shape, truth.truth, held_out) if reference else None
    row: dict[str, Any] = {
        "status": answer.status,
        "message": answer.message,
        "nad": math.nan,
        "mpd_open_loop_m": math.nan,
        "mpd_turn_m": math.nan,
        "mpd_open_loop_of_truth_m": math.nan if best is None else best.open_loop,
        "mpd_turn_of_truth_m": math.nan if best is None else best.turn,
        "seconds": answer.seconds,
        "trials": len(seen),
        "robot_s": float(sum(t.time_s[-1] for t in seen)),
        "weight_kg": weight_of(seen[0]),
        "group_names": list(shape.group_names),
        "true_mass_kg": truth.group_mass.tolist(),
        "friction": None,
        "mass_kg": None,
        "com_error_m": math.nan,
        "inertia_error": math.nan,
        "unobserved": "",
        "optimizer": answer.traces[0].method if answer.traces else "",
        "loss": min((min(trace.loss) for trace in answer.traces), default=math.nan),
        "rollouts": answer.diagnostics.get("rollouts", 0.0),
    }
    if answer.distribution is not None:
        row["nad"] = normalized_absolute_difference(shape, answer.distribution, truth.truth)
        row["mass_kg"] = (answer.distribution.mass * shape.particles_per_group).tolist()
        row["friction"] = answer.distribution.friction.tolist()
        predicted = mean_particle_distance(shape, answer.distribution, held_out)
        if predicted is not None:
            row |= {"mpd_open_loop_m": predicted.open_loop, "mpd_turn_m": predicted.turn}
    if answer.hidden is not None:
        row["com_error_m"] = float(np.linalg.norm(answer.hidden.center_of_mass - truth.center_of_mass))
        row["inertia_error"] = answer.hidden.inertia_cm / truth.inertia_cm - 1
        row["unobserved"] = answer.hidden.unobserved
    return row


@lru_cache(maxsize=1)
def _version() -> str:
    return version("heft")


def _draw_seed(seed: int, index: int, key: str) -> int:
    """A stream of its own for every trial of every draw, a repeated trial included."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{index}/{key}".encode()).digest()[:8], "big")
