"""Real tools felt in simulation: python bench/tools.py [SET] [--draws N].

SET is a copy of the public set (docs/tools.md); without it, the one tool is a mallet that is built here. Every tool
with a grasp is turned on the table and lifted from pose to pose, and every tool is pushed, in an ideal world and in a
lab, on its points of contact. Medians over tools and draws: errors of M and of the inertia (about z, and Frobenius
norm) in percent, of c in mm, in the plane and in space, NAD of the masses of parts in percent, and the 90 % intervals
of part masses (of M, c and the inertia where a method knows no parts) that hold.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from rich import box
from shared import head_table, parser_of, show
from stop_and_go import judged

from estimators.action_selection.random import RandomPushes
from estimators.base import ActionPolicy, Estimate
from estimators.evaluation.statistics import NINETY
from estimators.inertial import (
    InertialEstimate,
    consistent_inertia,
    ellipsoid_of,
    homogeneous_parts,
    least_squares_inertia,
    lift_equations,
    solid_parts,
    true_body,
)
from estimators.support_models.estimator import SupportAware
from scenarios.config import load_scenario
from scenarios.study.meshes import with_meshes
from testbed.actions.accelerate import Accelerate
from testbed.actions.base import Action
from testbed.actions.lift import Lift
from testbed.actions.push import Push
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError
from testbed.objects.conversion.convert import convert_mesh
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.sensing.noise import draw_sensing, read_scale
from testbed.sensing.presets import preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import RIGID, Trial
from testbed.worlds.draw import WorldDraw
from testbed.worlds.presets import world

GRASPS = 3
"""Grasps of a tool that are used, those nearest the middle."""
PUSHES = 10
"""Pushes of a tool, at random places of its outline."""
WORLDS = {"ideal": ("ideal", "ideal"), "ft300s": ("ideal", "ft300s"), "lab": ("lab", "ft300s")}
"""World and sensor of each group of rows."""
Judged = tuple[float, float, float, float, float]
Trials = list[Trajectory]


@dataclass(frozen=True, eq=False)
class Felt:
    """Trials of one tool under one draw of a world and a sensor."""

    model: ObjectModel
    weight: float
    turns: tuple[Trajectory, ...]
    lifts: tuple[Trajectory, ...]
    pushes: tuple[Trajectory, ...]


def mallet(folder: Path) -> ObjectModel:
    """A handle of 0.1 kg and a head of 0.3 kg, of one density each, flat on one side."""
    handle, head = trimesh.creation.box((0.16, 0.022, 0.022)), trimesh.creation.box((0.04, 0.08, 0.036))
    head.apply_translation((0.1, 0.0, 0.007))
    path = folder / "mallet.stl"
    trimesh.util.concatenate([handle, head]).export(path)
    return convert_mesh(path, unit="m", parts="bodies").model((0.1, 0.3))


def trials_of(model: ObjectModel, policy: ActionPolicy, refused: dict[Action, str], place: str, draw: int) -> Trials:
    """Clean trials that a policy asks for in a draw of a world, those that ended well."""
    drawn = None if place == "ideal" else WorldDraw.of(world(place), model, draw, "bench")
    made: Trials = []
    with SimulationRunner() as simulation:
        while (action := policy.next(model.shape, made)) is not None:
            try:
                made.append(simulation.run_clean(Trial(model, action, RIGID, world=drawn)))
            except HeftError as error:
                refused[action] = str(error)
    for action, why in refused.items():
        if not isinstance(action, Push):
            print(f"{model.name}, {action.describe(model.shape)}: {why.splitlines()[0][:100]}")
    return [trial for trial in made if trial.ok]


def policies(shape: ObjectShape) -> Iterator[tuple[ActionPolicy, dict[Action, str]]]:
    """Turns, lifts and pushes of a tool, each with the actions that its policy is told to be refused."""
    grasps = range(min(GRASPS, len(shape.grasps)))
    turns = [a for g in grasps for a in (Rotate(g, duration=6.0, back=True), Accelerate(g))]
    for actions in (turns, [Lift.stop_and_go(g) for g in grasps]):
        refused: dict[Action, str] = {}
        yield Listed(tuple(actions), refused), refused
    refused = {}
    yield RandomPushes(PUSHES, refused=refused), refused


@dataclass(frozen=True)
class Listed:
    """A list of actions as a policy."""

    actions: tuple[Action, ...]
    refused: dict[Action, str]

    def next(self, shape: ObjectShape, trajectories: Sequence[Trajectory]) -> Action | None:
        """Next action of the list."""
        left = [action for action in self.actions if action not in self.refused]
        return left[len(trajectories)] if len(trajectories) < len(left) else None


def felt(model: ObjectModel, draws: int) -> Iterator[tuple[str, Felt]]:
    """A tool's trials under every draw, with the label of its rows."""
    clean: dict[tuple[str, int], list[Trials]] = {}
    for label, (place, sensor) in WORLDS.items():
        for draw in range(1 if label == "ideal" else draws):
            key = (place, draw if place != "ideal" else 0)
            if key not in clean:
                clean[key] = [trials_of(model, *policy, *key) for policy in policies(model.shape)]
            sensing = preset(sensor)
            drawn = (
                tuple(draw_sensing(t, sensing, 100 * draw + i) for i, t in enumerate(group)) for group in clean[key]
            )
            yield label, Felt(model, read_scale(model.total_mass, sensing, [draw]), *drawn)


def judged_masses(trial: Felt, answer: Estimate) -> Judged | None:
    """Errors of an answer with masses of parts; M is what the scale read."""
    model = trial.model
    masses, error = answer.group_mass(model.shape), answer.group_error(model.shape)
    if masses is None or answer.hidden is None or error is None:
        return None
    return (
        100 * abs(masses.sum() / model.total_mass - 1),
        1e3 * float(np.linalg.norm(answer.hidden.center_of_mass - model.center_of_mass)),
        100 * abs(answer.hidden.inertia_cm / model.inertia_cm - 1),
        100 * float(np.abs(masses - model.group_mass).sum()) / model.total_mass,
        float(np.mean(np.abs(masses - model.group_mass) <= NINETY * error + 1e-12)),
    )


def judged_body(trial: Felt, found: InertialEstimate) -> Judged:
    """Errors of an answer in space."""
    model, nad = trial.model, np.nan
    mass, center, inertia, hold = judged(true_body(model), found)
    if found.part_mass is not None and found.part_draws is not None:
        low, high = np.quantile(found.part_draws, [0.05, 0.95], axis=0)
        nad = 100 * float(np.abs(found.part_mass - model.group_mass).sum()) / model.total_mass
        hold = float(np.mean((low - 1e-9 <= model.group_mass) & (model.group_mass <= high + 1e-9)))
    return mass, center, inertia, nad, hold


def answers(trial: Felt) -> Iterator[tuple[str, str, Judged | None]]:
    """Trials used, method and errors of every answer; None without one."""
    both = (*trial.turns, *trial.lifts)
    for used, given in (("turns", trial.turns), ("both", both), ("pushes", trial.pushes)):
        if given:
            answer = SupportAware().estimate(trial.model.shape, trial.weight, given, 0)
            yield used, "support_aware", judged_masses(trial, answer)
    if not trial.lifts:
        return
    for name in ("least squares", "consistent (SDP)", "homogeneous parts (HPS)"):
        try:
            equations = lift_equations(trial.model.shape, trial.lifts)
            if name == "least squares":
                found = least_squares_inertia(equations)
            elif name == "consistent (SDP)":
                found = consistent_inertia(equations, ellipsoid_of(trial.model.shape))
            else:
                found = homogeneous_parts(equations, solid_parts(trial.model.solids))
        except HeftError as error:
            print(f"{trial.model.name}, {name}: {error}")
            yield "lifts", name, None
            continue
        yield "lifts", name, judged_body(trial, found)


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__, draws=3)
    parser.add_argument("folder", type=Path, nargs="?")
    given = parser.parse_args()
    rows: dict[tuple[str, str, str], list[Judged | None]] = {}
    with tempfile.TemporaryDirectory() as folder:
        if given.folder is None:
            models = [mallet(Path(folder))]
        else:
            scenario, _ = with_meshes(load_scenario("tools")[1], given.folder, Path(folder), lambda *_, **__: None)
            models = [load_object(path) for path in scenario.objects]
    for model in models:
        print(f"{model.name}: {len(model.shape.grasps)} grasps", flush=True)
        for label, trial in felt(model, given.draws):
            for used, method, one in answers(trial):
                rows.setdefault((label, used, method), []).append(one)
    numbers = ("M, %", "c, mm", "inertia, %", "part masses, %", "90 % hold", "none")
    names = ("world", "trials", "method")
    table = head_table(*names, *numbers, left=names, box=box.SIMPLE)
    for key, found in rows.items():
        known = [one for one in found if one is not None]
        middle = (
            [f"{np.nanmedian(values):.2g}" for values in list(zip(*known, strict=True))[:3]] if known else ["-"] * 3
        )
        nads = [one[3] for one in known if np.isfinite(one[3])]
        hold = f"{100 * np.mean([one[4] for one in known]):.0f}" if known else "-"
        table.add_row(*key, *middle, f"{np.median(nads):.2g}" if nads else "-", hold, str(len(found) - len(known)))
    show(table, width=120)


if __name__ == "__main__":
    main()
