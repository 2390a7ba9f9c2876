"""Actions on an object, from above: grasps, pivots, contact points and arrows, numbered in order."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.patches import FancyArrowPatch

from testbed.objects.model import ObjectShape
from viz.figures.maps import draw_groups
from viz.style import LINK_COLORS, MOST_LINK_COLORS, Scale, action_colors
from viz.values import ActionArrow, ActionsView

GREY = 0.15
"""Gray level of the cells under the arrows, 0 (white) to 1."""


def draw_actions(axis: Axes, view: ActionsView, paths: Mapping[int, Float[np.ndarray, "W 2"]] | None = None) -> None:
    """Draw the object and the actions on it, numbered from 1; a lift is a triangle at its grasp.

    Args:
        axis: matplotlib's axes.
        view: the actions.
        paths: paths of contact points on the outline [m], object frame, by the action's number.
    """
    _draw_links(axis, view.shape)
    colors = action_colors(len(view.actions))
    for number, arrow in view.arrows.items():
        _draw_arrow(axis, arrow, colors[number - 1])
    for number, path in (paths or {}).items():
        look = {"color": colors[number - 1], "solid_capstyle": "round", "zorder": 3}
        axis.plot(*path.T, linewidth=3.0, gid=f"contact_path_{number}", **look)
    for number, point in view.lifts.items():
        axis.plot(*point, marker="^", color=colors[number - 1], markersize=6, markerfacecolor="none")
    for number, (x, y) in view.number_places.items():
        axis.text(x, y, str(number), ha="center", va="center", fontsize=7)
    held = sorted({"push" if a.pushes else "grasp" for a in view.actions if a.on_table})
    marks = [f"{' or '.join(held)} \u25a1"] if held else []
    marks += ["pivot \u25cf"] if any(a.pivot is not None for a in view.arrows.values()) else []
    marks += ["lift \u25b3"] if view.lifts else []
    marks += ["contact slid \u2501"] if paths else []
    marks += ["hinge \u25ce"] if view.shape.chain is not None else []
    axis.set_title(f"actions in order: {', '.join(marks)}", fontsize=8)


def _draw_links(axis: Axes, shape: ObjectShape) -> None:
    """Draw the cells in gray; for an object in links, each link in its color, with the hinges."""
    if shape.chain is None:
        draw_groups(axis, shape, np.full(shape.n_m, GREY), Scale(1.0, "Greys", ""), letters=0.0)
    else:
        scale = Scale(MOST_LINK_COLORS, LINK_COLORS, "")
        draw_groups(axis, shape, shape.chain.link + 0.5, scale, letters=0.0)
        for hinge, place in enumerate(shape.chain.hinges):
            look = {"xytext": (0, 4), "textcoords": "offset points", "ha": "center", "fontsize": 6}
            axis.annotate(f"hinge {hinge}", place, **look)


def _draw_arrow(axis: Axes, arrow: ActionArrow, color: np.ndarray) -> None:
    """Draw a mark at the pivot, a thin line from it to the grasp, and an arrow along the motion."""
    axis.plot(*arrow.way.T, color=color, linewidth=1.2)
    ends = tuple(arrow.way[-2]), tuple(arrow.way[-1])
    axis.add_patch(FancyArrowPatch(*ends, color=color, arrowstyle="->", mutation_scale=7))
    if arrow.pivot is not None:
        axis.plot(*np.array([arrow.grasp, arrow.pivot]).T, color=color, linewidth=0.5, linestyle=":")
        axis.plot(*arrow.pivot, marker="x" if arrow.accelerated else "o", color=color, markersize=4)
    axis.plot(*arrow.grasp, marker="s", color=color, markersize=3, markerfacecolor="none")
