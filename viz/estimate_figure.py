"""One estimate on paper: maps of true mass, estimated mass and their difference, and bars with intervals."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from viz.cell_map import Scale
from viz.estimate_shown import LEVEL, EstimateShown, difference_scale_of, mass_scale_of
from viz.heatmap import draw_groups
from viz.style import DASHES, ESTIMATE, PALETTE, STYLE, TRUTH, bare, plain_numbers

MOST_NAMED = 30
"""More groups than this have no room for names or numbers."""
PANEL = 2.3
"""Width of a map, inches."""
LETTERS = (4.0, 7.0)
"""Least and usual size of a number in a cell, points."""


@mpl.rc_context(STYLE)
def estimate_maps(shown: EstimateShown) -> Figure:
    """The truth, the answer and their absolute difference, as in the Rerun view; the answer alone without a truth."""
    mass, off = mass_scale_of([shown]), difference_scale_of([shown])
    panels: list[tuple[str, np.ndarray | None, Scale]] = [("estimated mass", shown.mass, mass)]
    if shown.truth is not None:
        panels = [("true mass", shown.true_mass, mass), *panels, ("absolute difference", shown.difference, off)]
    width, height = np.ptp(shown.shape.particles, axis=0) + shown.shape.cell
    tall = float(np.clip(height / width, 0.2, 1.4))
    figure = Figure(figsize=(PANEL * len(panels), 2.1 * tall + 1.1), layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    for axis, (title, values, scale) in zip(axes, panels, strict=True):
        draw_groups(axis, shown.shape, values, Normalize(0.0, scale.top), scale.colors, digits=scale.digits)
        axis.set_title(title)
        size = min(LETTERS[1], _width(shown, 0.9 * PANEL) / (0.62 * max(len(t.get_text()) for t in axis.texts)))
        for text in axis.texts:
            text.set_fontsize(size)
            text.set_visible(shown.shape.n_m <= MOST_NAMED and size >= LETTERS[0])
    masses = [axis for axis, (*_, scale) in zip(axes, panels, strict=True) if scale is mass]
    _add_bar(figure, masses, mass)
    if shown.truth is not None:
        _add_bar(figure, [axes[-1]], off)
    figure.suptitle(shown.title, fontsize=9)
    return figure


@mpl.rc_context(STYLE)
def estimate_bars(shown: EstimateShown) -> Figure:
    """Mass of each group: the truth wide and grey, the answer before it, with its intervals where it has them."""
    names, places = shown.shape.group_names, np.arange(shown.shape.n_m)
    figure = Figure(figsize=(float(np.clip(0.42 * len(names) + 1.2, 3.4, 10.0)), 2.6), layout="constrained")
    axis = figure.subplots()
    if shown.true_mass is not None:
        axis.bar(places, shown.true_mass, 0.86, color=TRUTH, label="truth")
    if shown.mass is not None:
        half = shown.half_width
        label = "estimate" if half is None else f"estimate, {LEVEL} interval"
        look = {"elinewidth": 0.9, "capsize": 2.5}
        axis.bar(places, shown.mass, 0.55, color=ESTIMATE, yerr=half, error_kw=look, label=label)
    if len(names) <= MOST_NAMED:
        axis.set_xticks(places, names)
    axis.set_xlabel("group")
    axis.set_ylabel("mass, kg a group")
    axis.set_ylim(0.0, None)
    axis.set_title(shown.title, fontsize=9)
    if axis.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    bare(axis)
    return figure


@mpl.rc_context(STYLE)
def estimate_losses(shown: EstimateShown) -> Figure | None:
    """The loss of each run of an optimiser; None without any."""
    traces = [trace for trace in shown.traces if len(trace.loss)]
    if not traces:
        return None
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    axis = figure.subplots()
    for index, trace in enumerate(traces):
        loss = np.array(trace.loss, dtype=float)
        look = {"color": PALETTE[index % len(PALETTE)], "linestyle": DASHES[index % len(DASHES)], "linewidth": 1.4}
        axis.plot(np.arange(len(loss)), np.where(loss > 0, loss, np.nan), label=trace.method, **look)
    axis.set_yscale("log")
    plain_numbers(axis.yaxis)
    axis.set_xlabel("iteration")
    axis.set_ylabel("loss")
    axis.set_title(shown.title, fontsize=9)
    axis.legend(fontsize=8, frameon=False, handlelength=3)
    bare(axis)
    return figure


def _width(shown: EstimateShown, across: float) -> float:
    """Of the narrowest group, points, where the object is `across` inches wide."""
    shape = shown.shape
    x = [shape.particles[shape.mass_group == group, 0] for group in range(shape.n_m)]
    whole = float(np.ptp(shape.particles[:, 0])) + shape.cell
    return 72 * across * (shape.cell + min(float(np.ptp(each)) for each in x)) / whole


def _add_bar(figure: Figure, axes: list[Axes], scale: Scale) -> None:
    colors = ScalarMappable(Normalize(0.0, scale.top), scale.colors)
    bar = figure.colorbar(
        colors, ax=axes, ticks=MaxNLocator(4), orientation="horizontal", shrink=0.85, aspect=16 * len(axes), pad=0.04
    )
    bar.set_label(scale.title)
