"""A mass for each group as bars in Rerun: the truth wide and grey, what methods say before it, intervals, a legend.

The scene's unit is kg, upwards and sideways; the object's groups follow from left to right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float

from viz.recordings.page import Frames
from viz.recordings.planar import (
    CHARACTER,
    LINE,
    MARGIN,
    Box,
    Canvas,
    log_lines,
    log_texts,
    log_upright,
    ticks,
)
from viz.style import EDGE, TRUTH, rgb

TRUTH_WIDTH, ALL_WIDTH = 0.86, 0.64
"""Of the grey bar and of all others together, over the room of a group."""
STROKE = 1.5
"""Half the width of the strokes that fill a bar, pixels."""
MOST_NAMES = 40
"""Groups that are named where there is room; of more only some."""
SWATCH = 18.0
"""Width of a colour in the legend, pixels."""
BESIDE = 62.0
"""Room for the numbers of the scale, pixels."""
ROW = LINE + MARGIN
"""Height of a row of text, pixels."""


@dataclass(frozen=True, eq=False)
class Series:
    """What one method says: F frames."""

    label: str
    color: str
    mass: Float[np.ndarray, "F n_m"]
    """kg a group."""
    frames: Frames
    half_width: Float[np.ndarray, "n_m"] | None = None
    """Half of the interval about the last frame, kg a group; NaN where nothing is known."""


@dataclass(frozen=True, eq=False)
class BarScene:
    """A bar a group of each series."""

    names: tuple[str, ...]
    """Of the groups."""
    truth: Float[np.ndarray, "n_m"] | None
    """kg a group."""
    series: tuple[Series, ...]
    canvas: Canvas

    @property
    def top(self) -> float:
        """Where the scale ends, kg: above truth and answers, and above intervals that are not much longer."""
        known = [each.mass[-1] for each in self.series] + ([] if self.truth is None else [self.truth])
        highest = max((float(values.max()) for values in known), default=1.0)
        ends = [
            float(np.nanmax(s.mass[-1] + s.half_width, initial=0.0)) for s in self.series if s.half_width is not None
        ]
        return 1.04 * max(min(max(ends, default=0.0), 1.8 * highest), highest, 1e-6)

    @property
    def box(self) -> Box:
        """All that is drawn."""
        pixel, rows = self._pixel, self._rows
        right = self.canvas.width - BESIDE
        return Box(-BESIDE * pixel, -ROW * pixel, right * pixel, self.top + (ROW * len(rows) + MARGIN) * pixel)

    def log(self, stream: rr.RecordingStream, entity: str) -> None:
        """Draw it below `entity`."""
        log_upright(stream, entity)
        stroke = STROKE * self._pixel
        self._log_scale(stream, entity)
        self._log_names(stream, entity)
        self._log_legend(stream, f"{entity}/legend")
        if self.truth is not None:
            places, truth = self._places(None), self.truth[None]
            log_bars(stream, f"{entity}/truth", places, truth, TRUTH, Frames.still(), self.top, stroke)
        for index, each in enumerate(self.series):
            places = self._places(index)
            log_bars(stream, f"{entity}/series/{index}", places, each.mass, each.color, each.frames, self.top, stroke)
            if each.half_width is not None:
                lines = whiskers(places, each.mass[-1], each.half_width, self.top)
                log_lines(stream, f"{entity}/intervals/{index}", lines, EDGE, order=22.0)

    @property
    def _rows(self) -> list[list[int]]:
        """Series in the rows of the legend; -1 is the truth."""
        rows: list[list[int]] = [[]]
        room = self.canvas.width - BESIDE
        left = room
        for index in range(-1 if self.truth is not None else 0, len(self.series)):
            width = self._entry_width(index)
            if rows[-1] and width > left:
                rows.append([])
                left = room
            rows[-1].append(index)
            left -= width
        return rows

    def _label(self, index: int) -> str:
        return "truth" if index < 0 else self.series[index].label

    def _entry_width(self, index: int) -> float:
        return SWATCH + CHARACTER * len(self._label(index)) + 5 * MARGIN

    @property
    def _pixel(self) -> float:
        """kg a pixel."""
        return self.top / (self.canvas.height - ROW * (len(self._rows) + 1) - 2 * MARGIN)

    @property
    def _room(self) -> float:
        """Width of the room of a group, kg."""
        return self._pixel * (self.canvas.width - BESIDE - 3 * MARGIN) / len(self.names)

    def _places(self, index: int | None) -> Float[np.ndarray, "n_m 2"]:
        """Left and right of the bars of a series, or of the truth."""
        middles = (np.arange(len(self.names))[:, None] + 0.5) * self._room
        if index is None:
            return middles + self._room * TRUTH_WIDTH * np.array([-0.5, 0.5])
        share = ALL_WIDTH / len(self.series)
        return middles + self._room * (-ALL_WIDTH / 2 + share * (index + np.array([0.04, 0.96])))

    def _log_scale(self, stream: rr.RecordingStream, entity: str) -> None:
        values, texts = ticks(self.top, 6)
        right, pixel = self._room * len(self.names), self._pixel
        log_lines(stream, f"{entity}/grid", [np.array([[0, v], [right, v]]) for v in values], "#DADAD8", order=1.0)
        log_lines(stream, f"{entity}/axes", [np.array([[0, self.top], [0, 0], [right, 0]])], order=23.0)
        beside = np.column_stack([np.full(len(values), -0.5 * BESIDE * pixel), values])
        log_texts(stream, f"{entity}/ticks", beside, [*texts[:-1], f"{texts[-1]} kg"], pixel)

    def _log_names(self, stream: rr.RecordingStream, entity: str) -> None:
        widest = CHARACTER * max(map(len, self.names)) + 2 * MARGIN
        every = max(int(np.ceil(widest * self._pixel / self._room)), int(np.ceil(len(self.names) / MOST_NAMES)))
        which = np.arange(0, len(self.names), every)
        below = np.column_stack([(which + 0.5) * self._room, np.full(len(which), -0.5 * ROW * self._pixel)])
        log_texts(stream, f"{entity}/names", below, [self.names[i] for i in which], self._pixel)

    def _log_legend(self, stream: rr.RecordingStream, entity: str) -> None:
        pixel = self._pixel
        for row, indices in enumerate(self._rows):
            left, y = 0.0, self.top + (ROW * (len(self._rows) - row - 0.5) + MARGIN) * pixel
            for index in indices:
                color = TRUTH if index < 0 else self.series[index].color
                ends = np.array([[left + 4, 0], [left + SWATCH - 4, 0]]) * pixel + np.array([0, y])
                line = rr.LineStrips2D([ends], colors=rgb(color), radii=4 * pixel)
                stream.log(f"{entity}/{index + 1}", line, static=True, strict=True)
                width = CHARACTER * len(self._label(index))
                at = np.array([[(left + SWATCH + MARGIN + width / 2) * pixel, y]])
                log_texts(stream, f"{entity}/{index + 1}/text", at, [self._label(index)], pixel)
                left += self._entry_width(index)


def log_bars(
    stream: rr.RecordingStream,
    entity: str,
    places: Float[np.ndarray, "n 2"],
    heights: Float[np.ndarray, "F n"],
    color: str,
    frames: Frames,
    top: float,
    stroke: float,
) -> None:
    """Bars from 0 to their heights, filled by strokes; what is above `top` ends there."""
    order = 5.0 if color == TRUTH else 10.0
    stream.log(entity, rr.LineStrips2D.from_fields(colors=rgb(color), draw_order=order), static=True, strict=True)
    shown = np.clip(heights, 0.0, top)
    bars = [
        [filled(left, right, height, stroke) for (left, right), height in zip(places, row, strict=True)]
        for row in shown
    ]
    frames.send(
        stream,
        entity,
        lambda k: rr.LineStrips2D.columns(
            strips=[strip for i in k for strip, _ in bars[i]], radii=[radius for i in k for _, radius in bars[i]]
        ).partition([len(places)] * len(k)),
    )


def filled(left: float, right: float, height: float, stroke: float) -> tuple[Float[np.ndarray, "N 2"], float]:
    """A line and half its width that cover a bar from 0 to `height` and no more: planar boxes are outlines in Rerun."""
    radius = min(stroke, height / 2, (right - left) / 2)
    # each stroke covers half of the one before, or seams would show
    x = np.linspace(left + radius, right - radius, max(int(np.ceil((right - left) / stroke)), 2))
    low, high = radius, height - radius
    around = [[x[0], low], [x[-1], low], [x[-1], high], [x[0], high]]
    strokes = [[at, end] for i, at in enumerate(x) for end in ((high, low), (low, high))[(i + 1) % 2]]
    return np.array([*around, *strokes]), radius


def whiskers(
    places: Float[np.ndarray, "n 2"], middle: np.ndarray, half: np.ndarray, top: float
) -> Sequence[Float[np.ndarray, "N 2"]]:
    """An upright line a bar with a cap at each end that is shown; none where the interval is not known."""
    lines = []
    for (left, right), value, each in zip(places, middle, half, strict=True):
        if np.isnan(each):
            continue
        x, cap = (left + right) / 2, (right - left) / 5
        low, high = np.clip((value - each, value + each), 0.0, top)
        lines.append(np.array([[x, low], [x, high]]))
        for end, inside in ((low, value - each >= 0), (high, value + each <= top)):
            if inside:
                lines.append(np.array([[x - cap, end], [x + cap, end]]))
    return lines
