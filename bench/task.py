"""Mass maps put to use: python bench/task.py [FOLDER [OBJECTS]]

Two tasks in MuJoCo on the drawn objects of `task.toml`, each planned with the masses that a method estimated in a lab:

* lift: grasp nearest to the estimated center of mass and lift the object as one rigid body. It succeeds where the
  object turns by less than 1.5 deg and shifts by less than 3 mm in the grip; a weaker grip forgives less.
* push: move the object by 80 mm along x and along y without turning it, by one open-loop push straight into a face,
  at the point that a quasi-static model with the estimated masses chooses. It succeeds where the particles end within
  10 mm (root mean square) of the goal.

Even masses and the true ones are planned with as well. A row has the mean NAD, the median distance of the estimated
center of mass from the true one, the share of lifts that succeed at each grip force, the share of pushes that do, and
the median distance from their goals. The second table pools all answers by their NAD. Some ten core-seconds per answer;
OBJECTS takes the first ones only.
"""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
from shared import head_table, show

from estimators.evaluation.metrics import normalized_absolute_difference
from scenarios.cli.main import main as heft
from scenarios.results.estimates import load_results
from testbed.actions.lift import Lift
from testbed.actions.path import RAMP_TIME
from testbed.actions.push import Push
from testbed.frames import rotation_2d, transform_point
from testbed.objects.faces import faces
from testbed.objects.files import load_object
from testbed.objects.model import PAD_WIDTH, Grasp, MassDistribution, ObjectModel, ObjectShape
from testbed.simulation.runner import SimulationRunner
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trial import OWN_WEIGHT, RIGID, Trial
from tests.fakes.analytic_push import drag_of

FORCES = (30.0, 60.0, 120.0)
"""Grip forces [N]."""
WAY = 0.08
"""Distance of a goal [m]."""
NEAR = 0.01
"""Greatest distance from a goal of a push that succeeds [m]."""
GOALS = (0.0, math.pi / 2)
"""Directions of the goals [rad], object frame."""
SPACING, ANGLES = 0.002, np.radians([-20.0, -10.0, 0.0, 10.0, 20.0])
"""Distance between the points of candidate pushes [m], and their angles from the face's normal [rad]."""
STEP = 0.05
"""Step of the quasi-static model [s]."""
GROUPS = (0.02, 0.05, 0.1, 0.2, 0.4)
"""Bounds of the NADs that are pooled."""


def grasp_near(shape: ObjectShape, point: np.ndarray) -> Grasp:
    """Grasp of a block nearest to a point [m], along its faces as far as the pads stay on them."""
    found = []
    for grasp in shape.grasps:
        along = np.array([-math.sin(grasp.angle), math.cos(grasp.angle)])
        room = max(grasp.length - PAD_WIDTH, 0.0) / 2
        found.append(grasp.moved(np.clip((point - grasp.position) @ along, -room, room) * along))
    return min(found, key=lambda grasp: float(np.linalg.norm(grasp.position - point)))


def lifted(model: ObjectModel, guess: ObjectModel, force: float) -> bool:
    """True if the object stays level when lifted near the guessed center of mass at a grip force [N]."""
    settings = SimulationSettings(grip=GripSettings(force=force))
    held = replace(model, shape=replace(model.shape, grasps=(grasp_near(model.shape, guess.center_of_mass),)))
    lift = Lift(0, tilt=0.0, hold=1.0)
    return SimulationRunner(settings, refuses=False).run_clean(Trial(held, lift, RIGID)).ok


def candidates(shape: ObjectShape, direction: float) -> list[Push]:
    """Pushes into the faces that look against a direction [rad]."""
    heading, found = np.array([math.cos(direction), math.sin(direction)]), []
    for face in faces(shape):
        if face.normal @ heading > -0.9:
            continue
        parts = np.arange(0.05, 0.951, SPACING / face.length)
        found += [replace(Push.into(face, part), length=WAY) for part in parts]
    return found


def off_goal(shape: ObjectShape, pose: np.ndarray, direction: float) -> float:
    """Root mean square distance of the particles of an object at a pose, where it lay at the origin, from the goal."""
    goal = shape.particles + WAY * np.array([math.cos(direction), math.sin(direction)])
    return float(np.sqrt(np.square(transform_point(pose, shape.particles) - goal).sum(axis=1).mean()))


def pushed(model: ObjectModel, guess: ObjectModel, direction: float) -> float:
    """Distance from the goal [m] of the object after the push that a guess of its masses chooses."""
    shape, choices = model.shape, candidates(model.shape, direction)
    motions = drag_of(guess).motion(shape, choices, STEP)
    ends = [motion.poses[-1] + motion.twists[-1] * RAMP_TIME / 2 for motion in motions]  # as it slows down
    best = choices[int(np.argmin([off_goal(shape, end, direction) for end in ends]))]
    trial = SimulationRunner(refuses=False).run_clean(Trial(model, best, OWN_WEIGHT))
    begin, end = trial.object_pose[0], trial.object_pose[-1]
    moved = rotation_2d(-begin[2]) @ (end[:2] - begin[:2])
    return off_goal(shape, np.append(moved, end[2] - begin[2]), direction)


def row(folder: Path, name: str, method: str, masses: tuple[float, ...]) -> dict[str, object]:
    """Outcome of both tasks with guessed masses of an object's groups [kg]."""
    model = load_object(str(next(folder.glob(f"objects/*/{name}.toml"))))
    shape = model.shape
    guess = replace(model, truth=MassDistribution(masses / shape.particles_per_group, model.truth.friction))
    off = [pushed(model, guess, direction) for direction in GOALS]
    return {
        "method": method,
        "nad": normalized_absolute_difference(shape, guess.truth, model.truth),
        "off": float(np.linalg.norm(guess.center_of_mass - model.center_of_mass)),
        "lifts": [lifted(model, guess, force) for force in FORCES],
        "pushes": off,
    }


def tasks(folder: Path, objects: int | None) -> Iterator[tuple[Path, str, str, tuple[float, ...]]]:
    """Arguments of `row` for every answer with masses about the first objects, for even masses and the true ones."""
    results = load_results(folder)
    for name, rows in list(results.groupby("object"))[:objects]:
        true = np.array(rows["true_mass_kg"].iloc[0])
        even = np.full(len(true), true.sum() / len(true))
        every = [("even masses", even), *zip(rows["method"], rows["mass_kg"], strict=True), ("the true masses", true)]
        yield from ((folder, str(name), method, tuple(masses)) for method, masses in every if masses is not None)


def printed(title: str, label: str, groups: dict[str, pd.DataFrame]) -> None:
    """Print a row for each group of outcomes."""
    forces = [f"{force:g} N, %" for force in FORCES]
    columns = (label, "answers", "NAD, %", "c off, mm", *forces, "at goal, %", "from goal, mm")
    table = head_table(*columns, left=columns, title=title, padding=(0, 1, 0, 0))
    for name, rows in groups.items():
        level, off = np.array(rows["lifts"].tolist()), np.array(rows["pushes"].tolist())
        table.add_row(
            name,
            str(len(rows)),
            f"{100 * rows['nad'].mean():.1f}",
            f"{1e3 * rows['off'].median():.1f}",
            *(f"{100 * share:.0f}" for share in level.mean(axis=0)),
            f"{100 * (off < NEAR).mean():.0f}",
            f"{1e3 * np.median(off):.1f}",
        )
    show(table, width=120)


def main() -> None:
    """Run the scenario, then both tasks, and print the tables."""
    folder, objects = Path(*sys.argv[1:2] or ["results/task"]), int(sys.argv[2]) if sys.argv[2:] else None
    heft(["run", str(Path(__file__).with_suffix(".toml")), "--secret", "docs", "--out", str(folder)])
    with ProcessPoolExecutor(2, get_context("spawn")) as pool:
        found = pd.DataFrame(pool.map(row, *zip(*tasks(folder, objects), strict=True)))
    methods = dict.fromkeys(["the true masses", *found["method"]])
    printed("by method", "planned with", {str(m): pd.DataFrame(found[found["method"] == m]) for m in methods})
    estimated = pd.DataFrame(found[~found["method"].isin(["the true masses", "even masses"])])
    pooled = {}
    for low, high in zip((0.0, *GROUPS), (*GROUPS, math.inf), strict=True):
        inside = pd.DataFrame(estimated[(estimated["nad"] >= low) & (estimated["nad"] < high)])
        if len(inside):
            pooled[f"{100 * low:g} to {100 * high:g} %" if math.isfinite(high) else f"over {100 * low:g} %"] = inside
    printed("by accuracy", "NAD", pooled)


if __name__ == "__main__":
    main()
