"""Known blocks: objects whose truth is known, with clean trials recorded in simulation. They ship with heft.

Each block and support has a file whose columns are whole numbers of a quantum. It leaves out the compensated wrench,
which follows from the rest, and the arm's joints, which no estimator reads: they come back as zeros.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from testbed.actions.base import action_from_dict
from testbed.errors import InvalidValueError
from testbed.files import write_whole
from testbed.objects.files import ObjectFile
from testbed.objects.model import ObjectModel
from testbed.sensing.compensation import compensate
from testbed.sensing.noise import draw_sensing, read_scale
from testbed.sensing.presets import preset
from testbed.trajectory import Tool, Trajectory

FOLDER = Path(__file__).parent / "blocks"
RATE = 100.0
"""Samples a second."""
_QUANTA: dict[str, tuple[float, ...]] = {
    "object_pose": (1e-6,) * 3,
    "object_velocity": (1e-5,) * 3,
    "tcp_position": (1e-6,) * 3,
    "tcp_velocity": (1e-5,) * 6,
    "sensor_orientation": (1e-6,) * 4,
    "sensor_wrench": (1e-3,) * 3 + (1e-4,) * 3,
}
"""Quanta of the columns: at most a hundredth of the best sensor's noise."""


@dataclass(frozen=True, eq=False)
class KnownBlock:
    """Known block: an object, its support, and clean trials of it."""

    model: ObjectModel
    """Object with its truth, which an estimator must not get."""
    support: str
    """own_weight or rigid."""
    clean: tuple[Trajectory, ...]
    """Turns at changing and at constant speed, status ok."""
    provenance: dict[str, str]
    """Source of the records."""

    @property
    def name(self) -> str:
        """Name of object and support, such as L2-rigid."""
        return f"{self.model.name}-{self.support}"

    def weighed(self, sensing: str, seed: int = 0) -> float:
        """Reading of a scale with this preset's error [kg]."""
        return read_scale(self.model.total_mass, preset(sensing), [seed, 1])

    def trials(self, sensing: str, seed: int = 0) -> list[Trajectory]:
        """Trials with one draw of a preset's errors; each trial gets errors of its own."""
        streams = np.random.SeedSequence(seed).spawn(len(self.clean))
        seeds = [int(stream.generate_state(1)[0]) for stream in streams]
        return [draw_sensing(t, preset(sensing), s).blinded() for t, s in zip(self.clean, seeds, strict=True)]


def block_names() -> list[str]:
    """Names of all known blocks."""
    return sorted(path.stem for path in FOLDER.glob("*.parquet"))


@lru_cache(maxsize=4)
def load_block(name: str) -> KnownBlock:
    """Load a known block by name.

    Raises:
        InvalidValueError: no such block.
    """
    if name not in block_names():
        raise InvalidValueError("known_block", name, f"one of {', '.join(block_names())}")
    table = pq.read_table(FOLDER / f"{name}.parquet")
    header: dict[str, Any] = json.loads((table.schema.metadata or {})[b"heft"])
    columns = {key: table.column(key).to_numpy() for key in table.column_names}
    trials = []
    for index, entry in enumerate(header["trials"]):
        here = columns["trial"] == index
        series: dict[str, Any] = {
            key: np.stack([columns[f"{key}.{i}"][here] * quantum for i, quantum in enumerate(quanta)], axis=1)
            for key, quanta in _QUANTA.items()
        }
        count = int(here.sum())
        bare = Trajectory(
            action=action_from_dict(entry["action"]),
            status="ok",
            reason="",
            time_s=np.arange(count) / RATE,
            phase=columns["phase"][here].astype(np.int64),
            segment=columns["segment"][here].astype(np.int64),
            **series,
            wrench_on_object_world=np.zeros((count, 6)),
            joint_position=np.zeros((count, 7)),
            tool=Tool(**entry["tool"]),
            sensor_bias_std=np.zeros(6),
            provenance=header["provenance"],
        )
        trials.append(compensate(bare))
    file = ObjectFile.model_validate(header["object"])
    return KnownBlock(file.build(3, FOLDER), header["support"], tuple(trials), header["provenance"])


def save_block(
    file: ObjectFile, support: str, trials: Sequence[Trajectory], provenance: dict[str, str], folder: Path = FOLDER
) -> Path:
    """Write a known block from clean records of turns at `RATE`, status ok; returns its path."""
    whole: dict[str, list[np.ndarray]] = {"trial": [], "phase": [], "segment": []}
    entries = []
    for index, trial in enumerate(trials):
        assert trial.ok and trial.tool is not None and np.allclose(np.diff(trial.time_s), 1 / RATE)
        whole["trial"].append(np.full(len(trial.time_s), index))
        whole["phase"].append(trial.phase)
        whole["segment"].append(trial.segment)
        for key, quanta in _QUANTA.items():
            for i, quantum in enumerate(quanta):
                whole.setdefault(f"{key}.{i}", []).append(np.round(getattr(trial, key)[:, i] / quantum))
        tool = {key: np.asarray(value).tolist() for key, value in vars(trial.tool).items()}
        entries.append({"action": trial.action.to_dict(), "tool": tool})
    table = pa.table({key: np.concatenate(parts).astype(np.int32) for key, parts in whole.items()})
    header = {"object": file.model_dump(exclude_none=True), "support": support, "trials": entries}
    table = table.replace_schema_metadata({b"heft": json.dumps(header | {"provenance": provenance}).encode()})
    path = folder / f"{file.name}-{support}.parquet"
    encoding = dict.fromkeys(table.column_names, "DELTA_BINARY_PACKED")
    write_whole(
        path,
        lambda part: pq.write_table(
            table, part, compression="zstd", compression_level=19, use_dictionary=False, column_encoding=encoding
        ),
    )
    return path
