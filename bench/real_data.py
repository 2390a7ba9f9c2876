"""Answers from public measurements whose truth is known: python bench/real_data.py pushes MAPPING.toml [... --of N ...]
                                                         python bench/real_data.py poses POSES.csv REST.csv

`pushes` reads the logs that mappings of `heft import` name, of plates whose masses stand in their object files, and
prints the center of mass and the friction that `bayes` finds from all pushes and from sets of N; then how far the
friction of each push departs from Coulomb's law.
`poses` calibrates a sensor by still poses (columns r11 to r33, fx to tz) with the noise of a recording at rest, and by
disjoint halves of them: their tool's mass and center must agree within their errors. docs/real_data.md has the sources.
"""

from __future__ import annotations

import argparse
import itertools
import math
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
import torch
from rich.console import Console
from rich.table import Table
from scipy.spatial.transform import Rotation

from estimators.evaluation.statistics import NINETY
from estimators.particles.observe import observe
from estimators.posterior.estimator import Bayes
from estimators.wrench.model import ModelErrors, ParticleModel
from scenarios.cli.terminal import open_table
from testbed.errors import HeftError
from testbed.importers.importer import import_trajectory
from testbed.importers.mapping import Mapping
from testbed.objects.files import load_object
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.robot.calibration.static_poses import StaticPose, calibrate
from testbed.toml import load_toml
from testbed.trajectory import Trajectory

MOST_SETS = 30
"""Most sets of a number of pushes, drawn where there are more."""
HALVES = 10
"""Splits of the poses into halves."""


def main() -> None:
    """Print a table of each part."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("part", choices=("pushes", "poses"))
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--of", type=int, nargs="+", default=[1, 2, 4], help="pushes in each set")
    given = parser.parse_args()
    console = Console(width=140)
    if given.part == "pushes":
        console.print(pushes(given.files, given.of), departures(given.files))
    else:
        console.print(poses(*given.files))


def pushes(mappings: Sequence[Path], sizes: Sequence[int]) -> Table:
    """Center of mass and friction of each plate, by all of its pushes and by sets of them: medians over the sets."""
    numbers = ("pushes", "sets", "c_x, mm", "c_y, mm", "|c|, mm", "claimed, mm", "90 % hold", "friction", "ok")
    table = open_table("plate", *numbers, left=("plate",), title="bayes on measured pushes; the truth is c = 0")
    for mapping in mappings:
        obj, trials = read(mapping)
        for size in [*(size for size in sizes if size < len(trials)), len(trials)]:
            sets = list(itertools.combinations(trials, size))
            if len(sets) > MOST_SETS:
                chosen = np.random.default_rng(0).choice(len(sets), MOST_SETS, replace=False)
                sets = [sets[i] for i in sorted(chosen)]
            found = [each for each in (center(obj, one) for one in sets) if each is not None]
            away = [math.hypot(*each.center) for each in found]
            held = np.array([np.abs(each.center) <= NINETY * each.error for each in found])
            place = [f"{c:.1f} +- {s:.1f}" for c, s in zip(found[0].center, found[0].error, strict=True)]
            table.add_row(
                obj.name,
                f"{size}",
                f"{len(sets)}",
                *(place if len(found) == 1 else ["", ""]),
                f"{np.median(away):.1f}",
                f"{np.median([math.hypot(*each.error) for each in found]):.1f}",
                f"{held.sum()} of {held.size}",
                f"{np.median([each.friction for each in found]):.3f}",
                f"{sum(each.status == 'ok' for each in found)}",
            )
    return table


def read(mapping: Path) -> tuple[ObjectModel, list[Trajectory]]:
    """Object of a mapping, its masses as the truth, and its logs that are data."""
    table = load_toml(mapping, Mapping)
    trials = []
    for entry in table.logs or ():
        try:
            trial = import_trajectory(mapping.parent / entry.file, mapping, entry=entry)
        except HeftError as error:
            print(f"left out: {entry.file}: {error}")
            continue
        if trial.ok:
            trials.append(trial)
        else:
            print(f"left out: {entry.file}: {trial.status}: {trial.reason}")
    return load_object(str(mapping.parent / table.object)), trials


class Center(NamedTuple):
    """Center of mass and friction that a set of pushes shows."""

    center: np.ndarray
    """Less the true one, mm."""
    error: np.ndarray
    """Standard deviations, mm."""
    friction: float
    status: str


def center(obj: ObjectModel, trials: Sequence[Trajectory]) -> Center | None:
    """Answer of `bayes` to some pushes; None where it has none."""
    shape = obj.shape
    answer = Bayes().estimate(shape, obj.total_mass, trials, 0)
    if answer.distribution is None or answer.covariance is None:
        return None
    count = shape.particles_per_group
    middles = np.array([shape.middle_of(group) for group in range(shape.n_m)])
    slope = 1e3 * (count[:, None] * middles / obj.total_mass).T
    found = slope @ answer.distribution.mass - 1e3 * obj.center_of_mass
    error = np.sqrt(np.diag(slope @ answer.covariance @ slope.T))
    return Center(found, error, float(answer.distribution.friction.mean()), answer.status)


def departures(mappings: Sequence[Path]) -> Table:
    """Departure of each push from Coulomb's law: what `friction_law` of the true plate would explain it.

    As parts of the friction, whose coefficient is the mean over a plate's pushes; over a push's windows where there are
    several.
    """
    columns = ("plate", "push", "turn rate, rad/s", "windows", "along", "across", "around")
    title = "friction of each push beside Coulomb's of the true plate, %"
    table = open_table(*columns, left=("plate",), title=title)
    every = []
    for mapping in mappings:
        obj, trials = read(mapping)
        windows = observe(obj.shape, trials, ModelErrors())
        if windows is None:
            continue
        model = ParticleModel.of(obj.shape)
        mass = model.particle_mass(torch.tensor(obj.truth.mass))
        forward = windows.table(model).dragged(mass * GRAVITY)
        ones = forward.rows({})
        measured = windows.wrench - forward.motion(mass)
        friction = (measured[:, :2] * ones[:, :2]).sum() / ones[:, :2].square().sum()
        slopes = forward.linearized({"friction_law": torch.zeros(3, dtype=torch.float64)})[1]["friction_law"]
        found = 100 * torch.linalg.solve(friction * slopes, measured - friction * ones)
        for number in windows.trial.unique().tolist():
            own = windows.trial == number
            parts = found[own]
            scatter = parts.std(0, correction=0).tolist()
            table.add_row(
                obj.name if number == 0 else "",
                f"{number + 1}.",
                f"{windows.twist[own, 2].mean():.2f}",
                str(len(parts)),
                *(f"{m:.0f} +- {s:.0f}" for m, s in zip(parts.mean(0).tolist(), scatter, strict=True)),
            )
            every.append(parts.mean(0))
    size = torch.stack(every).square().mean(0).sqrt().tolist()
    table.caption = "root mean square over pushes: " + ", ".join(f"{value:.0f}" for value in size)
    return table


def poses(file: Path, rest: Path) -> Table:
    """Tool by all poses, and how far halves of them are apart in units of their errors."""
    data = np.genfromtxt(file, delimiter=",", names=True)
    turns = np.stack([[data[f"r{i}{j}"] for j in (1, 2, 3)] for i in (1, 2, 3)]).transpose(2, 0, 1)
    wrench = np.stack([data[name] for name in ("fx", "fy", "fz", "tx", "ty", "tz")], 1)
    noise = np.genfromtxt(rest, delimiter=",", skip_header=1)
    error = noise.std(axis=0) / math.sqrt(len(noise))
    every = [
        StaticPose(Rotation.from_matrix(turn).as_quat(scalar_first=True), read, error)
        for turn, read in zip(turns, wrench, strict=True)
    ]
    columns = ("poses", "mass, kg", "c, mm", "misfit", "apart, standard errors: mass, c_x, c_y, c_z")
    table = open_table(*columns, title=f"{len(every)} still poses")
    whole = calibrate(every)
    table.add_row(
        "all", f"{whole.mass:.4f} +- {whole.mass_std:.4f}", _place(whole.com, whole.com_std), f"{whole.misfit:.3g}"
    )
    rng, agree = np.random.default_rng(0), 0
    for _ in range(HALVES):
        order = rng.permutation(len(every))
        one, other = (calibrate([every[i] for i in half]) for half in np.array_split(order, 2))
        apart = [(one.mass - other.mass) / math.hypot(one.mass_std, other.mass_std)]
        apart += ((one.com - other.com) / np.hypot(one.com_std, other.com_std)).tolist()
        agree += max(map(abs, apart)) < 2.5
        masses = f"{one.mass:.4f}, {other.mass:.4f} +- {one.mass_std:.4f}"
        table.add_row("halves", masses, "", f"{one.misfit:.3g}", ", ".join(f"{each:.1f}" for each in apart))
    table.caption = f"{agree} of {HALVES} splits agree within 2.5 standard errors in all four"
    return table


def _place(place: np.ndarray, error: np.ndarray) -> str:
    return ", ".join(f"{1e3 * value:.2f} +- {1e3 * std:.2f}" for value, std in zip(place, error, strict=True))


if __name__ == "__main__":
    main()
