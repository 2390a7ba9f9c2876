"""A Rerun recording read back from its file."""

import subprocess
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import rerun_cli
from rerun.chunk import RrdReader

from viz.recordings.page import Page, save


@dataclass
class Entity:
    """Content of one path."""

    static: dict[str, Any] = field(default_factory=dict)
    """Value of each static component."""
    times: dict[str, dict[str, np.ndarray]] = field(default_factory=dict)
    """Times of each component, by timeline; durations in s."""
    values: dict[str, dict[str, list[Any]]] = field(default_factory=dict)
    """Values of each component at its times, by timeline."""

    def at_end(self, component: str, timeline: str = "iteration") -> Any:
        """The last value on a timeline."""
        return self.values[timeline][component][-1]


def read_chunks(path: Path) -> dict[str, Entity]:
    """Every entity of the recording, by its path without the leading slash."""
    found: dict[str, Entity] = {}
    for chunk in RrdReader(path).stream():
        batch = chunk.to_record_batch()
        entity = found.setdefault(chunk.entity_path.lstrip("/"), Entity())
        columns = {name: batch.column(i) for i, name in enumerate(batch.schema.names)}
        components = {n: c for n, c in columns.items() if ":" in n and not n.startswith("rerun.")}
        if chunk.is_static:
            entity.static |= {name: column.to_pylist()[-1] for name, column in components.items()}
            continue
        for timeline in chunk.timeline_names:
            at = columns[timeline]
            times = at.cast("int64").to_numpy(zero_copy_only=False)
            scale = 1e-9 if "duration" in str(at.type) else 1.0
            for name, column in components.items():
                entity.times.setdefault(timeline, {})[name] = times * scale
                entity.values.setdefault(timeline, {})[name] = column.to_pylist()
    return found


def verify(path: Path) -> None:
    """Check a recording by `rerun rrd verify`."""
    program = Path(rerun_cli.__file__).with_name("rerun")  # the program itself, without a start of Python
    subprocess.run([program, "rrd", "verify", path], check=True, capture_output=True)


def logged(page: Page, path: Path) -> dict[str, Entity]:
    """Entities of a page, written to a file in which no fault is found."""
    save(page, path)
    verify(path)
    return read_chunks(path)
