"""Plan of actions: grasps, pivots and arrows on the object, and the expected errors before and after the plan."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from viz.figures.actions import draw_actions
from viz.figures.maps import add_bar, decimals, draw_groups
from viz.style import DIFFERENCE_COLORS, PLAN_ERROR, STYLE, Scale
from viz.values import PlanView

WIDTH, LONG = 7.0, 4.6
"""Width of the figure [inches]: of three panels in a row, and of three in a column."""
LONG_FROM = 1.8
"""Width over height above which the panels are in a column."""
HEAD, FOOT = 0.3, 0.95
"""Height of a panel's title, and of the figure's title and color bar together [inches]."""


@mpl.rc_context(STYLE)
def plan_figure(plan: PlanView) -> Figure:
    """Object with grasps, pivots and arrows, and its expected errors before and after the plan.

    All panels have the same scale of length. The errors have one color scale, up to the largest after the plan.
    """
    low, high = plan.bounds
    wide, tall = high - low
    long, alone = wide > LONG_FROM * tall, float(np.ptp(plan.shape.particles[:, 1])) + 2 * plan.shape.cell
    if long:
        inches = LONG / wide * np.array([tall, alone, alone])
        figure = Figure(figsize=(LONG, inches.sum() + 3 * HEAD + FOOT), layout="constrained")
        axes = figure.subplots(3, 1, height_ratios=inches)
    else:
        figure = Figure(figsize=(WIDTH, WIDTH / 3 * tall / wide + HEAD + FOOT), layout="constrained")
        axes = figure.subplots(1, 3)
    top = max(float(plan.grams[-1].max()), 1e-3)
    above = bool(plan.grams[0].max() > top)
    scale = Scale(top, DIFFERENCE_COLORS, PLAN_ERROR, open=above)
    draw_actions(axes[0], plan)
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
