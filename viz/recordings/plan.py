"""A plan in Rerun: its actions on the object, and the expected errors after each action, by iteration."""

from __future__ import annotations

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from matplotlib.transforms import Bbox

from viz.recordings.mass_map import MassMap, Raster, log_hinges
from viz.recordings.page import ITERATION, Frames, Node, Page, log_markdown
from viz.recordings.planar import Canvas, log_lines, log_texts, log_upright, planar_view
from viz.style import DIFFERENCE_COLORS, PLAN_ERROR, Scale, action_colors
from viz.values import PlanView

CANVAS = Canvas(640, 700)
"""Size of each view [pixels]."""
THICK = rr.Radius.ui_points(1.6)
"""Half the width of an arrow."""


def plan_page(plan: PlanView) -> Page:
    """Page of a plan."""
    # scale of the errors after two actions: those after the weighing alone exceed it
    top = float(plan.grams[min(2, len(plan.errors) - 1)].max())
    scale = Scale(max(top, 0.1), DIFFERENCE_COLORS, PLAN_ERROR, open=True)
    errors = MassMap(plan.shape, plan.grams, scale, CANVAS)

    def log(stream: rr.RecordingStream) -> None:
        node = Node(stream, "plan")
        _log_actions(node / "actions/scene", plan)
        errors.log_with_bar(node / "error/map", Frames.of(np.arange(len(plan.errors))))
        lines = "\n".join(f"{i}. {text}" for i, text in enumerate(plan.words, start=1))
        log_markdown(node / "words", f"{plan.title}\n\n{lines}")

    layout = rrb.Horizontal(
        planar_view("plan/actions", _around(plan), "actions along their arrows; dot without arrow: pivot"),
        planar_view("plan/error", errors.box, "expected error after each action, by iteration"),
        rrb.TextDocumentView(origin="plan/words", name="actions"),
        column_shares=[CANVAS.width, CANVAS.width, 320],
        name=plan.title,
    )
    return Page(plan.title, f"plan {plan.title}", log, layout, ITERATION)


def _log_actions(node: Node, plan: PlanView) -> None:
    log_upright(node)
    log_lines(node / "outlines", Raster.of(plan.shape).outlines())
    log_hinges(node / "hinges", plan.shape)
    pixel = CANVAS.pixel(_around(plan))
    colors = (255 * action_colors(len(plan.actions))).astype(np.uint8)

    def log_stroke(place: Node, strips: list[np.ndarray], color: np.ndarray) -> None:
        place.log(rr.LineStrips2D(strips, colors=[color], radii=THICK, draw_order=30.0))

    for number, arrow in plan.arrows.items():
        place, color = node / number, colors[number - 1]
        tip = arrow.way[-1]
        back = tip - arrow.way[-2]
        back = back / np.linalg.norm(back) * 10 * pixel
        half_width = np.array([-back[1], back[0]]) / 2
        log_stroke(place / "way", [arrow.way, np.array([tip - back + half_width, tip, tip - back - half_width])], color)
        marks = [arrow.grasp] if arrow.pivot is None else [arrow.grasp, arrow.pivot]
        (place / "marks").log(rr.Points2D(marks, colors=[color], radii=rr.Radius.ui_points(4.0), draw_order=31.0))
        if arrow.pivot is not None:
            log_lines(place / "arm", [np.array(marks)])
    for number, point in plan.lifts.items():
        triangle = point + 8 * pixel * np.array([[-1.0, -0.7], [1.0, -0.7], [0.0, 1.0], [-1.0, -0.7]])
        log_stroke(node / f"{number}/lift", [triangle], colors[number - 1])
    for number, place in plan.number_places.items():
        log_texts(node / f"{number}/number", place[None], [str(number)], pixel)


def _around(plan: PlanView) -> Bbox:
    """Bounds around the object and all arrows."""
    return CANVAS.framed(Bbox(plan.bounds), 10, 10, 10)
