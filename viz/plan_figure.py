"""A plan of touches on the object: what is turned about where, and how sure each mass is before and after."""

from __future__ import annotations

import math
from dataclasses import dataclass

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import FancyArrowPatch

from testbed.actions import Accelerate, Action, Rotate, Slide, pivot_of
from testbed.objects import ObjectShape
from viz.heatmap import draw_groups
from viz.style import DIFFERENCE_COLORS, STYLE

WIDTH = 7.0
"""Of the figure, inches."""
GREY = 0.15
"""Of the cells under the arrows, 0 to 1."""
SHOWN_ARC = math.radians(70)
"""Of a turn's arrow, however far the turn goes."""


@dataclass(frozen=True, eq=False)
class PlanShown:
    """What is drawn of a plan."""

    shape: ObjectShape
    actions: tuple[Action, ...]
    before: Float[np.ndarray, "n_m"]
    """Standard error of each group after the weighing, kg."""
    after: Float[np.ndarray, "n_m"]
    """And after the last action, kg."""
    weight: float
    """M, kg."""
    title: str


@mpl.rc_context(STYLE)
def plan_figure(shown: PlanShown) -> Figure:
    """The object with grasps, pivots and arrows, and its expected errors before and after, each on its own scale."""
    width, height = np.ptp(shown.shape.particles, axis=0) + shown.shape.cell
    tall = WIDTH / 3 * float(np.clip(height / width, 0.4, 1.6)) + 1.2
    figure = Figure(figsize=(WIDTH, tall), layout="constrained")
    where, before, after = figure.subplots(1, 3)
    _draw_actions(where, shown)
    per_group = shown.weight / shown.shape.n_m
    for axis, error, title in ((before, shown.before, "before: weighed"), (after, shown.after, "after the plan")):
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
    """Cells in grey; numbered from 1: a dot at each pivot, a thin line to the grasp, an arrow the way it turns."""
    shape = shown.shape
    draw_groups(axis, shape, np.full(shape.n_m, GREY), Normalize(0.0, 1.0), colors="Greys")
    for text in list(axis.texts):
        text.remove()
    colors = mpl.colormaps["viridis"](np.linspace(0.0, 0.85, max(len(shown.actions), 1)))
    reach = [shape.particles]
    for number, (action, color) in enumerate(zip(shown.actions, colors, strict=True), start=1):
        if isinstance(action, Rotate | Accelerate | Slide):
            reach += [_draw_action(axis, shape, number, action, color)]
    points = np.concatenate(reach)
    low, high = points.min(axis=0) - shape.cell, points.max(axis=0) + shape.cell
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_title("what is turned about where", fontsize=8)


def _draw_action(
    axis: Axes, shape: ObjectShape, number: int, action: Rotate | Accelerate | Slide, color: np.ndarray
) -> Float[np.ndarray, "N 2"]:
    """One action; the points that it takes up."""
    grasp = shape.grasps[action.grasp].position
    if isinstance(action, Slide):
        end = grasp + 0.03 * np.array([math.cos(action.direction), math.sin(action.direction)])
        axis.add_patch(FancyArrowPatch(tuple(grasp), tuple(end), color=color, arrowstyle="->", mutation_scale=7))
        label, points = end, np.array([grasp, end])
    else:
        pivot = pivot_of(action, shape)
        speed = action.start_speed if isinstance(action, Accelerate) else action.speed
        arm = grasp - pivot
        radius = float(np.linalg.norm(arm))
        small = radius < 0.008
        radius, begin = (0.012, 0.0) if small else (radius, math.atan2(arm[1], arm[0]))
        angles = begin + math.copysign(1.0, speed) * np.linspace(0.0, min(SHOWN_ARC, 0.05 / radius), 12)
        arc = pivot + radius * np.column_stack([np.cos(angles), np.sin(angles)])
        axis.plot(*arc.T, color=color, linewidth=1.2)
        head = FancyArrowPatch(tuple(arc[-2]), tuple(arc[-1]), color=color, arrowstyle="->", mutation_scale=7)
        axis.add_patch(head)
        if not small:
            axis.plot([grasp[0], pivot[0]], [grasp[1], pivot[1]], color=color, linewidth=0.5, linestyle=":")
        axis.plot(*pivot, marker="x" if isinstance(action, Accelerate) else "o", color=color, markersize=4)
        label, points = pivot, np.vstack([arc, pivot, grasp])
    axis.plot(*grasp, marker="s", color=color, markersize=3, markerfacecolor="none")
    axis.annotate(str(number), tuple(label), xytext=(3, 3), textcoords="offset points", fontsize=6, color=color)
    return points
