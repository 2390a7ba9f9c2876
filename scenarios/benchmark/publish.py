"""Writing of the published folder, and of the truth of the test split, which is not published."""

from __future__ import annotations

import hashlib
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any

import pyarrow as pa

from estimators.action_selection.cost import spent_seconds
from scenarios.benchmark.card import NAME, VERSION, write_card
from scenarios.benchmark.dataset import (
    SAMPLES,
    TRIALS,
    TRUTHS,
    Problem,
    Truth,
    samples_of,
    trial_row,
    write_rows,
    write_samples,
)
from scenarios.benchmark.lerobot import TASKS, write_meta
from scenarios.benchmark.problems import SPLITS, hidden
from scenarios.results.files import write_json
from testbed.files import write_text, write_whole
from testbed.objects.files import ObjectFile
from testbed.objects.model import ObjectModel
from testbed.sensing.windows import weight_of
from testbed.trajectory import Trajectory


@dataclass(frozen=True, eq=False)
class Entry:
    """Problem to be published."""

    split: str
    kind: str
    world: str
    file: ObjectFile
    """Object file with masses and frictions, named as the problem."""
    model: ObjectModel
    """Object of that file, with the estimators' particles."""
    trials: Callable[[], Sequence[Trajectory]]
    """Trials as a method is given them, the weighing first."""

    @property
    def truth(self) -> Truth:
        """Masses and frictions."""
        friction = tuple(self.model.truth.friction.tolist())
        return Truth(tuple(self.model.group_mass.tolist()), friction, self.model.hinge_friction)

    def problem(self, weight: float, moved: Sequence[Trajectory]) -> Problem:
        """Row of the table of problems for a weight as read [kg] and the trials after the weighing."""
        return Problem(
            problem=self.file.name,
            split=self.split,
            world=self.world,
            kind=self.kind,
            shape=json.dumps(hidden(self.file)),
            groups=self.model.shape.group_names,
            weight_kg=weight,
            setup=json.dumps(asdict(moved[0].setup)),
            trials=len(moved),
            robot_s=spent_seconds(self.model.shape, moved),
        )


def publish(folder: Path, entries: Sequence[Entry], truth_file: Path, secret: str) -> list[Problem]:
    """Write the published folder and the truth of test; benchmark.json comes last and means done.

    Args:
        folder: published folder.
        entries: problems by split.
        truth_file: file of the truth of test, outside the folder.
        secret: secret of the test split, of which the salt is made.
    """
    (folder / "benchmark.json").unlink(missing_ok=True)
    problems: list[Problem] = []
    trials: list[dict[str, Any]] = []

    def samples() -> Iterator[pa.Table]:
        first = 0
        for entry in entries:
            weighing, *moved = entry.trials()
            problems.append(entry.problem(weight_of(weighing), moved))
            for number, trajectory in enumerate(moved):
                row = trial_row(entry.file.name, number, len(trials), trajectory)
                table = samples_of(trajectory, len(trials), first, list(TASKS).index(row["action"]))
                first += len(table)
                trials.append(row)
                yield table

    write_samples(folder / SAMPLES, samples())
    splits = {problem.problem: problem.split for problem in problems}
    write_meta(folder, trials, [splits[row["problem"]] for row in trials])
    write_rows(folder / "trials.parquet", trials, TRIALS)
    write_rows(folder / "problems.parquet", [asdict(problem) for problem in problems])
    truths = [
        {"problem": e.file.name, "groups": list(e.model.shape.group_names), "split": e.split} | asdict(e.truth)
        for e in entries
    ]
    test = [row for row in truths if row["split"] == SPLITS[-1]]
    write_rows(folder / "truth.parquet", [row for row in truths if row not in test], TRUTHS)
    salt = hashlib.sha256(f"{secret}/salt".encode()).hexdigest()  # masses alone could be found by trial
    text = json.dumps({"salt": salt, "problems": test}, indent=1) + "\n"
    write_text(truth_file, text)
    for entry in entries:
        for part in entry.file.mesh.parts if entry.file.mesh else ():
            write_whole(folder / "meshes" / Path(part.file).name, partial(shutil.copyfile, part.file))
    digest = hashlib.sha256(text.encode()).hexdigest()
    write_card(folder, problems, digest)
    facts = {"name": NAME, "version": VERSION, "heft": version("heft-testbed"), "truth_sha256": digest}
    write_json(folder / "benchmark.json", facts)
    return problems
