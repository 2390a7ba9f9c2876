"""Gain by lifts under one rigid body: python bench/lift.py OUT.parquet [--random N] [--draws N] [--sensing NAME]

Library objects and drawn ones of six blocks of 0.1 or 0.4 kg are turned, accelerated and lifted on the simulated bench.
Printed are how far the wrench in the air is from Newton's and Euler's, and what support_aware makes of the table alone,
with a lift held still, and with one that is rocked too, a row a draw of the sensor's errors in OUT.parquet.
"""

from __future__ import annotations

import argparse
import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pandas as pd
import torch
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.action_selection.rank import between_particles
from estimators.support_models.estimator import SupportAware
from estimators.wrench.air import Air
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.actions.rotate import Rotate
from testbed.errors import InfeasibleTrialError
from testbed.files import write_whole
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.objects.random import Family
from testbed.sensing.lift_windows import lift_windows
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import RIGID, Trial

MATERIALS = (0.1, 0.4)
LEAST, MOST = 2, 4
"""Grasps that are turned about."""
SECONDS = 6.0
"""Duration of a turn each way."""
RUNNER = SimulationRunner()


@dataclass(frozen=True, eq=False)
class Lifted:
    """An object's clean trials."""

    object: ObjectModel
    table: list[Trajectory]
    held: Trajectory
    rocked: Trajectory


def trials(obj: ObjectModel) -> Lifted | str:
    """Turns and accelerations about inner grasps and two lifts by the innermost that holds; or why there are none."""
    shape = obj.shape
    inner = sorted(range(len(shape.grasps)), key=lambda g: float(np.linalg.norm(shape.grasps[g].position)))
    table, turned, why = [], 0, "no grasp"
    for grasp in inner:
        pivot = between_particles(shape, shape.grasps[grasp].position)
        found = [_done(obj, a) for a in (Rotate(grasp, duration=SECONDS, pivot=pivot, back=True), Accelerate(grasp))]
        good = [t for t in found if isinstance(t, Trajectory)]
        table, turned = table + good, turned + (len(good) == len(found))
        if turned == MOST:
            break
    if turned < LEAST:
        return "too few grasps to turn about"
    for grasp in inner:
        lifts = [_done(obj, action) for action in (Lift(grasp, tilt=0.0), Lift(grasp))]
        held, rocked = lifts
        if isinstance(held, Trajectory) and isinstance(rocked, Trajectory):
            return Lifted(obj, table, held, rocked)
        why = next(str(lift) for lift in lifts if isinstance(lift, str))
    return why


def _done(obj: ObjectModel, action: Action) -> Trajectory | str:
    try:
        clean = RUNNER.run_clean(Trial(obj, action, RIGID))
    except InfeasibleTrialError as error:
        return str(error)
    return clean if clean.ok else clean.reason


def missing(lifted: Lifted) -> dict[str, float]:
    """Error of the wrench of every stretch against what the true masses take, still and rocked, in parts of the weight.

    The height of the object between the pads is fitted: it lies on felt, and sinks. Torques over 0.1 m.
    """
    shape, truth = lifted.object.shape, lifted.object.truth.mass
    windows = lift_windows(draw_sensing(lifted.rocked, preset("ideal"), 0))
    rocks = np.array([lifted.rocked.action.accelerates(i) for i in range(len(windows))])  # pyright: ignore[reportAttributeAccessIssue]
    at = {"mass": torch.tensor(truth), "place": torch.zeros(3, dtype=torch.float64)}
    due, slopes = Air.of_masses(shape, windows).linearized(at)
    off, up = np.array([w.wrench for w in windows]) - due.numpy(), slopes["place"][..., 2].numpy()
    low = up.ravel() @ off.ravel() / np.sum(up**2)
    off = (off - low * up) / (9.81 * lifted.object.total_mass) / np.repeat([1.0, 0.1], 3)
    parts = {"low_mm": 1e3 * float(low)}
    for name, rows in (("still", off[~rocks]), ("rocked", off[rocks])):
        parts |= {f"{name}_force": float(np.abs(rows[:, :3]).max()), f"{name}_torque": float(np.abs(rows[:, 3:]).max())}
    return parts


def judged(lifted: Lifted, sensing: str, seed: int) -> list[dict[str, object]]:
    """One draw's answers against the truth: table alone, with the lift that is held, with the one that is rocked."""
    obj = lifted.object
    shape, count, truth = obj.shape, obj.shape.particles_per_group, obj.group_mass
    drawn = [draw_sensing(t, preset(sensing), 100 * seed + i) for i, t in enumerate(lifted.table)]
    scale = np.random.default_rng(seed).standard_normal() * preset(sensing).scale
    rows = []
    for name, lift in (("table", None), ("held", lifted.held), ("rocked", lifted.rocked)):
        felt = drawn if lift is None else [*drawn, draw_sensing(lift, preset(sensing), 100 * seed + 99)]
        answer = SupportAware().estimate(shape, obj.total_mass + scale, felt, 0)
        row: dict[str, object] = {"object": obj.name, "with": name, "seed": seed, "status": answer.status}
        if "least_0_kg" in answer.diagnostics and answer.distribution is not None and answer.covariance is not None:
            least, most = (
                np.array([answer.diagnostics[f"{end}_{g}_kg"] for g in range(shape.n_m)]) for end in ("least", "most")
            )
            error = np.sqrt(np.diag(answer.covariance)) * count
            row |= {
                "width_kg": float((most - least).mean()),
                "inside": float(((least - 1e-9 <= truth) & (truth <= most + 1e-9)).mean()),
                "error_kg": float(error.mean()),
                "within_90": float((np.abs(answer.distribution.mass * count - truth) <= 1.645 * error).mean()),
                "nad": float(np.abs(answer.distribution.mass * count - truth).sum() / truth.sum()),
            }
        best = SupportAware(materials_kg=MATERIALS).estimate(shape, obj.total_mass + scale, felt, 0)
        if best.distribution is not None:
            row["right"] = float(np.allclose(best.distribution.mass * count, truth, rtol=1e-6))
            row["probability"] = best.diagnostics.get("assignment_probability", np.nan)
            row["none_fits"] = float("assignment_probability" not in best.diagnostics)
        rows.append(row)
    return rows


def show(rows: pd.DataFrame) -> None:
    """Means over draws, library objects by name and the drawn ones together."""
    rows = rows[rows["right"].notna()].assign(object=rows.object.str.replace(r"_\d+$", "", regex=True))
    columns = {
        "width_kg": "range, kg",
        "inside": "in range, %",
        "error_kg": "error, kg",
        "within_90": "within 90, %",
        "nad": "NAD, %",
        "right": "right, %",
        "none_fits": "none fits, %",
        "probability": "P best, %",
    }
    table = Table("object", "with", "draws", *columns.values(), box=box.SIMPLE)
    for name, kind in rows[["object", "with"]].drop_duplicates().to_numpy():
        part = rows[(rows.object == name) & (rows["with"] == kind)]
        mean = part[list(columns)].mean()
        shown = [f"{mean[c]:.3f}" if c.endswith("kg") else f"{100 * mean[c]:.0f}" for c in columns]
        table.add_row(name, kind, str(len(part)), *shown)
    Console(width=120).print(table)


def objects(drawn: int) -> list[ObjectModel]:
    """I2, L2, F2, and drawn ones of six blocks."""
    family = Family(name="drawn", count=max(drawn, 1), seed=7, blocks=[6, 6], mass_kg=list(MATERIALS))
    return [load_object(n) for n in ("I2", "L2", "F2")] + [family.draw(i, 0).build(3, Path()) for i in range(drawn)]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run, write and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path)
    parser.add_argument("--random", type=int, default=30)
    parser.add_argument("--draws", type=int, default=5)
    parser.add_argument("--sensing", default="ft300s")
    asked = parser.parse_args(arguments)
    torch.set_num_threads(1)
    rows, physics = (
        [],
        Table("object", "sinks, mm", "still: force", "torque", "rocked: force", "torque", box=box.SIMPLE),
    )
    for obj in objects(asked.random):
        found = trials(obj)
        if isinstance(found, str):
            print(f"{obj.name}: {found}", flush=True)
            continue
        off = missing(found)
        physics.add_row(obj.name, f"{-off.pop('low_mm'):.2f}", *(f"{1e3 * v:.2f}" for v in off.values()))
        for seed in range(asked.draws):
            rows += judged(found, asked.sensing, seed)
        print(f"{obj.name}: {len(found.table)} trials on the table", flush=True)
        frame = pd.DataFrame(rows)
        write_whole(asked.out, lambda part, frame=frame: frame.to_parquet(part))
    print("wrench in the air beyond Newton's and Euler's, 1/1000 of the weight (torque: of the weight at 0.1 m)")
    Console(width=120).print(physics)
    show(pd.DataFrame(rows))


if __name__ == "__main__":
    os.environ.setdefault("OMP_NUM_THREADS", "1")
    main()
