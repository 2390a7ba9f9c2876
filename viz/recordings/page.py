"""Recordings: pages that are written or sent whole, and the timelines on which their values hold."""

from __future__ import annotations

import os
import shutil
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int
from rerun import ComponentColumn, TimeColumn

from testbed.files import write_whole

APPLICATION = "heft"
ITERATION = "iteration"
"""Timeline of an estimate: a count."""
SIM_TIME = "sim_time"
"""Timeline of a trial: time [s] from the start of the tare."""
LONG = 45
"""Number of characters from which a fact is a paragraph below the table."""
Columns = Callable[[Int[np.ndarray, "K"]], Iterable[ComponentColumn]]
"""Function of the indices of K frames that returns their component columns."""


@dataclass(frozen=True, eq=False)
class Node:
    """An entity of a recording; `node / "name"` is the one below it."""

    stream: rr.RecordingStream
    path: str

    def __truediv__(self, name: object) -> Node:
        return Node(self.stream, f"{self.path}/{name}")

    def log(self, *parts: rr.AsComponents) -> None:
        """Log static values."""
        self.stream.log(self.path, *parts, static=True, strict=True)

    def send(self, times: Sequence[TimeColumn], columns: Iterable[ComponentColumn]) -> None:
        """Log values at times of a timeline, or static values where `times` is empty."""
        self.stream.send_columns(self.path, times, columns, strict=True)

    def send_timed(self, time_s: Float[np.ndarray, "T"], columns: Iterable[ComponentColumn]) -> None:
        """Log values at times of a trial [s]."""
        self.send([TimeColumn(SIM_TIME, duration=time_s)], columns)


@dataclass(frozen=True, eq=False)
class Frames:
    """F frames on one timeline; the other timeline shows frame `rest` throughout."""

    timeline: str | None
    """ITERATION or SIM_TIME; None for a single static frame."""
    times: Float[np.ndarray, "F"]
    """Iterations, or time [s]."""
    rest: int
    """Index of the frame on the other timeline."""

    @staticmethod
    def still() -> Frames:
        """A single static frame."""
        return Frames(None, np.zeros(1), 0)

    @staticmethod
    def of(iterations: Int[np.ndarray, "F"]) -> Frames:
        """Frames of an estimate's iterations; the last one is the answer."""
        last = len(iterations) - 1
        return Frames(ITERATION, iterations.astype(float), last) if last else Frames.still()

    def send(self, node: Node, columns: Columns) -> None:
        """Log an entity's components at every frame."""
        rest = np.array([self.rest])
        if self.timeline is None:
            node.send([], columns(rest))
            return
        node.send([_index(self.timeline, self.times)], columns(np.arange(len(self.times))))
        other = SIM_TIME if self.timeline == ITERATION else ITERATION  # an entity has data on every timeline or none
        node.send([_index(other, np.zeros(1))], columns(rest))


def _index(timeline: str, times: np.ndarray) -> TimeColumn:
    if timeline == ITERATION:
        return TimeColumn(timeline, sequence=times.astype(np.int64))
    return TimeColumn(timeline, duration=times)


def log_facts(node: Node, title: str, kind: str, facts: Mapping[str, str]) -> None:
    """Log short facts in a table with the head `kind`, and long ones below it; empty facts are left out."""
    texts = {_plain(name): _plain(value) for name, value in facts.items() if value}
    rows = [f"| {name} | {value} |" for name, value in texts.items() if len(value) < LONG]
    long = [f"**{name}**: {value}\n" for name, value in texts.items() if len(value) >= LONG]
    log_markdown(node, "\n".join([f"### {_plain(title)}", "", f"| {kind} | |", "|---|---|", *rows, "", *long]))


def log_markdown(node: Node, text: str) -> None:
    """Log a Markdown document."""
    node.log(rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def _plain(text: str) -> str:
    """Text in one line, with Markdown's special characters escaped."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in " ".join(str(text).split()))


@dataclass(frozen=True, eq=False)
class Page:
    """One recording, and how the viewer lays it out."""

    name: str
    """Name in the viewer."""
    identity: str
    """Identifier; a viewer merges recordings of the same identity."""
    log: Callable[[rr.RecordingStream], None]
    """Function that logs all entities to a stream."""
    layout: rrb.View | rrb.Container
    """Views."""
    timeline: str
    """Timeline on which the page opens: SIM_TIME, playing from the start, or ITERATION, at the last iteration."""

    @property
    def blueprint(self) -> rrb.Blueprint:
        """Blueprint of the views alone, with the viewer's panels collapsed."""
        play = "playing" if self.timeline == SIM_TIME else "following"
        return rrb.Blueprint(
            self.layout,
            rrb.BlueprintPanel(state="collapsed"),
            rrb.SelectionPanel(state="hidden"),
            rrb.TimePanel(state="collapsed", timeline=self.timeline, play_state=play),
            auto_views=False,
            auto_layout=False,
        )


def save(page: Page, path: Path) -> None:
    """Write a page as an .rrd file, whole or not at all."""

    def write(part: Path) -> None:
        # through memory: on a full disk, Rerun's own writer blocks for ever or drops the end without an error
        with open(os.memfd_create("recording"), "rb") as memory, open(part, "wb") as file:
            _send(page, rr.FileSink(f"/proc/self/fd/{memory.fileno()}"))
            shutil.copyfileobj(memory, file)

    write_whole(path, write)


def send(page: Page, url: str) -> None:
    """Send a page to a viewer that listens at `url`."""
    _send(page, rr.GrpcSink(url))


def _send(page: Page, sink: rr.FileSink | rr.GrpcSink) -> None:
    stream = rr.RecordingStream(APPLICATION, recording_id=page.identity)
    stream.set_log_time_enabled(False)  # the time of the trial, not of its logging
    stream.set_log_tick_enabled(False)
    stream.set_sinks(sink, default_blueprint=page.blueprint)
    try:
        stream.send_recording_name(page.name)
        page.log(stream)
        stream.flush()
    finally:
        stream.disconnect()
