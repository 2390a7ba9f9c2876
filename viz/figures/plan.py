"""Plan of actions: grasps, pivots and arrows on the object, and the expected errors before and after."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from viz.figures.maps import add_bar, draw_groups
from viz.style import DIFFERENCE_COLORS, STYLE, Scale, action_colors, aspect
from viz.values import ActionArrow, PlanView

WIDTH = 7.0
"""Width of the figure [inches]."""
GREY = 0.15
"""Grey level of the cells under the arrows, 0 to 1."""


@mpl.rc_context(STYLE)
def plan_figure(plan: PlanView) -> Figure:
    """Object with grasps, pivots and arrows, and its expected errors before and after, each on its own scale."""
    tall = WIDTH / 3 * aspect(plan.shape, 0.4, 1.6) + 1.2
    figure = Figure(figsize=(WIDTH, tall), layout="constrained")
    where, before, after = figure.subplots(1, 3)
    _draw_actions(where, plan)
    for axis, error, title in (
        (before, plan.percent[0], "before: weighed"),
        (after, plan.percent[-1], "after the plan"),
    ):
        scale = Scale(max(float(error.max()), 1e-3), DIFFERENCE_COLORS, "expected error, % of the mean group")
        draw_groups(axis, plan.shape, error, scale, digits=1 if error.max() >= 1 else 2)
        axis.set_title(title, fontsize=8)
        add_bar(figure, axis, scale, fontsize=7)
    figure.suptitle(plan.title, fontsize=9)
    return figure


def _draw_actions(axis: Axes, plan: PlanView) -> None:
    """Draw cells in grey, and the actions numbered from 1; a lift is a triangle at its grasp."""
    draw_groups(axis, plan.shape, np.full(plan.shape.n_m, GREY), Scale(1.0, "Greys", ""), letters=0.0)
    colors = action_colors(len(plan.actions))
    for number, arrow in plan.arrows.items():
        _draw_arrow(axis, number, arrow, colors[number - 1])
    for number, point in plan.lifts.items():
        axis.plot(*point, marker="^", color=colors[number - 1], markersize=6, markerfacecolor="none")
        _write_number(axis, number, point, colors[number - 1], (-9, -9))
    low, high = plan.bounds
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_title("what is turned about where", fontsize=8)


def _draw_arrow(axis: Axes, number: int, arrow: ActionArrow, color: np.ndarray) -> None:
    """Draw a mark at the pivot, a thin line from it to the grasp, and an arrow along the motion."""
    axis.plot(*arrow.way.T, color=color, linewidth=1.2)
    ends = tuple(arrow.way[-2]), tuple(arrow.way[-1])
    axis.add_patch(FancyArrowPatch(*ends, color=color, arrowstyle="->", mutation_scale=7))
    if arrow.pivot is not None:
        axis.plot(*np.array([arrow.grasp, arrow.pivot]).T, color=color, linewidth=0.5, linestyle=":")
        axis.plot(*arrow.pivot, marker="x" if arrow.accelerated else "o", color=color, markersize=4)
    axis.plot(*arrow.grasp, marker="s", color=color, markersize=3, markerfacecolor="none")
    _write_number(axis, number, arrow.label, color)


def _write_number(
    axis: Axes, number: int, place: np.ndarray, color: np.ndarray, beside: tuple[float, float] = (3, 3)
) -> None:
    axis.annotate(str(number), tuple(place), xytext=beside, textcoords="offset points", fontsize=6, color=color)
