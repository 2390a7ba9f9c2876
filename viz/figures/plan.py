"""What is shown of a plan of touches: where each grasps and turns, and how sure each mass is after it."""

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

from testbed.actions.base import Accelerate, Action, Lift, Rotate, Slide, pivot_of
from testbed.objects.model import ObjectShape
from viz.figures.maps import draw_groups
from viz.style import DIFFERENCE_COLORS, STYLE

SHOWN_ARC, SHOWN_WAY = math.radians(70), 0.05
"""Most of a turn that its arrow covers, however far the turn goes: rad, and m along the way."""
IN_PLACE, PLACE_RADIUS = 0.008, 0.012
"""A turn about a point nearer to its grasp than this is drawn as one in place, so wide, m."""


@dataclass(frozen=True, eq=False)
class TouchShown:
    """One touch on the object, object frame."""

    grasp: Float[np.ndarray, "2"]
    """m."""
    about: Float[np.ndarray, "2"] | None
    """Centre of the turn, m; None for a slide."""
    way: Float[np.ndarray, "N 2"]
    """Line of the arrow, m; it ends at its head."""
    accelerated: bool

    @staticmethod
    def of(shape: ObjectShape, action: Rotate | Accelerate | Slide) -> TouchShown:
        """The first part of its way."""
        grasp = shape.grasps[action.grasp].position
        if isinstance(action, Slide):
            along = np.array([math.cos(action.direction), math.sin(action.direction)])
            return TouchShown(grasp, None, grasp + SHOWN_WAY * np.outer([0.0, 1.0], along), accelerated=False)
        pivot, accelerated = pivot_of(action, shape), isinstance(action, Accelerate)
        speed = action.start_speed if isinstance(action, Accelerate) else action.speed
        arm = grasp - pivot
        radius, begin = float(np.linalg.norm(arm)), math.atan2(arm[1], arm[0])
        if radius < IN_PLACE:
            radius, begin = PLACE_RADIUS, 0.0
        angle = begin + math.copysign(min(SHOWN_ARC, SHOWN_WAY / radius), speed) * np.linspace(0.0, 1.0, 12)
        way = pivot + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        return TouchShown(grasp, pivot, way, accelerated)

    @property
    def label(self) -> Float[np.ndarray, "2"]:
        """Where its number goes, m."""
        return self.way[-1] if self.about is None else self.about

    @property
    def points(self) -> Float[np.ndarray, "N 2"]:
        """All that it takes up, m."""
        return np.vstack([self.way, self.grasp, self.label])


@dataclass(frozen=True, eq=False)
class PlanShown:
    """A plan of T touches."""

    shape: ObjectShape
    actions: tuple[Action, ...]
    errors: Float[np.ndarray, "T+1 n_m"]
    """Standard error of each group's mass that is expected, kg: after the weighing, then after each touch."""
    weight: float
    """M, kg."""
    title: str
    words: tuple[str, ...] = ()
    """Each touch in words."""

    @property
    def touches(self) -> dict[int, TouchShown]:
        """Those that move the object over the table, by their number from 1."""
        numbered = enumerate(self.actions, start=1)
        return {n: TouchShown.of(self.shape, a) for n, a in numbered if isinstance(a, Rotate | Accelerate | Slide)}

    @property
    def lifts(self) -> dict[int, Float[np.ndarray, "2"]]:
        """Where those hold it that lift it, m, by their number from 1."""
        numbered = enumerate(self.actions, start=1)
        return {n: self.shape.grasps[a.grasp].position for n, a in numbered if isinstance(a, Lift)}


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
