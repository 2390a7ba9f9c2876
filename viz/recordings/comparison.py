"""One object under every method side by side in Rerun: maps, differences and bars, in step over the iterations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from testbed.errors import InvalidValueError
from viz.recordings.bars import BarScene, Series
from viz.recordings.estimate import LEVEL, TITLE, EstimateShown, difference_scale_of, mass_scale_of
from viz.recordings.mass_map import BELOW, CellMap, Raster, Scale, log_bar
from viz.recordings.page import Frames
from viz.recordings.planar import Box, Canvas, log_upright, planar_view
from viz.style import TOP, series_color

WINDOW = Canvas(1590, 910)
"""What all views share in a window of 1600 by 1000, pixels."""
BARS = 250.0
"""Height of the bars' view, pixels."""
MOST_COLUMNS = 5
"""More views in a row have no room for their titles."""
GAP = 12.0
"""Around the colour bars, pixels."""
BAR = 14.0
"""Thickness of a colour bar, pixels."""


def log_comparison(stream: rr.RecordingStream, root: str, shown: Sequence[EstimateShown]) -> None:
    """Log estimates of one object below `root`: the truth, each method, and the bars of all."""
    layout = _Layout.of(shown)
    first = shown[0]
    if first.true_mass is not None:
        truth = CellMap(first.shape, first.true_mass[None], layout.mass_scale, layout.cell, named=False)
        truth.log(stream, f"{root}/truth/mass", Frames.still(), layout.box)
    for index, each in enumerate(shown):
        frames, way = each.history or (Frames.still(), None)
        entity, truth = f"{root}/methods/{index}", each.true_mass
        mass = CellMap(each.shape, way, layout.mass_scale, layout.cell, named=False)
        mass.log(stream, f"{entity}/mass", frames, layout.box)
        if truth is not None and layout.difference_scale is not None:
            off = None if way is None else np.abs(way - truth)
            difference = CellMap(each.shape, off, layout.difference_scale, layout.cell, named=False)
            difference.log(stream, f"{entity}/difference", frames, layout.box, layout.beside)
    _log_scales(stream, f"{root}/scales", layout)
    _bars(shown).log(stream, f"{root}/bars/scene")


def comparison_blueprint(root: str, shown: Sequence[EstimateShown]) -> rrb.Container:
    """The views of what `log_comparison` logs below `root`."""
    layout = _Layout.of(shown)
    known = shown[0].truth is not None
    views = [planar_view(f"{root}/truth", layout.box, "true mass")] if known else []
    for index, each in enumerate(shown):
        nad = "" if each.nad is None else f": NAD {100 * each.nad:.1f} %"
        nad = nad if each.answer is not None else ": no answer"
        views.append(planar_view(f"{root}/methods/{index}", layout.box, f"{each.method}{nad}"))
    where = "mass left, difference right" if layout.beside[0] else "mass above, difference below"
    whole = Box(0.0, -layout.cell.height, layout.cell.width, 0.0)
    views.append(planar_view(f"{root}/scales", whole, where if known else "scale"))
    lines = f"; lines: {LEVEL} intervals" if any(each.half_width is not None for each in shown) else ""
    bars = planar_view(f"{root}/bars", _bars(shown).box, f"mass of each group, all methods{lines}")
    grid = rrb.Grid(*views, grid_columns=layout.columns)
    return rrb.Vertical(grid, bars, row_shares=[WINDOW.height - BARS, BARS], name="comparison")


@dataclass(frozen=True)
class _Layout:
    """What the views of a comparison have in common."""

    columns: int
    cell: Canvas
    """Of the view of a method."""
    beside: tuple[float, float]
    """From a method's mass map to its map of differences, m."""
    box: Box
    """Of the scene of a method."""
    mass_scale: Scale
    difference_scale: Scale | None
    """None where the truth is not known."""

    @staticmethod
    def of(shown: Sequence[EstimateShown]) -> _Layout:
        """Raises InvalidValueError where there is nothing to compare, or shapes differ."""
        if not shown:
            raise InvalidValueError("shown", "none", "at least one estimate")
        first = shown[0].shape
        for each in shown[1:]:
            if each.shape.n_m != first.n_m or not np.array_equal(each.shape.particles, first.particles):
                raise InvalidValueError("shown", f"{each.title}, of another shape", f"the shape of {shown[0].title}")
        plain, known = Raster.of(first).box, shown[0].truth is not None
        count = len(shown) + 1 + known
        best: tuple[float, int, Canvas, tuple[float, float], Box] | None = None
        for columns in range(1, min(count, MOST_COLUMNS) + 1):
            rows = int(np.ceil(count / columns))
            cell = Canvas(WINDOW.width / columns, (WINDOW.height - BARS) / rows - TITLE)
            gap = 0.06 * (plain.width + plain.height)
            for beside in ((plain.width + gap, 0.0), (0.0, -plain.height - gap)):
                box = cell.framed(plain.joined(plain.moved(*beside)) if known else plain, 8, 8, 8)
                if best is None or cell.pixel(box) < best[0]:
                    best = cell.pixel(box), columns, cell, beside, box
        assert best is not None
        _, columns, cell, beside, box = best
        return _Layout(columns, cell, beside, box, *_scales(shown))


def _scales(shown: Sequence[EstimateShown]) -> tuple[Scale, Scale | None]:
    """Of mass and difference: up to most of the values, and to the truth in any case."""
    truths = [float(each.true_mass.max()) for each in shown if each.true_mass is not None]
    tops = []
    for values in ([each.mass for each in shown], [each.difference for each in shown]):
        known = [value for value in values if value is not None]
        tops.append(float(np.percentile(np.concatenate(known), TOP)) if known else 0.0)
    mass = mass_scale_of(shown, max([tops[0], *truths]))
    return mass, difference_scale_of(shown, tops[1]) if truths else None


def _bar_boxes(cell: Canvas) -> list[Box]:
    """Places of the two colour bars in a scene whose unit is a pixel: one below the other, or side by side."""
    if cell.height < 2 * (BAR + BELOW) + 2 * GAP:
        length = (cell.width - 12 * GAP) / 2
        return [Box(x, -GAP - BAR, x + length, -GAP) for x in (3 * GAP, length + 9 * GAP)]
    tops = [-GAP, -GAP - BAR - BELOW]
    return [Box(4 * GAP, top - BAR, cell.width - 4 * GAP, top) for top in tops]


def _log_scales(stream: rr.RecordingStream, entity: str, layout: _Layout) -> None:
    """The colour bars that all maps share."""
    log_upright(stream, f"{entity}/bars")
    scales = (layout.mass_scale, layout.difference_scale)
    for index, (scale, box) in enumerate(zip(scales, _bar_boxes(layout.cell), strict=True)):
        if scale is not None:
            log_bar(stream, f"{entity}/bars/{index}", scale, box, 1.0)


def _bars(shown: Sequence[EstimateShown]) -> BarScene:
    series = []
    for index, each in enumerate(shown):
        if each.history is not None:
            series.append(Series(each.method, series_color(index), each.history[1], each.history[0], each.half_width))
    return BarScene(shown[0].shape.group_names, shown[0].true_mass, tuple(series), Canvas(WINDOW.width, BARS - TITLE))
