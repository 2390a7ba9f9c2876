"""When a value of a recording holds: over the iterations of an estimate, over the time of a trial, or always."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float, Int
from rerun import ComponentColumn, TimeColumn

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
