"""Objects from above, in their poses on the table: parts, points of contact, and grasps."""

from __future__ import annotations

import math
from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure
from matplotlib.patches import Polygon

from testbed.frames import rotation_2d
from testbed.objects.colors import group_color
from testbed.objects.model import FINGER_DEPTH, PAD_WIDTH, ObjectModel
from viz.figures.maps import draw_hinges
from viz.style import BLACK, STYLE, VERMILLION

COLUMNS = 3
"""Largest number of objects side by side."""
WIDTH = 3.2
"""Width of an object's picture [inches]."""


@mpl.rc_context(STYLE)
def object_page(models: Sequence[ObjectModel]) -> Figure:
    """Objects on one page, each scaled to its panel, with a scale bar of 50 mm.

    Args:
        models: objects of solids or of cells.
    """
    columns = min(COLUMNS, len(models))
    rows = math.ceil(len(models) / columns)
    figure = Figure(figsize=(WIDTH * columns, 2.3 * rows + 0.3), layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False).ravel()
    for axis, model in zip(axes, models, strict=False):
        draw_object(axis, model)
    for axis in axes[len(models) :]:
        axis.set_axis_off()
    rings = "; rings: hinges" if any(model.shape.chain is not None for model in models) else ""
    legend = (f"colors: parts; black dots: points of contact{rings}", "cross: center of mass; red: pads")
    figure.supxlabel(("; " if columns > 1 else "\n").join(legend), fontsize=7)
    return figure


def draw_object(axis: Axes, model: ObjectModel) -> None:
    """Draw an object from above, in its frame: parts shaded by slope, contacts, the center of mass, and the pads."""
    shape = model.shape
    corners, colors, heights = [], [], []
    for group, solid in enumerate(model.solids):
        triangles = solid.vertices[solid.faces]
        normal = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
        up = normal[:, 2] > 0
        slope = normal[up, 2] / np.linalg.norm(normal[up], axis=1)
        corners.append(triangles[up, :, :2])
        heights.append(triangles[up, :, 2].max(axis=1))
        light = 0.45 + 0.4 * slope[:, None]
        colors.append(light * np.array(to_rgb(group_color(group))) + (1 - light) * np.minimum(slope[:, None] + 0.3, 1))
    if corners:
        order = np.argsort(np.concatenate(heights), kind="stable")
        looks = {"facecolors": np.concatenate(colors)[order], "edgecolors": "face", "linewidth": 0.2}
        faces = PolyCollection(list(np.concatenate(corners)[order]), **looks)
        faces.set_rasterized(True)
        axis.add_collection(faces)
    else:
        cells = shape.particles[shape.cells, None] + shape.cell / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
        colors = [group_color(int(group)) for group in shape.mass_group[shape.cells]]
        axis.add_collection(PolyCollection(list(cells), facecolors=colors))
    touching = shape.particles[shape.friction_group >= 0]
    if shape.is_contact.any() and not shape.stands_on_feet:
        axis.add_patch(Polygon(touching, fill=False, edgecolor=BLACK, linestyle="--", linewidth=0.7))
    axis.plot(*touching.T, "o", color=BLACK, markersize=3.5 if shape.is_contact.any() else 1.0, linestyle="none")
    if shape.chain is not None:
        draw_hinges(axis, shape.chain, axis.transData)
    if model.masses_known:
        axis.plot(*model.center_of_mass, "x", color=BLACK, markersize=6, markeredgewidth=1.4)
    for index, grasp in enumerate(shape.grasps):
        turn = rotation_2d(grasp.angle)
        for side in (-1, 1):
            pad = np.array([[0, -1], [1, -1], [1, 1], [0, 1]]) * [side * FINGER_DEPTH, PAD_WIDTH / 2]
            pad[:, 0] += side * grasp.width / 2
            axis.add_patch(
                Polygon(grasp.position + pad @ turn.T, facecolor=VERMILLION, alpha=0.55, edgecolor="none", zorder=3)
            )
        at = grasp.position + turn[:, 0] * (grasp.width / 2 + 1.8 * FINGER_DEPTH)
        axis.text(at[0], at[1], str(index + 1), color=VERMILLION, fontsize=6, ha="center", va="center", zorder=4)
    low, high = shape.particles.min(axis=0) - 0.024, shape.particles.max(axis=0) + 0.024
    axis.plot([low[0], low[0] + 0.05], [low[1], low[1]], color=BLACK, linewidth=1.5, solid_capstyle="butt")
    axis.set(xlim=(low[0], high[0]), ylim=(low[1] - 0.004, high[1]), aspect="equal")
    axis.set_axis_off()
    mass = f", {model.total_mass:.3g} kg" if model.masses_known else ""
    count = len(shape.grasps)
    axis.set_title(
        f"{model.name}{mass}\n{shape.n_m} parts, {len(touching)} "
        f"{'points' if shape.is_contact.any() else 'cells'} of contact, {count} grasp{'s' * (count != 1)}",
        fontsize=7,
    )
