"""Masses of groups as bars in Rerun: the truth wide and gray, estimates in front, with intervals and a legend.

The scene's unit is kg along both axes; the object's groups follow from left to right. Rerun's own bar charts have
neither names nor intervals, and blend the colors of overlapping bars.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float
from matplotlib.transforms import Bbox

from viz.recordings.page import Frames, Node
from viz.recordings.planar import CHARACTER, LINE, MARGIN, Canvas, log_lines, log_texts, log_upright, ticks
from viz.style import EDGE, TRUTH, rgb

TRUTH_WIDTH, ALL_WIDTH = 0.86, 0.64
"""Widths of the gray bar and of all others together, relative to the width of a group."""
STROKE = 1.5
"""Half the width of the strokes that fill a bar [pixels]: planar boxes are outlines in Rerun."""
MOST_NAMES = 40
"""Largest number of group names below the bars."""
SWATCH = 18.0
"""Width of a color in the legend [pixels]."""
BESIDE = 62.0
"""Width of the numbers of the scale [pixels]."""
ROW = LINE + MARGIN
"""Height of a row of text [pixels]."""


@dataclass(frozen=True, eq=False)
class BarSeries:
    """Masses of one method in F frames."""

    label: str
    """Name in the legend."""
    color: str
    """Color of the bars."""
    mass: Float[np.ndarray, "F n_m"]
    """Mass of each group [kg]."""
    frames: Frames
    """Moments of the masses."""
    half_width: Float[np.ndarray, "n_m"] | None = None
    """Half width of the interval around the last frame [kg]; NaN where it is unknown."""


@dataclass(frozen=True, eq=False)
class BarScene:
    """One bar per group of each series."""

    names: tuple[str, ...]
    """Names of the groups."""
    truth: Float[np.ndarray, "n_m"] | None
    """True mass of each group [kg]."""
    series: tuple[BarSeries, ...]
    """Methods."""
    canvas: Canvas
    """Size of the view."""

    @property
    def top(self) -> float:
        """End of the scale [kg]: above truth and estimates, and above intervals up to 1.8 times as high."""
        known = [each.mass[-1] for each in self.series] + ([] if self.truth is None else [self.truth])
        highest = max((float(values.max()) for values in known), default=1.0)
        upper = [s.mass[-1] + s.half_width for s in self.series if s.half_width is not None]
        ends = max((float(np.nanmax(values, initial=0.0)) for values in upper), default=0.0)
        return 1.04 * max(min(ends, 1.8 * highest), highest, 1e-6)

    @property
    def box(self) -> Bbox:
        """Bounds around the whole drawing."""
        pixel = self._pixel
        right = self.canvas.width - BESIDE
        return Bbox.from_extents(
            -BESIDE * pixel, -ROW * pixel, right * pixel, self.top + (ROW * len(self._rows) + MARGIN) * pixel
        )

    def log(self, node: Node) -> None:
        """Log the scene below `node`."""
        log_upright(node)
        self._log_scale(node)
        self._log_names(node)
        self._log_legend(node / "legend")
        if self.truth is not None:
            truth = BarSeries("truth", TRUTH, self.truth[None], Frames.still())
            self._log_bars(node / "truth", truth, self._places(None), 5.0)
        for index, each in enumerate(self.series):
            places = self._places(index)
            self._log_bars(node / f"series/{index}", each, places, 10.0)
            if each.half_width is not None:
                lines = _whiskers(places, each.mass[-1], each.half_width, self.top)
                log_lines(node / f"intervals/{index}", lines, EDGE, order=22.0)

    @property
    def _rows(self) -> list[list[tuple[str, str]]]:
        """Labels and colors in the rows of the legend."""
        rows: list[list[tuple[str, str]]] = [[]]
        left = row_width = self.canvas.width - BESIDE
        truth = [] if self.truth is None else [("truth", TRUTH)]
        for label, color in truth + [(each.label, each.color) for each in self.series]:
            width = _entry_width(label)
            if rows[-1] and width > left:
                rows.append([])
                left = row_width
            rows[-1].append((label, color))
            left -= width
        return rows

    @property
    def _pixel(self) -> float:
        """Size of a pixel [kg]."""
        return self.top / (self.canvas.height - ROW * (len(self._rows) + 1) - 2 * MARGIN)

    @property
    def _group_width(self) -> float:
        """Width of a group [kg]."""
        return self._pixel * (self.canvas.width - BESIDE - 3 * MARGIN) / len(self.names)

    def _places(self, index: int | None) -> Float[np.ndarray, "n_m 2"]:
        """Left and right edges of the bars of a series [kg]; of the truth for None."""
        middles = (np.arange(len(self.names))[:, None] + 0.5) * self._group_width
        if index is None:
            return middles + self._group_width * TRUTH_WIDTH * np.array([-0.5, 0.5])
        share = ALL_WIDTH / len(self.series)
        return middles + self._group_width * (-ALL_WIDTH / 2 + share * (index + np.array([0.04, 0.96])))

    def _log_bars(self, node: Node, series: BarSeries, places: Float[np.ndarray, "n 2"], order: float) -> None:
        """Log bars from 0 to the masses, filled by strokes and clipped at the end of the scale."""
        node.log(rr.LineStrips2D.from_fields(colors=rgb(series.color), draw_order=order))
        left, right = places.T
        strips, radii = filled(left, right, np.clip(series.mass, 0.0, self.top), STROKE * self._pixel)
        series.frames.send(
            node,
            lambda k: rr.LineStrips2D.columns(
                strips=strips[k].reshape(-1, *strips.shape[2:]), radii=radii[k].ravel()
            ).partition([len(places)] * len(k)),
        )

    def _log_scale(self, node: Node) -> None:
        values, texts = ticks(self.top, 6)
        right, pixel = self._group_width * len(self.names), self._pixel
        log_lines(node / "grid", [np.array([[0, v], [right, v]]) for v in values], "#DADAD8", order=1.0)
        log_lines(node / "axes", [np.array([[0, self.top], [0, 0], [right, 0]])], order=23.0)
        beside = np.column_stack([np.full(len(values), -0.5 * BESIDE * pixel), values])
        log_texts(node / "ticks", beside, [*texts[:-1], f"{texts[-1]} kg"], pixel)

    def _log_names(self, node: Node) -> None:
        widest = CHARACTER * max(map(len, self.names)) + 2 * MARGIN
        every = max(int(np.ceil(widest * self._pixel / self._group_width)), int(np.ceil(len(self.names) / MOST_NAMES)))
        which = np.arange(0, len(self.names), every)
        below = np.column_stack([(which + 0.5) * self._group_width, np.full(len(which), -0.5 * ROW * self._pixel)])
        log_texts(node / "names", below, [self.names[i] for i in which], self._pixel)

    def _log_legend(self, node: Node) -> None:
        pixel, number = self._pixel, 0
        for row, entries in enumerate(self._rows):
            left, y = 0.0, self.top + (ROW * (len(self._rows) - row - 0.5) + MARGIN) * pixel
            for label, color in entries:
                ends = np.array([[left + 4, 0], [left + SWATCH - 4, 0]]) * pixel + np.array([0, y])
                (node / number).log(rr.LineStrips2D([ends], colors=rgb(color), radii=4 * pixel))
                at = np.array([[(left + SWATCH + MARGIN + CHARACTER * len(label) / 2) * pixel, y]])
                log_texts(node / f"{number}/text", at, [label], pixel)
                left += _entry_width(label)
                number += 1


def _entry_width(label: str) -> float:
    return SWATCH + CHARACTER * len(label) + 5 * MARGIN


def filled(
    left: Float[np.ndarray, "n"], right: Float[np.ndarray, "n"], height: Float[np.ndarray, "F n"], stroke: float
) -> tuple[Float[np.ndarray, "F n N 2"], Float[np.ndarray, "F n"]]:
    """Polylines and their radii that fill bars of equal width exactly from 0 to `height`.

    Args:
        left: left edges.
        right: right edges.
        height: heights of the n bars in F frames.
        stroke: largest radius of a line.
    """
    radius = np.minimum(np.minimum(height, right - left) / 2, stroke)
    # each stroke overlaps half of the previous one, so that no seam is visible
    count = max(int(np.ceil(np.max(right - left) / stroke)), 2)
    x = np.linspace(left + radius, right - radius, count, axis=-1)
    low, high = radius, height - radius
    around, strokes = [low, low, high, high], [low, high, high, low] * ((count + 1) // 2)
    across = np.concatenate([x[..., [0, -1, -1, 0]], np.repeat(x, 2, axis=-1)], axis=-1)
    return np.stack([across, np.stack(around + strokes[: 2 * count], axis=-1)], axis=-1), radius


def _whiskers(
    places: Float[np.ndarray, "n 2"], middle: np.ndarray, half: np.ndarray, top: float
) -> Sequence[Float[np.ndarray, "N 2"]]:
    """Vertical line of each interval, clipped to 0 and `top`, with caps at unclipped ends; none where it is NaN."""
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
