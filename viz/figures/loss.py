"""How the loss of an iterative method falls: each optimiser's median and band over estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from viz.style import DASHES, PALETTE, STYLE, bare, plain_numbers


@mpl.rc_context(STYLE)
def loss_figure(traces: Mapping[str, Sequence[np.ndarray]]) -> Figure:
    """One method.

    Args:
        traces: losses at each iteration, (I,) an estimate, by optimiser.
    """
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    axis = figure.subplots()
    for index, (optimizer, losses) in enumerate(sorted(traces.items())):
        table = normalised(losses)
        if table.size == 0:
            continue
        at = _shown(table.shape[1])
        low, middle, high = np.nanquantile(table[:, at], (0.1, 0.5, 0.9), axis=0)
        color = PALETTE[index % len(PALETTE)]
        axis.fill_between(at + 1, low, high, color=color, alpha=0.15, linewidth=0)
        dash = DASHES[index % len(DASHES)]
        axis.plot(at + 1, middle, color=color, linestyle=dash, linewidth=1.6, label=optimizer.replace("_", " "))
    axis.set_xscale("log")
    axis.set_yscale("log")
    for each in (axis.xaxis, axis.yaxis):
        plain_numbers(each)
    axis.set_xlabel("iteration")
    axis.set_ylabel("loss over first loss")
    bare(axis)
    if axis.get_legend_handles_labels()[0]:
        axis.legend(fontsize=8, frameon=False, handlelength=3, loc="lower left")
    return figure


def normalised(losses: Sequence[np.ndarray]) -> np.ndarray:
    """Losses over the first of each, (N, I); shorter ones end in NaN, and what has no first loss is left out."""
    good = [loss / loss[0] for loss in losses if len(loss) and np.isfinite(loss[0]) and loss[0] > 0]
    table = np.full((len(good), max((len(loss) for loss in good), default=0)), np.nan)
    for row, loss in zip(table, good, strict=True):
        row[: len(loss)] = np.where(loss > 0, loss, np.nan)
    return table[:, ~np.isnan(table).all(axis=0)]


def _shown(count: int) -> np.ndarray:
    """Iterations that are drawn: evenly spread on a logarithmic axis."""
    return np.unique(np.geomspace(1, count, 90).astype(int)) - 1
