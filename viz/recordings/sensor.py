"""Live wrench of a sensor in Rerun."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from viz.recordings.trial import WRENCH
from viz.style import AXIS_COLORS, rgb

_TIMELINE = "time"


class SensorStream:
    """Connection that sends a sensor's samples to a viewer."""

    def __init__(self, url: str, title: str):
        """Connect to a viewer.

        Args:
            url: of a viewer that listens.
            title: name of the recording.
        """
        views = [
            rrb.TimeSeriesView(origin=kind, name=name)
            for kind, name in (("force", "force, N"), ("torque", "torque, N m"))
        ]
        self._stream = rr.RecordingStream("heft sensor")
        self._stream.connect_grpc(url, default_blueprint=rrb.Blueprint(rrb.Vertical(*views), collapse_panels=True))
        self._stream.send_recording_name(title)
        self._begin: float | None = None
        for kind in ("force", "torque"):
            for axis, color in zip("xyz", AXIS_COLORS, strict=True):
                look = rr.SeriesLines(colors=rgb(color), names=axis)
                self._stream.log(f"{kind}/{axis}", look, static=True, strict=True)

    def send(self, times: Sequence[float], wrenches: np.ndarray) -> None:
        """Send samples: times [s], (T,), and wrenches [N, N m], (T, 6)."""
        if not len(times):
            return
        self._begin = times[0] if self._begin is None else self._begin
        column = rr.TimeColumn(_TIMELINE, duration=np.asarray(times) - self._begin)
        for path, values in zip(WRENCH, wrenches.T, strict=True):
            self._stream.send_columns(path, [column], rr.Scalars.columns(scalars=values))
