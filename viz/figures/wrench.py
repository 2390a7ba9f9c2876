"""Wrench of trials, measured and predicted, and their difference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from testbed.errors import InvalidValueError
from viz.style import AXIS_COLORS, EDGE, STYLE, bare
from viz.values import WrenchFit, evenly

LABELS = (("force x, N", "residual, N"), ("force y, N", "residual, N"), ("torque z, N m", "residual, N m"))
"""Labels of each component, and of its residual."""
MOST_DOTS = 1500
"""Largest number of samples of a trial that are drawn, evenly spread."""
HEIGHTS = (1.2, 0.65)
"""Heights of a component's panel and of the panel of its residual [inches]."""
BAND: dict[str, Any] = {"color": EDGE, "alpha": 0.25, "linewidth": 0}
TAIL = 0.002
"""Quantile of the samples at each end that an axis may exclude: the reading jumps as the gripper closes."""


@mpl.rc_context(STYLE)
def wrench_fit_figure(fits: Sequence[WrenchFit]) -> Figure:
    """One column per trial; force x, force y and torque z below each other, each on one scale for all trials.

    Steady samples are colored, the others gray; the line is the prediction, with its 95 % band. Below each component
    is its residual, measured - predicted.

    Raises:
        InvalidValueError: no trials.
    """
    if not fits:
        raise InvalidValueError("fits", "none", "at least one trial")
    size = 0.9 + 2.5 * len(fits), 3 * sum(HEIGHTS) + 0.8
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(6, len(fits), squeeze=False, sharex="col", sharey="row", height_ratios=HEIGHTS * 3)
    for column, fit in enumerate(fits):
        for row, color in enumerate(AXIS_COLORS):
            _draw(axes[2 * row, column], fit, row, color)
            _draw_residual(axes[2 * row + 1, column], fit, row, color)
        axes[0, column].set_title(fit.label, fontsize=8)
        axes[-1, column].set_xlabel("time, s")
    for row, (label, residual) in enumerate(LABELS):
        axes[2 * row, 0].set_ylabel(label)
        axes[2 * row + 1, 0].set_ylabel(residual, fontsize=7)
        axes[2 * row, 0].set_ylim(*_limits(fits, row))
    figure.align_ylabels(axes[:, 0])
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=8, frameon=False)
    frames = list(dict.fromkeys(fit.frame for fit in fits))
    figure.suptitle(f"wrench on the object, {' / '.join(frames)}", fontsize=9)
    return figure


def _draw(axis: Axes, fit: WrenchFit, row: int, color: str) -> None:
    for mask, shade, label in ((~fit.steady, "0.75", "measured"), (fit.steady, color, "measured, steady")):
        _dots(axis, fit, mask, fit.measured[:, row], shade, label)
    # NaN breaks the line and the band between steady stretches
    middle, half = fit.predicted[:, row], fit.band[:, row]
    axis.fill_between(fit.time_s, middle - half, middle + half, label="95 % band", **BAND)
    axis.plot(fit.time_s, middle, color="black", linewidth=1.0, label="predicted")
    bare(axis)


def _draw_residual(axis: Axes, fit: WrenchFit, row: int, color: str) -> None:
    """Draw measured - predicted at the steady samples."""
    half = np.where(np.isfinite(fit.predicted[:, row]), fit.band[:, row], np.nan)
    _dots(axis, fit, fit.steady, fit.measured[:, row] - fit.predicted[:, row], color, None)
    axis.fill_between(fit.time_s, -half, half, **BAND)
    axis.axhline(0.0, color="black", linewidth=0.6)
    bare(axis)


def _dots(axis: Axes, fit: WrenchFit, mask: np.ndarray, values: np.ndarray, color: str, label: str | None) -> None:
    kept = evenly(len(fit.time_s), MOST_DOTS)
    at = kept[mask[kept]]
    look = {"markersize": 1.6, "markeredgewidth": 0, "rasterized": True, "alpha": 0.6}
    axis.plot(fit.time_s[at], values[at], "o", color=color, label=label, **look)


def _limits(fits: Sequence[WrenchFit], row: int) -> tuple[float, float]:
    """Limits that show all steady samples and predictions, and nearly all others."""
    low, high = np.quantile(np.concatenate([fit.measured[:, row] for fit in fits]), (TAIL, 1 - TAIL))
    for fit in fits:
        band = np.concatenate([fit.predicted[:, row] - fit.band[:, row], fit.predicted[:, row] + fit.band[:, row]])
        values = np.concatenate([fit.measured[fit.steady, row], band[np.isfinite(band)]])
        if values.size:
            low, high = min(low, float(values.min())), max(high, float(values.max()))
    margin = 0.06 * max(high - low, 1e-6)
    return float(low - margin), float(high + margin)
