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
"""Number of letters from which on a fact is a paragraph of its own."""
Columns = Callable[[Int[np.ndarray, "K"]], Iterable[ComponentColumn]]
"""Component columns of some frames, given by their index."""


@dataclass(frozen=True, eq=False)
class Node:
    """An entity of a recording; `node / "name"` is the one below it."""

    stream: rr.RecordingStream
    path: str

    def __truediv__(self, name: object) -> Node:
        return Node(self.stream, f"{self.path}/{name}")

    def log(self, *parts: rr.AsComponents) -> None:
        """Log values that always hold."""
        self.stream.log(self.path, *parts, static=True, strict=True)

    def send(self, times: Sequence[TimeColumn], columns: Iterable[ComponentColumn]) -> None:
        """Log values at times of a timeline; without times they always hold."""
        self.stream.send_columns(self.path, times, columns, strict=True)

    def send_timed(self, time_s: Float[np.ndarray, "T"], columns: Iterable[ComponentColumn]) -> None:
        """Log values at times of a trial [s]."""
        self.send([TimeColumn(SIM_TIME, duration=time_s)], columns)


@dataclass(frozen=True, eq=False)
class Frames:
    """F moments of one timeline; on the other timeline the one at `rest` always holds."""

    timeline: str | None
    """ITERATION or SIM_TIME; None for one frame that always holds."""
    times: Float[np.ndarray, "F"]
    """Iterations, or time [s]."""
    rest: int
    """Index of the frame that holds on the other timeline."""

    @staticmethod
    def still() -> Frames:
        """A single frame, which always holds."""
        return Frames(None, np.zeros(1), 0)

    @staticmethod
    def of(iterations: Int[np.ndarray, "F"]) -> Frames:
        """Frames of an estimate, of which the last is the answer."""
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
    """Log short facts in a table headed by `kind`, and long ones below it; those without a value are left out."""
    texts = {_plain(name): _plain(value) for name, value in facts.items() if value}
    rows = [f"| {name} | {value} |" for name, value in texts.items() if len(value) < LONG]
    rest = [f"**{name}**: {value}\n" for name, value in texts.items() if len(value) >= LONG]
    log_markdown(node, "\n".join([f"### {_plain(title)}", "", f"| {kind} | |", "|---|---|", *rows, "", *rest]))


def log_markdown(node: Node, text: str) -> None:
    """Log a document."""
    node.log(rr.TextDocument(text, media_type=rr.MediaType.MARKDOWN))


def _plain(text: str) -> str:
    """Text with Markdown's signs escaped."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in " ".join(str(text).split()))


@dataclass(frozen=True, eq=False)
class Page:
    """One recording, and how the viewer lays it out."""

    name: str
    """Name in the viewer."""
    identity: str
    """Identifier; a viewer takes two recordings of one identity for one."""
    log: Callable[[rr.RecordingStream], None]
    """Function that logs everything."""
    layout: rrb.View | rrb.Container
    """Views."""
    timeline: str
    """Timeline on which it opens: SIM_TIME, playing from the start, or ITERATION, at the last one."""

    @property
    def blueprint(self) -> rrb.Blueprint:
        """Its views and nothing else; the panels are a click away."""
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
        # by way of memory: on a full disk Rerun's own writer waits for ever, or loses the end without a word
        with open(os.memfd_create("recording"), "rb") as memory, open(part, "wb") as file:
            _send(page, rr.FileSink(f"/proc/self/fd/{memory.fileno()}"))
            shutil.copyfileobj(memory, file)

    write_whole(path, write)


def send(page: Page, url: str) -> None:
    """Send a page to a viewer that listens at `url`."""
    _send(page, rr.GrpcSink(url))


def _send(page: Page, sink: rr.FileSink | rr.GrpcSink) -> None:
    stream = rr.RecordingStream(APPLICATION, recording_id=page.identity)
    stream.set_log_time_enabled(False)  # a trial has its own time, not that of its logging
    stream.set_log_tick_enabled(False)
    stream.set_sinks(sink, default_blueprint=page.blueprint)
    try:
        stream.send_recording_name(page.name)
        page.log(stream)
        stream.flush()
    finally:
        stream.disconnect()
