"""The estimates of a scenario: every method answers from the same trials, and is held against the truth."""

from __future__ import annotations

import hashlib
import math
import traceback
from concurrent.futures import Future
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any

import numpy as np

from estimators.metrics import mean_particle_distance, normalized_absolute_difference
from estimators.protocol import Estimate
from scenarios.execution import Submit, finished
from scenarios.schema import Scenario
from scenarios.store import Store, key_of
from scenarios.trials import Cell, Progress
from testbed.objects import ObjectModel
from testbed.reduction import weight_of
from testbed.sensing import draw_sensing, preset
from testbed.trajectory import Trajectory


def run_estimates(
    cells: list[Cell], scenario: Scenario, store: Store, submit: Submit, progress: Progress
) -> list[dict[str, Any]]:
    """Ask every method about every cell and sensing; a row a draw, in the scenario's order."""
    running: set[Future[Any]] = set()
    slowest_first = sorted(scenario.methods, key=lambda label: scenario.kind(label) != "diff_lcp")
    for method in slowest_first:
        for cell in cells:
            for sensing in scenario.sensing:
                running.add(submit(estimate, _asked_of(cell), sensing, method, scenario, store))
    rows, total = [], len(running)
    while running:
        for future in finished(running):
            rows += future.result()
        progress("estimates", total - len(running), total)
    order = {
        "support": [s.name for s in scenario.supports()],
        "sensing": scenario.sensing,
        "method": [*scenario.methods],
    }
    return sorted(
        rows, key=lambda row: (*(names.index(row[k]) for k, names in order.items()), row["object"], row["seed"])
    )


@dataclass(frozen=True, eq=False)
class Asked:
    """What a task is told of a cell."""

    truth: ObjectModel
    """With the estimator's particles."""
    support: str
    keys: list[str]
    held_out: list[str]


def _asked_of(cell: Cell) -> Asked:
    return Asked(cell.particles, cell.support.name, cell.keys, cell.held_out_keys)


def estimate(asked: Asked, sensing: str, method: str, scenario: Scenario, store: Store) -> list[dict[str, Any]]:
    """Task: one method on one object's trials, every sensing draw; a row a draw."""
    rows: list[dict[str, Any]] = []
    clean: list[Trajectory] = []
    for seed in range(1 if sensing == "ideal" else scenario.seeds):
        request = {
            "trials": asked.keys,
            "held_out": asked.held_out,
            "sensing": sensing,
            "seed": seed,
            "method": scenario.kind(method),
            "settings": scenario.methods[method],
            "particles": scenario.grid.particles,
            "object": asked.truth.name,
            "version": version("heft"),
        }
        key = key_of(request)
        said = {"object": asked.truth.name, "support": asked.support, "sensing": sensing, "seed": seed}
        row = store.result(key)
        if row is None:
            every = asked.keys + asked.held_out
            clean = clean or [store.trajectory(k) for k in every]
            drawn = [draw_sensing(t, preset(sensing), _draw_seed(seed, i, every[i])) for i, t in enumerate(clean)]
            seen, held_out = drawn[: len(asked.keys)], drawn[len(asked.keys) :]
            try:
                answer = scenario.method(method).estimate(asked.truth.shape, weight_of(seen[0]), seen[1:], seed)
                row = said | judge(asked.truth, answer, seen, held_out)
            except Exception as error:  # a method that raises is a row; the run goes on
                store.put_error(key, traceback.format_exc())
                row = said | {"status": "failed", "message": f"{type(error).__name__}: {error}", "nad": math.nan}
            else:
                store.put_estimate(key, row, answer)
        rows.append(row | {"method": method, "kind": scenario.kind(method)})
    return rows


def judge(truth: ObjectModel, answer: Estimate, seen: list[Trajectory], held_out: list[Trajectory]) -> dict[str, Any]:
    """Hold an answer against the truth, and against turns that it has not seen."""
    shape = truth.shape
    best = mean_particle_distance(shape, truth.truth, held_out)
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


def _draw_seed(seed: int, index: int, key: str) -> int:
    """A stream of its own for every trial of every draw, a repeated trial included."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{index}/{key}".encode()).digest()[:8], "big")
