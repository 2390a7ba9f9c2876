"""Films, recordings and reports are written whole or not at all: an interrupted writer leaves the file before it."""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr
import rerun.blueprint as rrb

from viz.film import write_film
from viz.recordings.page import SIM_TIME, Page, save
from viz.report.report import write_report

RESULTS: Any = None
"""Placeholder: the patched `render` reads no results."""


def interrupt(*_: object) -> None:
    raise KeyboardInterrupt


def pictures() -> Iterator[np.ndarray]:
    yield from np.full((5, 48, 64, 3), 40, dtype=np.uint8)
    interrupt()


def save_interrupted(path: Path) -> None:
    def log(stream: rr.RecordingStream) -> None:
        stream.log("a", rr.TextDocument("x" * 1_000_000), static=True)
        stream.flush()
        assert path.read_text() == "before"
        interrupt()

    save(Page("x", "x", log, rrb.Spatial3DView(), SIM_TIME), path)


WRITERS: dict[str, Callable[[Path], None]] = {
    **{f"film.{kind}": lambda path: write_film(pictures(), path, 25.0) for kind in ("mp4", "gif", "png")},
    "x.rrd": save_interrupted,
    "report.html": partial(write_report, RESULTS),
}


@pytest.mark.parametrize("name", WRITERS)
def test_an_interrupted_writer_leaves_the_file_before_it(tmp_path, monkeypatch, name):
    monkeypatch.setattr("viz.report.report.render", lambda _: "half")
    if name == "report.html":
        monkeypatch.setattr("os.replace", interrupt)
    path = tmp_path / name
    path.write_text("before")
    with pytest.raises(KeyboardInterrupt):
        WRITERS[name](path)
    assert path.read_text() == "before"
    assert list(tmp_path.iterdir()) == [path]
