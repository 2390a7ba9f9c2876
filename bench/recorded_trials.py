"""Record the known blocks that the conformance kit ships: clean trials of the simulated bench.

    python bench/recorded_trials.py [RESULTS]      about ten minutes of one core

Thirteen objects under both supports: the paper's six, the two of the tutorial, four drawn ones of other masses,
frictions and sizes, and one with two frictions. Each is given three
turns at changing speed and four at constant speed, 4 s there and 4 s back. What is in the results folder,
results/recorded_trials if left out, is not made again.
"""

from __future__ import annotations

import sys
import tomllib
from importlib.metadata import version
from pathlib import Path

from estimators.testing.recorded import FOLDER, save_block
from scenarios.config import Scenario
from scenarios.results.store import Store
from scenarios.study.run import run_scenario
from testbed.objects.files import Blocks, ObjectFile, asset_folder
from testbed.objects.random import Family

LIBRARY = ("I1", "I2", "L1", "L2", "F1", "F2")
TUTORIAL = ("T", "U")
DRAWN = (
    Family(name="drawn_a", count=1, seed=4, blocks=[4, 5], mass_kg=[0.05, 0.12, 0.33, 0.5], friction=[0.2, 0.3]),
    Family(name="drawn_b", count=1, seed=2, blocks=[7, 8], mass_kg=[0.06, 0.15, 0.27], friction=[0.7, 0.8]),
    Family(name="drawn_c", count=1, seed=3, blocks=[5, 6], mass_kg=[0.1, 0.2, 0.3], size_m=0.04, height_m=0.025),
    Family(name="drawn_d", count=1, seed=9, blocks=[5, 6], mass_kg=[0.1, 0.2, 0.3], size_m=0.04, height_m=0.025),
)
TWO_FRICTIONS = ObjectFile(
    name="two_frictions",
    blocks=Blocks(
        layout=["10", "10", "111"],
        mass_kg=[0.3, 0.2, 0.4, 0.15, 0.25],
        friction=[0.3, 0.6],
        friction_group=[0, 0, 1, 1, 1],
    ),
)
POLICY = {"pivots": 4, "duration": 4.0, "accelerated": 3, "held_out": 0}


def files() -> list[ObjectFile]:
    """The objects."""
    paths = [asset_folder("objects") / f"{name}.toml" for name in LIBRARY]
    paths += [Path(__file__).parent.parent / "docs" / "objects" / f"{name}.toml" for name in TUTORIAL]
    read = [ObjectFile.model_validate(tomllib.loads(path.read_text(encoding="utf-8"))) for path in paths]
    return [*read, *(family.draw(0, 0).model_copy(update={"name": family.name}) for family in DRAWN), TWO_FRICTIONS]


def main(out: Path) -> None:
    """Make the trials that are not there, and write them as known blocks."""
    store, objects = Store(out.absolute()), {}
    for file in files():
        path = store.root / "objects" / f"{file.name}.toml"
        store.put_object(path, file)
        objects[file.name] = (file, str(path))
    scenario = Scenario.model_validate(
        {
            "objects": [path for _, path in objects.values()],
            "support": ["own_weight", "rigid"],
            "policy": POLICY,
        }
    )
    table = run_scenario(scenario, out, 1, lambda stage, done, total, failed=0: print(stage, done, total, failed))
    packages = {name: version(name) for name in ("heft-testbed", "mujoco")}
    provenance = {"made_by": "bench/recorded_trials.py", "bench": "simulated", **packages}
    FOLDER.mkdir(exist_ok=True)
    for row in table.to_dict("records"):
        if row["status"] in ("failed", "infeasible"):
            print(row["object"], row["support"], row["status"], row["message"])
            continue
        trials = [store.trajectory(key) for key in row["trial_keys"][1:]]  # the first is the weighing
        if not all(trial.ok for trial in trials):
            print(row["object"], row["support"], [(trial.status, trial.reason) for trial in trials if not trial.ok])
        path = save_block(objects[row["object"]][0], row["support"], [t for t in trials if t.ok], provenance)
        print(path.name, path.stat().st_size, row["status"], f"NAD {row['nad']:.4f}")


if __name__ == "__main__":
    main(Path(sys.argv[1] if len(sys.argv) > 1 else "results/recorded_trials"))
