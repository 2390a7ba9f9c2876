"""Rerun recordings: a page of what is to be seen, saved as a file that is whole or not there, or sent to a viewer."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from testbed.trajectory import write_whole
from viz.frames import SIM_TIME

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
