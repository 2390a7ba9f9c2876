"""The published folder: tables of problems, trials, samples and truth, and its trials as an estimator is given them.

DIR/README.md, croissant.json, benchmark.json
    problems.parquet                     a row per problem
    trials.parquet                       a row per trial; a trial is an episode of the samples
    data/chunk-000/file-000.parquet      samples, with meta/ a LeRobot dataset of version 3.0
    truth.parquet                        masses and frictions of train and validation
    meshes/                              files that shapes name
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.base import robot_seconds
from scenarios.benchmark.problems import SPLITS
from scenarios.results.files import read_json
from testbed.errors import InvalidValueError, nearest
from testbed.files import write_whole
from testbed.objects.files import ObjectFile
from testbed.objects.model import ObjectModel
from testbed.sensing.camera import PoseStream
from testbed.trajectory import SERIES, Trajectory, camera_of, header_of, trajectory_of

SAMPLES = "data/chunk-000/file-000.parquet"
PREFIX = "observation."
"""Prefix of the columns of measured series."""
COUNTS = ("phase", "segment")
STEPS = {
    "object_pose": (-20,) * 3,
    "object_velocity": (-17,) * 3,
    "tcp_position": (-20,) * 3,
    "tcp_velocity": (-17,) * 6,
    "sensor_orientation": (-20,) * 4,
    "sensor_wrench": (-10,) * 3 + (-14,) * 3,
    "wrench_on_object_world": (-10,) * 3 + (-14,) * 3,
    "joint_position": (-20,) * 7,
}
"""Steps to which series are rounded, as powers of 2: 1 um and 1 urad, 8 um/s, 1 mN, 61 uN m; half the size on disk."""


@dataclass(frozen=True)
class Problem:
    """Row of the table of problems: an object as known before its trials."""

    problem: str
    """Identifier."""
    split: str
    world: str
    kind: str
    shape: str
    """Object file as JSON, without masses and frictions; meshes by paths in the folder."""
    groups: tuple[str, ...]
    """Names of the mass groups."""
    weight_kg: float
    """Mass of the object as weighed [kg]."""
    setup: str
    """Errors of the setup as stated, as JSON: standard deviations in SI units."""
    trials: int
    """Number of trials."""
    robot_s: float
    """Time of the robot in all trials [s]."""

    def model(self, folder: Path) -> ObjectModel:
        """Object with placeholders for masses and frictions."""
        return ObjectFile.model_validate_json(self.shape).build(3, folder)


@dataclass(frozen=True)
class Truth:
    """Masses and frictions of one problem."""

    mass_kg: tuple[float, ...]
    """Mass of each group [kg]."""
    friction: tuple[float, ...]
    """Friction of each friction group."""
    hinge_friction_Nm: tuple[float, ...] = ()
    """Friction of each hinge [N m]."""


@dataclass(frozen=True)
class Benchmark:
    """A published folder."""

    folder: Path

    @staticmethod
    def open(folder: Path) -> Benchmark:
        """Benchmark of a folder.

        Raises:
            InvalidValueError: no published folder, or one that is not whole.
        """
        if not (folder / "benchmark.json").is_file():
            raise InvalidValueError("--benchmark", str(folder), "a folder as `heft benchmark make` writes it")
        return Benchmark(folder.absolute())

    @cached_property
    def facts(self) -> dict[str, Any]:
        """Content of benchmark.json: version, versions of packages, and SHA-256 of the truth file of test."""
        return read_json(self.folder / "benchmark.json") or {}

    @cached_property
    def problems(self) -> dict[str, Problem]:
        """Problems by identifier, in order."""
        rows = pq.read_table(self.folder / "problems.parquet").to_pylist()
        return {row["problem"]: Problem(**row | {"groups": tuple(row["groups"])}) for row in rows}

    def of_split(self, split: str) -> list[Problem]:
        """Problems of a split.

        Raises:
            InvalidValueError: no such split, or one without problems.
        """
        known = [name for name in SPLITS if any(each.split == name for each in self.problems.values())]
        if split not in known:
            raise InvalidValueError("--split", split, f"one of {', '.join(known)}{nearest(split, known)}")
        return [each for each in self.problems.values() if each.split == split]

    @cached_property
    def truth(self) -> dict[str, Truth]:
        """Truth of train and validation by problem."""
        rows = pq.read_table(self.folder / "truth.parquet").to_pylist()
        return {row["problem"]: truth_of(row) for row in rows}

    def trajectories(self, problem: str) -> list[Trajectory]:
        """Trials of a problem as an estimator is given them, without the weighing."""
        rows = pq.read_table(self.folder / "trials.parquet", filters=[("problem", "=", problem)]).to_pylist()
        episodes = [row["episode_index"] for row in rows]
        samples = pq.read_table(self.folder / SAMPLES, filters=[("episode_index", "in", episodes)])
        index = samples["episode_index"].to_numpy()
        arrays = {name: samples[name].to_numpy() for name in ("time_s", *COUNTS)}
        for name, units in SERIES.items():
            flat = samples[PREFIX + name].combine_chunks().flatten().to_numpy()
            arrays[name] = flat.reshape(-1, len(units)).astype(float)
        return [
            trajectory_of(
                json.loads(row["header"]),
                {name: values[index == row["episode_index"]] for name, values in arrays.items()},
                _camera_of(row),
            )
            for row in rows
        ]


@lru_cache(maxsize=1)
def trajectories_of(folder: Path, problem: str) -> tuple[Trajectory, ...]:
    """Trials of a problem, cached: a worker's next method mostly has the same ones."""
    return tuple(Benchmark(folder).trajectories(problem))


def truth_of(row: dict[str, Any]) -> Truth:
    """Truth of a row of plain data."""
    return Truth(*(tuple(row[name]) for name in ("mass_kg", "friction", "hinge_friction_Nm")))


def _camera_of(row: dict[str, Any]) -> PoseStream | None:
    header = json.loads(row["header"])["camera"]
    return None if header is None else camera_of(header, *map(np.array, (row["camera_time_s"], row["camera_poses"])))


def trial_row(problem: str, number: int, episode: int, trajectory: Trajectory) -> dict[str, Any]:
    """Row of the table of trials."""
    camera = trajectory.camera
    return {
        "problem": problem,
        "trial": number,
        "episode_index": episode,
        "action": trajectory.action.kind,
        "status": trajectory.status,
        "robot_s": robot_seconds([trajectory]),
        "samples": len(trajectory.time_s),
        "header": json.dumps(header_of(trajectory)),
        "camera_time_s": None if camera is None else camera.time_s.tolist(),
        "camera_poses": None if camera is None else camera.poses.ravel().tolist(),
    }


TRIALS = pa.schema(
    [
        ("problem", pa.string()),
        ("trial", pa.int64()),
        ("episode_index", pa.int64()),
        ("action", pa.string()),
        ("status", pa.string()),
        ("robot_s", pa.float64()),
        ("samples", pa.int64()),
        ("header", pa.string()),
        ("camera_time_s", pa.list_(pa.float64())),
        ("camera_poses", pa.list_(pa.float64())),
    ]
)
"""Columns of trials.parquet."""
TRUTHS = pa.schema(
    [
        ("problem", pa.string()),
        ("groups", pa.list_(pa.string())),
        *((name, pa.list_(pa.float64())) for name in ("mass_kg", "friction", "hinge_friction_Nm")),
    ]
)
"""Columns of truth.parquet."""


def samples_of(trajectory: Trajectory, episode: int, first: int, task: int) -> pa.Table:
    """Samples of a trial, series rounded to their steps.

    Args:
        trajectory: the trial.
        episode: its number among all.
        first: number of its first sample among all.
        task: number of its task.
    """
    count = len(trajectory.time_s)
    frames = np.arange(count)
    columns: dict[str, Any] = {
        "timestamp": (trajectory.time_s - trajectory.time_s[0]).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.full(count, episode),
        "index": first + frames,
        "task_index": np.full(count, task),
        "time_s": trajectory.time_s,
        **{name: getattr(trajectory, name) for name in COUNTS},
    }
    for name, units in SERIES.items():
        step = 2.0 ** np.array(STEPS[name])
        rounded = (np.round(getattr(trajectory, name) / step) * step).astype(np.float32)
        columns[PREFIX + name] = pa.FixedSizeListArray.from_arrays(pa.array(rounded.ravel()), len(units))
    return pa.table(columns)


def write_samples(path: Path, trials: Iterable[pa.Table]) -> None:
    """Write the samples of all trials, whole or not at all; a row group a trial, so that one is read by itself."""

    def write(part: Path) -> None:
        tables = iter(trials)
        first = next(tables)
        floats = [f"{PREFIX}{name}.list.element" for name in SERIES]
        with pq.ParquetWriter(
            part,
            first.schema,
            compression="zstd",
            compression_level=9,
            use_dictionary=False,
            column_encoding=dict.fromkeys([*floats, "time_s", "timestamp"], "BYTE_STREAM_SPLIT"),
        ) as writer:
            for table in chain([first], tables):
                writer.write_table(table)

    write_whole(path, write)


def write_rows(path: Path, rows: Sequence[dict[str, Any]], schema: pa.Schema | None = None) -> None:
    """Write a table of rows as Parquet, whole or not at all."""
    table = pa.Table.from_pylist(list(rows), schema=schema)
    write_whole(path, lambda part: pq.write_table(table, part, compression="zstd"))
