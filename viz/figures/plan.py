"""Plan of actions: grasps, pivots and arrows on the object, and the expected errors before and after."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch
from matplotlib.ticker import MaxNLocator

from testbed.actions.push import Push
from viz.figures.maps import add_bar, decimals, draw_groups
from viz.style import DIFFERENCE_COLORS, PLAN_ERROR, STYLE, Scale, action_colors
from viz.values import ActionArrow, PlanView

WIDTH, LONG = 7.0, 4.6
"""Width of the figure [inches]: of three panels side by side, and of three below each other."""
LONG_FROM = 1.8
"""Width over height from which the panels stand below each other."""
HEAD, FOOT = 0.3, 0.95
"""Room for a panel's title, and for the figure's title with the colour bar [inches]."""
GREY = 0.15
"""Grey level of the cells under the arrows, 0 to 1."""


@mpl.rc_context(STYLE)
def plan_figure(plan: PlanView) -> Figure:
    """Object with grasps, pivots and arrows, and its expected errors before and after.

    The object has one size in all panels. The errors have one scale, up to the largest after the plan.
    """
    low, high = plan.bounds
    wide, tall = high - low
    long, plain = wide > LONG_FROM * tall, float(np.ptp(plan.shape.particles[:, 1])) + 2 * plan.shape.cell
    if long:
        inches = LONG / wide * np.array([tall, plain, plain])
        figure = Figure(figsize=(LONG, inches.sum() + 3 * HEAD + FOOT), layout="constrained")
        axes = figure.subplots(3, 1, height_ratios=inches)
    else:
        figure = Figure(figsize=(WIDTH, WIDTH / 3 * tall / wide + HEAD + FOOT), layout="constrained")
        axes = figure.subplots(1, 3)
    top = max(float(plan.grams[-1].max()), 1e-3)
    above = bool(plan.grams[0].max() > top)
    scale = Scale(top, DIFFERENCE_COLORS, PLAN_ERROR, open=above)
    _draw_actions(axes[0], plan)
    for axis, error, title in (
        (axes[1], plan.grams[0], "errors expected after the weighing"),
        (axes[2], plan.grams[-1], "errors expected after the plan"),
    ):
        draw_groups(axis, plan.shape, error, scale, digits=decimals(float(error.max())), letters=7.0)
        axis.set_title(title, fontsize=8)
    for axis in axes:
        axis.set_xlim(low[0], high[0])
    for axis in axes[: 1 if long else 3]:
        axis.set_ylim(low[1], high[1])
    look = {"extend": "max" if above else "neither", "aspect": 30, "ticks": MaxNLocator(4), "fontsize": 8}
    add_bar(figure, axes.tolist(), scale, shrink=0.6, **look)
    figure.suptitle(plan.title, fontsize=9)
    return figure


def _draw_actions(axis: Axes, plan: PlanView) -> None:
    """Draw cells in grey, and the actions numbered from 1; a lift is a triangle at its grasp."""
    draw_groups(axis, plan.shape, np.full(plan.shape.n_m, GREY), Scale(1.0, "Greys", ""), letters=0.0)
    colors = action_colors(len(plan.actions))
    for number, arrow in plan.arrows.items():
        _draw_arrow(axis, arrow, colors[number - 1])
    for number, point in plan.lifts.items():
        axis.plot(*point, marker="^", color=colors[number - 1], markersize=6, markerfacecolor="none")
    for number, (x, y) in plan.number_places.items():
        axis.text(x, y, str(number), ha="center", va="center", fontsize=7)
    held = sorted({"push" if isinstance(a, Push) else "grasp" for a in plan.actions if a.on_table})
    marks = [f"{' or '.join(held)} \u25a1"] if held else []
    marks += ["pivot \u25cf"] if any(a.pivot is not None for a in plan.arrows.values()) else []
    marks += ["lift \u25b3"] if plan.lifts else []
    axis.set_title(f"actions in order: {', '.join(marks)}", fontsize=8)


def _draw_arrow(axis: Axes, arrow: ActionArrow, color: np.ndarray) -> None:
    """Draw a mark at the pivot, a thin line from it to the grasp, and an arrow along the motion."""
    axis.plot(*arrow.way.T, color=color, linewidth=1.2)
    ends = tuple(arrow.way[-2]), tuple(arrow.way[-1])
    axis.add_patch(FancyArrowPatch(*ends, color=color, arrowstyle="->", mutation_scale=7))
    if arrow.pivot is not None:
        axis.plot(*np.array([arrow.grasp, arrow.pivot]).T, color=color, linewidth=0.5, linestyle=":")
        axis.plot(*arrow.pivot, marker="x" if arrow.accelerated else "o", color=color, markersize=4)
    axis.plot(*arrow.grasp, marker="s", color=color, markersize=3, markerfacecolor="none")
