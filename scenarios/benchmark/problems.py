"""Problems of the benchmark: each an object of its own, drawn for one split, world and kind, and its trials."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.catalog import LIBRARY
from scenarios.config import Scenario, WorldTable
from scenarios.policies import Policy
from scenarios.results.store import Store
from testbed.objects.files import ObjectFile, asset_folder
from testbed.objects.random import Family
from testbed.toml import load_toml
from testbed.worlds.seeds import seed_of

SPLITS = ("train", "validation", "test")
"""Splits, in order; the truth of the last is not published."""
WORLDS = ("ideal", "lab", "rough")
"""Worlds of the trials."""
SENSING = "ft300s"
"""Sensing preset of all trials."""
PUBLISHED_SECRET = "heft-benchmark-1"
"""Secret of train and validation, which is public."""
MASS_KG, LINK_KG = (0.05, 0.8), (0.03, 0.3)
"""Range of the mass of a block, and of a smaller block in links [kg]."""
FRICTION, HINGE_NM = (0.2, 0.7), (0.003, 0.02)
"""Range of the coefficient of friction on the table, and of the friction of a hinge [N m]."""
SHARE = (0.5, 2.0)
"""Range of the factor on the mass of a part of a mesh."""
MASSES = 64
"""Number of masses from which those of a cell's blocks are drawn."""


@dataclass(frozen=True)
class Kind:
    """Kind of problem: its objects, their support and their actions."""

    line: str
    """Line of the dataset card."""
    policy: Policy
    support: str = "own_weight"
    """Support of all its objects, by name."""
    shapes: tuple[Path, ...] = ()
    """Object files whose masses and frictions are drawn anew; blocks of drawn layouts if empty."""


KINDS = {
    "turns": Kind(
        "Four to eight blocks, each on its own weight. The hand turns them about blocks that it can grip.",
        Policy(pivots=3, accelerated=2, duration=9.0, held_out=0),
    ),
    "pushes": Kind(
        "Four to eight blocks, each on its own weight. A finger pushes random faces, and a camera sees them.",
        Policy(kind="push", touches=12),
    ),
    "links": Kind(
        "Blocks in two or three links on hinges, each block on its own weight. The hand drags one, a camera sees all.",
        Policy(kind="drag", touches=6, held_out=0),
        shapes=tuple(LIBRARY / "objects" / f"{name}.toml" for name in ("fold_2", "elbow", "fold_3")),
    ),
    "tools": Kind(
        "Hammer and wrench of two parts, one rigid body each. The hand turns them on the table, then lifts them.",
        Policy(pivots=2, accelerated=1, lifts=2, duration=9.0, held_out=0),
        "rigid",
        tuple(asset_folder("objects") / f"{name}.toml" for name in ("hammer", "wrench")),
    ),
}
"""Kinds of problems by name."""


@dataclass(frozen=True)
class Cell:
    """Problems of one split, kind and world, whose objects are drawn together."""

    split: str
    kind: str
    world: str
    count: int

    @property
    def name(self) -> str:
        """Beginning of the identifiers of its problems."""
        return f"{self.split}-{self.kind}-{self.world}"

    @property
    def expected_trials(self) -> int:
        """Number of trials of all its problems, weighings included, if none is refused."""
        return KINDS[self.kind].policy.expected_trials() * self.count

    def scenario(self, store: Store) -> Scenario:
        """Scenario of its trials; the object files of its shapes are written to the store."""
        kind, seed = KINDS[self.kind], seed_of(store.secret, "objects", self.name)
        rng = np.random.default_rng(seed)
        objects: dict[str, Any] = {"objects": [str(self._drawn(i, rng, store)) for i in range(self.count)]}
        if not kind.shapes:
            mass = [round(float(m), 4) for m in rng.uniform(*MASS_KG, MASSES)]
            family = Family(name=self.name, count=self.count, seed=seed, mass_kg=mass, friction=list(FRICTION))
            objects = {"random": [family]}
        world = WorldTable(preset=self.world)
        return Scenario(**objects, support=[kind.support], sensing=[SENSING], seeds=1, policy=kind.policy, world=world)

    def _drawn(self, index: int, rng: np.random.Generator, store: Store) -> Path:
        """File of an object of one of the kind's shapes, with masses and frictions of its own."""
        shapes = KINDS[self.kind].shapes
        path = store.root / "objects" / self.name / f"{self.name}_{index}.toml"
        if shapes:
            store.put_object(path, redrawn(shapes[index % len(shapes)], path.stem, rng))
        return path


def cells(split: str, count: int) -> list[Cell]:
    """Cells of a split, with `count` problems each; none for 0."""
    return [Cell(split, kind, world, count) for kind in KINDS for world in WORLDS] if count else []


def redrawn(source: Path, name: str, rng: np.random.Generator) -> ObjectFile:
    """Object of a file under another name, with other masses, frictions and hinge frictions."""

    def drawn(low: float, high: float) -> float:
        return round(float(rng.uniform(low, high)), 4)

    file = load_toml(source, ObjectFile)
    given: dict[str, Any] = file.model_dump(exclude_none=True) | {"name": name}
    for hinge in given["hinges"]:
        hinge["friction_Nm"] = drawn(*HINGE_NM)
    if file.blocks:
        given["blocks"] |= {
            "mass_kg": [drawn(*LINK_KG) for _ in given["blocks"]["mass_kg"]],
            "friction": drawn(*FRICTION),
        }
    else:
        mesh = given["mesh"]
        friction = np.atleast_1d(mesh["friction"])
        mesh["friction"] = [drawn(*FRICTION) for _ in friction]
        for part in mesh["parts"]:
            part["mass_kg"] = round(part["mass_kg"] * drawn(*SHARE), 4)
            part["file"] = str(source.parent / part["file"])
    return ObjectFile.model_validate(given)


def hidden(file: ObjectFile) -> dict[str, Any]:
    """Object file as plain data without masses and frictions; meshes are files of the folder `meshes`."""
    given = file.model_dump(exclude_none=True)
    given["hinges"] = [{name: value for name, value in h.items() if name != "friction_Nm"} for h in given["hinges"]]
    if file.blocks:
        given["blocks"] = {n: v for n, v in given["blocks"].items() if n not in ("mass_kg", "friction")}
    else:
        mesh = given["mesh"]
        mesh["friction"] = [0.5] * len(mesh["friction"])  # their number says how friction is divided
        for part in mesh["parts"]:
            del part["mass_kg"]
            part["file"] = f"meshes/{Path(part['file']).name}"
    return {name: value for name, value in given.items() if value}
