"""When a value of a recording holds: over the iterations of an estimate, over the time of a trial, or always."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, Int
from rerun import ComponentColumn, TimeColumn

from testbed.trajectory import write_whole

ITERATION = "iteration"
"""The timeline of an estimate: a count."""
SIM_TIME = "sim_time"
"""The timeline of a trial: s from the start of the tare."""
MOST_FRAMES = 200
"""More than these show nothing more."""
Columns = Callable[[Int[np.ndarray, "K"]], Iterable[ComponentColumn]]
"""The component columns of some frames, given by their index."""


@dataclass(frozen=True, eq=False)
class Frames:
    """F moments of one timeline. On the other timeline one of them, the one at `rest`, always holds."""

    timeline: str | None
    """ITERATION or SIM_TIME; None for one frame that always holds."""
    times: Float[np.ndarray, "F"]
    """Iterations, or s."""
    rest: int
    """Index of the frame that tells most without a timeline."""

    @staticmethod
    def still() -> Frames:
        """A single frame, which always holds."""
        return Frames(None, np.zeros(1), 0)

    def send(self, stream: rr.RecordingStream, entity: str, columns: Columns) -> None:
        """Log an entity's components at every frame."""
        rest = np.array([self.rest])
        if self.timeline is None:
            stream.send_columns(entity, [], columns(rest), strict=True)
            return
        stream.send_columns(
            entity, [_index(self.timeline, self.times)], columns(np.arange(len(self.times))), strict=True
        )
        other = SIM_TIME if self.timeline == ITERATION else ITERATION  # an entity has data on every timeline or none
        stream.send_columns(entity, [_index(other, np.zeros(1))], columns(rest), strict=True)


def evenly(count: int, most: int = MOST_FRAMES) -> Int[np.ndarray, "F"]:
    """Indices of at most `most` of `count` samples, evenly spread, the first and the last among them."""
    return np.unique(np.linspace(0, count - 1, min(count, most)).round().astype(np.int64))


def _index(timeline: str, times: np.ndarray) -> TimeColumn:
    if timeline == ITERATION:
        return TimeColumn(timeline, sequence=times.astype(np.int64))
    return TimeColumn(timeline, duration=times)


LONG = 45
"""Letters from which on a fact is a paragraph of its own."""


def facts_markdown(title: str, kind: str, facts: Mapping[str, str]) -> str:
    """Short facts in a table headed by `kind`, long ones below it; those without a value are left out."""
    said = {_plain(name): _plain(value) for name, value in facts.items() if value}
    rows = [f"| {name} | {value} |" for name, value in said.items() if len(value) < LONG]
    rest = [f"**{name}**: {value}\n" for name, value in said.items() if len(value) >= LONG]
    return "\n".join([f"### {_plain(title)}", "", f"| {kind} | |", "|---|---|", *rows, "", *rest])


def _plain(text: str) -> str:
    """Text that Markdown leaves as it is."""
    return "".join(f"\\{c}" if c in "\\`*_[]<>#|" else c for c in " ".join(str(text).split()))


APPLICATION = "heft"


@dataclass(frozen=True, eq=False)
class Page:
    """One recording: what is logged, and how it is laid out."""

    name: str
    """What the viewer calls it."""
    identity: str
    """A viewer takes two recordings of one identity for one."""
    log: Callable[[rr.RecordingStream], None]
    """Logs everything."""
    layout: rrb.View | rrb.Container
    """The views."""
    timeline: str
    """On which it opens: SIM_TIME, playing from the start, or ITERATION, at the last one."""

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
    write_whole(path, lambda part: _send(page, rr.FileSink(part)))


def send(page: Page, url: str) -> None:
    """Send a page to a viewer that listens at `url`."""
    _send(page, rr.GrpcSink(url))


def _send(page: Page, sink: rr.FileSink | rr.GrpcSink) -> None:
    stream = rr.RecordingStream(APPLICATION, recording_id=page.identity)
    stream.set_log_time_enabled(False)  # what is seen has the trial's own time, not that of its logging
    stream.set_log_tick_enabled(False)
    stream.set_sinks(sink, default_blueprint=page.blueprint)
    try:
        stream.send_recording_name(page.name)
        page.log(stream)
        stream.flush()
    finally:
        stream.disconnect()
