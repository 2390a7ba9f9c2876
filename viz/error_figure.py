"""Where an object's mass would be known, and where not: the expected error of every group, in its place."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from testbed.objects import ObjectModel
from viz.heatmap import draw_groups
from viz.style import DIFFERENCE_COLORS, NO_ANSWER, STYLE

WIDTH = 3.4
"""Of the figure, inches."""
MOST_NAMED = 30
"""More groups than this have no room for numbers."""


@mpl.rc_context(STYLE)
def error_figure(model: ObjectModel, standard_error: Float[np.ndarray, "n_m"], title: str) -> Figure:
    """Expected standard error of each group, in parts of a hundred of the mean group's mass; hatched where not seen.

    Args:
        model: the object.
        standard_error: of every group, kg; infinite where it is not seen.
        title: which trials, and how they are felt.
    """
    shape = model.shape
    error = 100 * standard_error / (model.total_mass / shape.n_m)
    seen = np.isfinite(error)
    top = max(float(error[seen].max()), 0.1) if seen.any() else 1.0
    width, height = np.ptp(shape.particles, axis=0) + shape.cell
    figure = Figure(figsize=(WIDTH, WIDTH * float(np.clip(height / width, 0.2, 1.4)) * 0.8 + 1.2), layout="constrained")
    axis = figure.subplots()
    draw_groups(axis, shape, np.where(seen, error, 0.0), Normalize(0.0, top), digits=1 if top >= 1 else 2)
    half, blind = shape.cell / 2, ~seen[shape.mass_group]
    cells = [Rectangle((x - half, y - half), shape.cell, shape.cell) for x, y in shape.particles[blind]]
    if cells:
        axis.add_collection(PatchCollection(cells, facecolor=NO_ANSWER, edgecolor="white", hatch="////", linewidth=0))
    for group, text in enumerate(axis.texts):
        text.set_fontsize(7)
        text.set_visible(shape.n_m <= MOST_NAMED)
        if not seen[group]:
            text.set_text("not seen" if shape.n_m <= MOST_NAMED // 2 else "-")
            text.set(color="black", zorder=5, fontsize=5)
    axis.set_title(title, fontsize=9)
    if not seen.any():
        return figure
    colors = ScalarMappable(Normalize(0.0, top), DIFFERENCE_COLORS)
    bar = figure.colorbar(colors, ax=axis, orientation="horizontal", shrink=0.85, aspect=18, pad=0.04)
    bar.set_label("standard error, % of the mean group's mass")
    return figure
