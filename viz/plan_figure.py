"""A plan of touches on the object: what is turned about where, and how sure each mass is before and after."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from viz.heatmap import draw_groups
from viz.plan_shown import PlanShown, TouchShown
from viz.style import DIFFERENCE_COLORS, STYLE

WIDTH = 7.0
"""Of the figure, inches."""
GREY = 0.15
"""Of the cells under the arrows, 0 to 1."""


@mpl.rc_context(STYLE)
def plan_figure(shown: PlanShown) -> Figure:
    """The object with grasps, pivots and arrows, and its expected errors before and after, each on its own scale."""
    width, height = np.ptp(shown.shape.particles, axis=0) + shown.shape.cell
    tall = WIDTH / 3 * float(np.clip(height / width, 0.4, 1.6)) + 1.2
    figure = Figure(figsize=(WIDTH, tall), layout="constrained")
    where, before, after = figure.subplots(1, 3)
    _draw_actions(where, shown)
    per_group = shown.weight / shown.shape.n_m
    for axis, error, title in (
        (before, shown.errors[0], "before: weighed"),
        (after, shown.errors[-1], "after the plan"),
    ):
        part = 100 * error / per_group
        norm = Normalize(0.0, max(float(part.max()), 1e-3))
        draw_groups(axis, shown.shape, part, norm, digits=1 if part.max() >= 1 else 2)
        axis.set_title(title, fontsize=8)
        bar = figure.colorbar(
            ScalarMappable(norm, DIFFERENCE_COLORS), ax=axis, orientation="horizontal", shrink=0.85, pad=0.04
        )
        bar.set_label("expected error, % of the mean group", fontsize=7)
    figure.suptitle(shown.title, fontsize=9)
    return figure


def _draw_actions(axis: Axes, shown: PlanShown) -> None:
    """Cells in grey; numbered from 1: a dot at each pivot, a thin line to the grasp, an arrow the way it turns.

    A lift is a triangle at its grasp.
    """
    shape = shown.shape
    draw_groups(axis, shape, np.full(shape.n_m, GREY), Normalize(0.0, 1.0), colors="Greys")
    for text in list(axis.texts):
        text.remove()
    colors = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, max(len(shown.actions), 1)))
    for number, touch in shown.touches.items():
        _draw_action(axis, number, touch, colors[number - 1])
    for number, point in shown.lifts.items():
        axis.plot(*point, marker="^", color=colors[number - 1], markersize=6, markerfacecolor="none")
        _write_number(axis, number, point, colors[number - 1], (-9, -9))
    points = np.concatenate([shape.particles, *(touch.points for touch in shown.touches.values())])
    low, high = points.min(axis=0) - shape.cell, points.max(axis=0) + shape.cell
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_title("what is turned about where", fontsize=8)


def _draw_action(axis: Axes, number: int, touch: TouchShown, color: np.ndarray) -> None:
    """One touch, numbered."""
    axis.plot(*touch.way.T, color=color, linewidth=1.2)
    ends = tuple(touch.way[-2]), tuple(touch.way[-1])
    axis.add_patch(FancyArrowPatch(*ends, color=color, arrowstyle="->", mutation_scale=7))
    if touch.about is not None:
        axis.plot(*np.array([touch.grasp, touch.about]).T, color=color, linewidth=0.5, linestyle=":")
        axis.plot(*touch.about, marker="x" if touch.accelerated else "o", color=color, markersize=4)
    axis.plot(*touch.grasp, marker="s", color=color, markersize=3, markerfacecolor="none")
    _write_number(axis, number, touch.label, color)


def _write_number(
    axis: Axes, number: int, place: np.ndarray, color: np.ndarray, beside: tuple[float, float] = (3, 3)
) -> None:
    axis.annotate(str(number), tuple(place), xytext=beside, textcoords="offset points", fontsize=6, color=color)
