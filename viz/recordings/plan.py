"""A plan of touches in Rerun: the touches on the object, and the errors that are left after each, by iteration."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from viz.figures.plan import PlanShown
from viz.recordings.mass_map import CellMap, Raster, Scale
from viz.recordings.page import ITERATION, Frames, Page
from viz.recordings.planar import (
    LINE,
    Box,
    Canvas,
    log_lines,
    log_texts,
    log_upright,
    planar_view,
)
from viz.style import DIFFERENCE_COLORS

CANVAS = Canvas(640, 700)
"""What each view can count on, pixels."""
THICK = rr.Radius.ui_points(1.6)
"""Half the width of an arrow."""


def plan_page(shown: PlanShown) -> Page:
    """The recording of a plan."""
    errors = _error_map(shown)
    count = len(shown.errors)

    def log(stream: rr.RecordingStream) -> None:
        _log_touches(stream, "plan/touches/scene", shown)
        frames = Frames(ITERATION, np.arange(count), count - 1) if count > 1 else Frames.still()
        errors.log(stream, "plan/error/map", frames, errors.box())
        errors.log_bar(stream, "plan/error/map/bar", errors.box())
        lines = "\n".join(f"{i}. {text}" for i, text in enumerate(shown.words, start=1))
        text = rr.TextDocument(f"{shown.title}\n\n{lines}", media_type=rr.MediaType.MARKDOWN)
        stream.log("plan/words", text, static=True, strict=True)

    layout = rrb.Horizontal(
        planar_view("plan/touches", _around(shown), "what is turned about where"),
        planar_view("plan/error", errors.box(), "expected error after each touch, by iteration"),
        rrb.TextDocumentView(origin="plan/words", name="touches"),
        column_shares=[CANVAS.width, CANVAS.width, 320],
        name=shown.title,
    )
    return Page(shown.title, f"plan {shown.title}", log, layout, ITERATION)


def _error_map(shown: PlanShown) -> CellMap:
    """On the scale of what the first touches leave: what the weighing alone leaves is beyond it."""
    part = 100 * shown.errors / (shown.weight / shown.shape.n_m)
    top = float(part[min(2, len(part) - 1)].max())
    scale = Scale(max(top, 0.1), DIFFERENCE_COLORS, "expected error, % of the mean group", open=True)
    return CellMap(shown.shape, part, scale, CANVAS)


def _log_touches(stream: rr.RecordingStream, entity: str, shown: PlanShown) -> None:
    log_upright(stream, entity)
    log_lines(stream, f"{entity}/outlines", Raster.of(shown.shape).outlines())
    pixel = CANVAS.pixel(_around(shown))
    colors = (255 * mpl.colormaps["viridis"](np.linspace(0.0, 0.85, max(len(shown.actions), 1)))).astype(np.uint8)
    for number, touch in shown.touches.items():
        place, color = f"{entity}/{number}", colors[number - 1]
        back = touch.way[-1] - touch.way[-2]
        back = back / np.linalg.norm(back) * 10 * pixel
        aside = np.array([-back[1], back[0]]) / 2
        head = np.array([touch.way[-1] - back + aside, touch.way[-1], touch.way[-1] - back - aside])
        arrow = rr.LineStrips2D([touch.way, head], colors=[color], radii=THICK, draw_order=30.0)
        stream.log(f"{place}/way", arrow, static=True, strict=True)
        marks = [touch.grasp] if touch.about is None else [touch.grasp, touch.about]
        points = rr.Points2D(marks, colors=[color], radii=rr.Radius.ui_points(4.0), draw_order=31.0)
        stream.log(f"{place}/marks", points, static=True, strict=True)
        if touch.about is not None:
            log_lines(stream, f"{place}/arm", [np.array(marks)])
        log_texts(stream, f"{place}/number", touch.label[None] + [0.0, LINE * pixel], [str(number)], pixel)
    for number, point in shown.lifts.items():
        place = f"{entity}/{number}"
        up = point + 8 * pixel * np.array([[-1.0, -0.7], [1.0, -0.7], [0.0, 1.0], [-1.0, -0.7]])
        triangle = rr.LineStrips2D([up], colors=[colors[number - 1]], radii=THICK, draw_order=30.0)
        stream.log(f"{place}/lift", triangle, static=True, strict=True)
        log_texts(stream, f"{place}/number", point[None] + [0.0, LINE * pixel], [str(number)], pixel)


def _around(shown: PlanShown) -> Box:
    """The object and all touches."""
    points = np.concatenate([shown.shape.particles, *(touch.points for touch in shown.touches.values())])
    low, high = points.min(axis=0) - shown.shape.cell, points.max(axis=0) + shown.shape.cell
    return CANVAS.framed(Box(float(low[0]), float(low[1]), float(high[0]), float(high[1])), 10, 10, 10)
