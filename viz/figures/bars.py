"""Mass bars: each group's mass, true and estimated, with its interval."""

from __future__ import annotations

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from viz.style import ESTIMATE, MOST_NAMED, STYLE, TRUTH, bare
from viz.values import LEVEL, EstimateView


@mpl.rc_context(STYLE)
def estimate_bars(view: EstimateView) -> Figure:
    """Mass of each group: the truth wide and gray, the estimate in front, with intervals if it has a covariance."""
    names, places = view.shape.group_names, np.arange(view.shape.n_m)
    figure = Figure(figsize=(float(np.clip(0.42 * len(names) + 1.2, 3.4, 10.0)), 2.6), layout="constrained")
    axis = figure.subplots()
    if view.true_mass is not None:
        axis.bar(places, view.true_mass, 0.86, color=TRUTH, label="truth")
    if view.mass is not None:
        half = view.half_width
        label = "estimate" if half is None else f"estimate, {LEVEL} interval"
        look = {"elinewidth": 0.9, "capsize": 2.5}
        axis.bar(places, view.mass, 0.55, color=ESTIMATE, yerr=half, error_kw=look, label=label)
    if len(names) <= MOST_NAMED:
        axis.set_xticks(places, names)
    axis.set_xlabel("group")
    axis.set_ylabel("mass, kg per group")
    axis.set_ylim(0.0, None)
    axis.set_title(view.title, fontsize=9)
    if axis.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=2, fontsize=8, frameon=False)
    bare(axis)
    return figure
