"""A wrench sensor live in Rerun: force and torque as they come."""

from __future__ import annotations

from collections.abc import Sequence
from types import TracebackType
from typing import Self

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from viz.style import AXIS_COLORS, rgb

_TIMELINE = "time"


class SensorStream:
    """Sends what it is given to a viewer, while it is entered."""

    def __init__(self, url: str, title: str):
        """Name the viewer.

        Args:
            url: of a viewer that listens.
            title: what the recording is called.
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
                self._stream.log(
                    f"{kind}/{axis}", rr.SeriesLines(colors=rgb(color), names=axis), static=True, strict=True
                )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stream.disconnect()

    def send(self, times: Sequence[float], wrenches: np.ndarray) -> None:
        """Samples: times, s, and wrenches, N and N m, (T, 6)."""
        if not len(times):
            return
        self._begin = times[0] if self._begin is None else self._begin
        column = rr.TimeColumn(_TIMELINE, duration=np.asarray(times) - self._begin)
        for index in range(6):
            path = f"{('force', 'torque')[index // 3]}/{'xyz'[index % 3]}"
            self._stream.send_columns(path, [column], rr.Scalars.columns(scalars=wrenches[:, index]))
