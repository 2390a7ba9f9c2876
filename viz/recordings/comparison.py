"""One object under every method side by side in Rerun: maps, differences and bars, synchronized by iteration."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.transforms import Bbox

from testbed.errors import InvalidValueError
from viz.recordings.bars import BarScene, BarSeries
from viz.recordings.estimate import frames_of
from viz.recordings.mass_map import BELOW, MassMap, Raster, log_bar
from viz.recordings.page import Frames, Node
from viz.recordings.planar import TITLE, Canvas, log_upright, planar_view
from viz.style import Scale, difference_scale, mass_scale, series_color, top_of
from viz.values import LEVEL, EstimateView

WINDOW = Canvas(1590, 910)
"""Size of all views together in a window of 1600 by 1000 pixels."""
BARS = 250.0
"""Height of the bars' view [pixels]."""
MOST_COLUMNS = 5
"""Largest number of views in a row whose titles have room."""
GAP = 12.0
"""Distance around the color bars [pixels]."""
BAR = 14.0
"""Thickness of a color bar [pixels]."""


def log_comparison(stream: rr.RecordingStream, root: str, views: Sequence[EstimateView]) -> None:
    """Log estimates of one object below `root`: the truth, each method, and the bars of all."""
    node = Node(stream, root)
    layout, first = _Layout.of(views), views[0]
    mass, difference = layout.scales

    def log_map(place: Node, values: np.ndarray | None, scale: Scale, frames: Frames, at: tuple[float, float]) -> None:
        MassMap(first.shape, values, scale, layout.cell, named=False).log(place, frames, layout.box, at)

    if first.true_mass is not None:
        log_map(node / "truth/mass", first.true_mass[None], mass, Frames.still(), (0.0, 0.0))
    for index, view in enumerate(views):
        frames, iterates = frames_of(view)
        place, truth = node / f"methods/{index}", view.true_mass
        log_map(place / "mass", iterates, mass, frames, (0.0, 0.0))
        if truth is not None and difference is not None:
            differences = None if iterates is None else np.abs(iterates - truth)
            log_map(place / "difference", differences, difference, frames, layout.beside)
    log_upright(node / "scales/bars")
    for index, (scale, box) in enumerate(zip(layout.scales, _bar_boxes(layout.cell), strict=True)):
        if scale is not None:
            log_bar(node / f"scales/bars/{index}", scale, box, 1.0)
    _bars(views).log(node / "bars/scene")


def comparison_blueprint(root: str, views: Sequence[EstimateView]) -> rrb.Container:
    """Views of the entities that `log_comparison` logs below `root`."""
    layout = _Layout.of(views)
    known = views[0].truth is not None
    maps = [planar_view(f"{root}/truth", layout.box, "true mass")] if known else []
    for index, view in enumerate(views):
        nad = "" if view.nad is None else f": NAD {100 * view.nad:.1f} %"
        nad = nad if view.answer is not None else ": no answer"
        maps.append(planar_view(f"{root}/methods/{index}", layout.box, f"{view.method}{nad}"))
    where = "mass left, difference right" if layout.beside[0] else "mass above, difference below"
    whole = Bbox.from_extents(0.0, -layout.cell.height, layout.cell.width, 0.0)
    maps.append(planar_view(f"{root}/scales", whole, where if known else "scale"))
    lines = f"; lines: {LEVEL} intervals" if any(view.half_width is not None for view in views) else ""
    bars = planar_view(f"{root}/bars", _bars(views).box, f"mass of each group, all methods{lines}")
    grid = rrb.Grid(*maps, grid_columns=layout.columns)
    return rrb.Vertical(grid, bars, row_shares=[WINDOW.height - BARS, BARS], name="comparison")


@dataclass(frozen=True)
class _Layout:
    """Sizes and scales that the views of a comparison share."""

    columns: int
    cell: Canvas
    """Size of a method's view."""
    beside: tuple[float, float]
    """Vector from a method's mass map to its map of differences [m]."""
    box: Bbox
    """Bounds around the scene of a method."""
    scales: tuple[Scale, Scale | None]
    """Scales of mass and difference; the second is None where the truth is unknown."""

    @staticmethod
    def of(views: Sequence[EstimateView]) -> _Layout:
        """Layout with the largest maps.

        Raises:
            InvalidValueError: no views, or views of different shapes.
        """
        if not views:
            raise InvalidValueError("views", "none", "at least one estimate")
        first = views[0].shape
        for view in views[1:]:
            if view.shape.n_m != first.n_m or not np.array_equal(view.shape.particles, first.particles):
                raise InvalidValueError("views", f"{view.title}, of another shape", f"the shape of {views[0].title}")
        outline, known = Raster.of(first).box, views[0].truth is not None
        count = len(views) + 1 + known
        gap = 0.06 * (outline.width + outline.height)
        places = ((outline.width + gap, 0.0), (0.0, -outline.height - gap))
        found: list[tuple[int, Canvas, tuple[float, float], Bbox]] = []
        for columns in range(1, min(count, MOST_COLUMNS) + 1):
            rows = int(np.ceil(count / columns))
            cell = Canvas(WINDOW.width / columns, (WINDOW.height - BARS) / rows - TITLE)
            for beside in places:
                box = cell.framed(Bbox.union([outline, outline.translated(*beside)]) if known else outline, 8, 8, 8)
                found.append((columns, cell, beside, box))
        best = min(found, key=lambda each: each[1].pixel(each[3]))
        return _Layout(*best, scales=_scales(views))


def _scales(views: Sequence[EstimateView]) -> tuple[Scale, Scale | None]:
    """Scales of mass and difference up to a high percentile; that of mass holds the whole truth."""
    truths = [float(view.true_mass.max()) for view in views if view.true_mass is not None]
    mass = mass_scale(views, max([top_of([view.mass for view in views if view.mass is not None]), *truths]))
    top = top_of([view.difference for view in views if view.difference is not None])
    return mass, difference_scale(views, top) if truths else None


def _bar_boxes(cell: Canvas) -> list[Bbox]:
    """Places of the two color bars [pixels]: one below the other, or side by side."""
    if cell.height < 2 * (BAR + BELOW) + 2 * GAP:
        length = (cell.width - 12 * GAP) / 2
        return [Bbox.from_extents(x, -GAP - BAR, x + length, -GAP) for x in (3 * GAP, length + 9 * GAP)]
    tops = [-GAP, -GAP - BAR - BELOW]
    return [Bbox.from_extents(4 * GAP, top - BAR, cell.width - 4 * GAP, top) for top in tops]


def _bars(views: Sequence[EstimateView]) -> BarScene:
    series = []
    for index, view in enumerate(views):
        frames, iterates = frames_of(view)
        if iterates is not None:
            series.append(BarSeries(view.method, series_color(index), iterates, frames, view.half_width))
    canvas = Canvas(WINDOW.width, BARS - TITLE)
    return BarScene(views[0].shape.group_names, views[0].true_mass, tuple(series), canvas)
