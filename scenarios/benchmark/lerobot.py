"""Metadata that make the samples a LeRobot dataset of version 3.0: features, tasks, episodes, splits, statistics."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from scenarios.benchmark.dataset import PREFIX, SAMPLES, write_rows
from testbed.files import write_text, write_whole
from testbed.trajectory import SERIES

TASKS = {
    "rotate": "Turn the object on the table about a grasp.",
    "accelerate": "Turn the object on the table about a grasp with stepped acceleration.",
    "slide": "Slide the object over the table.",
    "push": "Push a face of the object.",
    "path": "Drag the object along a path.",
    "lift": "Lift the object and tilt it in the air.",
}
"""Task of each kind of action, in words."""


def statistics(samples: Path) -> dict[str, dict[str, list[float]]]:
    """Least, most, mean, standard deviation and number of samples of each column of a file."""
    found = {}
    for name in pq.read_schema(samples).names:  # one after the other: all would take a gigabyte
        column = pq.read_table(samples, columns=[name])[name].combine_chunks()
        flat = column.flatten() if isinstance(column, pa.FixedSizeListArray) else column
        values = flat.to_numpy().reshape(len(column), -1).astype(float)
        figures = {"min": values.min(0), "max": values.max(0), "mean": values.mean(0), "std": values.std(0)}
        found[name] = {key: each.tolist() for key, each in figures.items()} | {"count": [len(column)]}
    return found


def write_meta(folder: Path, trials: Sequence[dict[str, Any]], splits: Sequence[str]) -> None:
    """Write the folder `meta` beside the samples.

    Args:
        folder: the published folder.
        trials: rows of the table of trials, in order of their episodes.
        splits: split of each trial.
    """
    tasks = list(TASKS.values())
    end = np.cumsum([trial["samples"] for trial in trials])
    episodes = [
        {
            "episode_index": index,
            "tasks": [TASKS[trial["action"]]],
            "length": trial["samples"],
            "data/chunk_index": 0,
            "data/file_index": 0,
            "dataset_from_index": int(stop) - trial["samples"],
            "dataset_to_index": int(stop),
            "meta/episodes/chunk_index": 0,
            "meta/episodes/file_index": 0,
            "problem": trial["problem"],
            "trial": trial["trial"],
        }
        for index, (trial, stop) in enumerate(zip(trials, end, strict=True))
    ]
    write_rows(folder / "meta/episodes/chunk-000/file-000.parquet", episodes)
    frame = pd.DataFrame({"task_index": range(len(tasks))}, index=pd.Index(tasks, name="task"))
    write_whole(folder / "meta/tasks.parquet", frame.to_parquet)
    features: dict[str, Any] = {
        column.name: {"dtype": np.dtype(column.type.to_pandas_dtype()).name, "shape": [1], "names": None}
        for column in pq.read_schema(folder / SAMPLES)
        if not column.name.startswith(PREFIX)
    }
    for name, units in SERIES.items():
        features[PREFIX + name] = {"dtype": "float32", "shape": [len(units)], "names": list(units)}
    ranges = {name: [i for i, split in enumerate(splits) if split == name] for name in dict.fromkeys(splits)}
    info = {
        "codebase_version": "v3.0",
        "robot_type": "kinova_gen3",
        "total_episodes": len(trials),
        "total_frames": int(end[-1]),
        "total_tasks": len(tasks),
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": 100,
        "splits": {name: f"{own[0]}:{own[-1] + 1}" for name, own in ranges.items()},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    for name, content in (("info", info), ("stats", statistics(folder / SAMPLES))):
        write_text(folder / f"meta/{name}.json", json.dumps(content, indent=1) + "\n")
