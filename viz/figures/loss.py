"""Loss by iteration: of one estimate, and of each optimiser over many estimates."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from viz.style import DASHES, PALETTE, STYLE, bare, plain_numbers
from viz.values import EstimateView


@mpl.rc_context(STYLE)
def loss_figure(traces: Mapping[str, Sequence[np.ndarray]]) -> Figure:
    """Losses of one method relative to the first: median and 10th to 90th percentile of each optimiser.

    Args:
        traces: losses of every estimate by iteration, (I,) each, by optimiser.
    """
    figure, axis = _panel()
    for index, (optimizer, losses) in enumerate(sorted(traces.items())):
        table = normalised(losses)
        if table.size == 0:
            continue
        at = np.unique(np.geomspace(1, table.shape[1], 90).astype(int)) - 1  # evenly spread on a logarithmic axis
        low, middle, high = np.nanquantile(table[:, at], (0.1, 0.5, 0.9), axis=0)
        look = _look(index)
        axis.fill_between(at + 1, low, high, color=look["color"], alpha=0.15, linewidth=0)
        axis.plot(at + 1, middle, linewidth=1.6, label=optimizer.replace("_", " "), **look)
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


@mpl.rc_context(STYLE)
def estimate_losses(view: EstimateView) -> Figure | None:
    """Loss of each run of an estimate's optimiser; None without losses."""
    traces = [trace for trace in view.traces if len(trace.loss)]
    if not traces:
        return None
    figure, axis = _panel()
    for index, trace in enumerate(traces):
        loss = np.array(trace.loss, dtype=float)
        axis.plot(
            np.arange(len(loss)), np.where(loss > 0, loss, np.nan), label=trace.method, linewidth=1.4, **_look(index)
        )
    axis.set_yscale("log")
    plain_numbers(axis.yaxis)
    axis.set_xlabel("iteration")
    axis.set_ylabel("loss")
    axis.set_title(view.title, fontsize=9)
    axis.legend(fontsize=8, frameon=False, handlelength=3)
    bare(axis)
    return figure


def normalised(losses: Sequence[np.ndarray]) -> np.ndarray:
    """Losses relative to the first, (N, I); without traces whose first loss is not positive.

    A trace that ended keeps its last loss. Losses of 0 or less are NaN, since the axis is logarithmic.
    """
    scaled = [loss / loss[0] for loss in losses if len(loss) and np.isfinite(loss[0]) and loss[0] > 0]
    table = np.full((len(scaled), max((len(loss) for loss in scaled), default=0)), np.nan)
    for row, loss in zip(table, scaled, strict=True):
        row[: len(loss)] = np.where(loss > 0, loss, np.nan)
        row[len(loss) :] = row[len(loss) - 1]
    return table[:, ~np.isnan(table).all(axis=0)]


def _panel() -> tuple[Figure, Axes]:
    figure = Figure(figsize=(4.2, 2.9), layout="constrained")
    return figure, figure.subplots()


def _look(index: int) -> dict[str, Any]:
    return {"color": PALETTE[index % len(PALETTE)], "linestyle": DASHES[index % len(DASHES)]}
