"""A small benchmark of known blocks, published without a simulation."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from estimators.testing.recorded import load_block
from scenarios.benchmark.dataset import Benchmark
from scenarios.benchmark.publish import Entry, publish
from testbed.objects.files import ObjectFile, asset_folder
from testbed.sensing.camera import PoseStream
from testbed.toml import load_toml
from testbed.trajectory import Trajectory

SECRET = "a secret of the tests"
BLOCKS = {"train-turns-ideal_0": "I2", "validation-turns-ideal_0": "L2", "test-turns-ideal_0": "F2"}
TRIALS = {"train": 2, "validation": 7, "test": 2}
"""Trials of the problem of each split."""


@dataclass(frozen=True)
class Published:
    """A published folder, and all that it was made of."""

    benchmark: Benchmark
    truth_file: Path
    entries: dict[str, Entry]


def entry_of(name: str, block: str) -> Entry:
    """Problem of a known block under a sensor; its first trial has frames of a camera."""
    known = load_block(f"{block}-own_weight")
    file = load_toml(asset_folder("objects") / f"{block}.toml", ObjectFile).model_copy(update={"name": name})
    split, kind, world = name.removesuffix("_0").split("-")
    first, *rest = known.trials("ft300s", seed=3)[: TRIALS[split]]
    frames = np.arange(90.0).reshape(10, 3, 3)
    first = replace(first, camera=PoseStream(np.arange(10.0), frames, 1e-3, 2e-3, 0.01))
    weighed = np.full(1, 9.81 * known.weighed("ft300s"))
    weighing = Trajectory.of_scale(weighed, np.zeros(1), {"runner": "simulation"})
    return Entry(split, kind, world, file, file.build(3, Path()), lambda: [weighing, first, *rest])


@pytest.fixture(scope="session")
def published(tmp_path_factory) -> Published:
    """A benchmark of one problem a split."""
    folder = tmp_path_factory.mktemp("benchmark")
    entries = {name: entry_of(name, block) for name, block in BLOCKS.items()}
    truth_file = folder / "private" / "truth_test.json"
    publish(folder / "public", list(entries.values()), truth_file, SECRET)
    return Published(Benchmark.open(folder / "public"), truth_file, entries)
