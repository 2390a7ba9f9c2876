"""Mesh files of real tools, each as an object on its points of contact: felt in simulation, and estimated.

python bench/tools.py FOLDER [--figure FILE]: meshes are FOLDER/*/mesh.ply; a mass in kg stands in Inertia.yaml beside.
"""

from __future__ import annotations

import argparse
import re
import time
from pathlib import Path

import numpy as np

from estimators.support_models.estimator import SupportAware
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError
from testbed.objects.conversion import convert_mesh
from testbed.objects.model import ObjectModel
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import RIGID, Trial
from viz.figures.maps import save_figure
from viz.figures.objects import object_page

MASS = 0.3
"""Mass of a tool without one [kg]."""


def trials_of(model: ObjectModel, simulation: SimulationRunner) -> tuple[list[Trajectory], str]:
    """A turn there and back and an accelerated one about every grasp, and why one of them is not there."""
    felt, why = [], ""
    for grasp in range(len(model.shape.grasps)):
        for action in (Rotate(grasp, duration=4.0, back=True), Accelerate(grasp)):
            try:
                felt.append(simulation.run(Trial(model, action, RIGID)))
                why = why or felt[-1].reason
            except HeftError as error:
                why = why or str(error)
    return felt, why


def row_of(file: Path, simulation: SimulationRunner) -> tuple[ObjectModel, str]:
    """The object of a file, and its row of the table."""
    notes = file.with_name("Inertia.yaml")
    found = re.search(r"MASS: ([\d.]+)", notes.read_text(encoding="utf-8")) if notes.is_file() else None
    begin = time.process_time()
    made = convert_mesh(file)
    model = made.model((float(found[1]) if found else MASS,))
    seconds = time.process_time() - begin
    felt, why = trials_of(model, simulation)
    good = sum(trial.ok for trial in felt)
    cells = f"{made.name:18} {model.shape.n_m:3} {len(made.pose.contacts):3} {len(felt):3} {good:3} {seconds:5.1f}"
    if not good:
        return model, f"{cells}  {why or made.told[-1]}"
    answer = SupportAware().estimate(model.shape, model.total_mass, felt, 0)
    if answer.distribution is None or answer.hidden is None:
        return model, f"{cells}  {answer.status}: {answer.message}"
    off = 1e3 * float(np.linalg.norm(answer.hidden.center_of_mass - model.center_of_mass))
    friction = 100 * (answer.distribution.friction[0] / model.truth.friction[0] - 1)
    inertia = 100 * (answer.hidden.inertia_cm / model.inertia_cm - 1)
    masses = answer.distribution.mass * model.shape.particles_per_group
    worst = 1e3 * np.abs(masses - model.group_mass).max()
    return model, f"{cells}  {off:6.2f} {friction:7.1f} {inertia:7.1f} {worst:7.1f}  {answer.status}"


def main() -> None:
    """Print the table, and draw the objects on one page."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figure", type=Path, help="picture of all, written as FILE.pdf and FILE.png")
    given = parser.parse_args()
    print("tool            parts points trials ok  cpu, s   c, mm   mu, %   I, %  mass, g  status")
    models = []
    with SimulationRunner() as simulation:
        for file in sorted(given.folder.glob("*/mesh.ply")):
            model, row = row_of(file, simulation)
            models.append(model)
            print(row, flush=True)
    if given.figure is not None:
        save_figure(object_page(models), given.figure)


if __name__ == "__main__":
    main()
