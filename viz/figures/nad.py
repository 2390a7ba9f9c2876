"""Normalized absolute difference (NAD): its distribution by method, and its dependence on a swept setting."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.axis import XAxis, YAxis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from estimators.evaluation.statistics import AXIS, Row, axis_values, methods_of, object_means, select
from viz.style import DASHES, MARKERS, PALETTE, STYLE, bare, plain_numbers

BEYOND = 1.5
"""End of a logarithmic axis with zeros, relative to the largest value."""
WIDE_RANGE = 20.0
"""Ratio of the largest to the smallest value from which on an axis is logarithmic."""
FEW = 8
"""Largest number of values of a swept setting with a tick each."""
UNITS = {"support": "N/m", "duration": "s", "pivot_error": "m"}
"""Units of settings whose names do not end with one."""
SUFFIXES = {"_kg": "kg", "_N": "N", "_m": "m", "_s": "s"}
"""Units by the suffix of a setting's name."""
MANY = 400
"""Largest number of points of a method that are neither faint nor rasterized."""


@mpl.rc_context(STYLE)
def nad_distribution(rows: Sequence[Row]) -> Figure:
    """One row per method: a point per estimate, a bar from the lower to the upper quartile, a stroke at the median."""
    methods = methods_of(rows)
    figure = Figure(figsize=(5.4, 0.36 * len(methods) + 0.8), layout="constrained")
    axis = figure.subplots()
    labels, every = [], []
    rng = np.random.default_rng(0)
    for place, method in enumerate(methods):
        found = [row["nad"] for row in rows if row["method"] == method]
        values = 100 * np.array([value for value in found if value is not None])
        missing = len(found) - len(values)
        labels.append(method + (f" ({missing} none)" if missing else ""))
        every.append(values)
        if len(values) == 0:
            continue
        heights = place + rng.uniform(-0.22, 0.22, len(values))
        alpha, as_pixels = (0.15, True) if len(values) > MANY else (0.55, False)
        axis.scatter(values, heights, s=9, color=PALETTE[0], alpha=alpha, linewidth=0, rasterized=as_pixels)
        low, middle, high = np.quantile(values, (0.25, 0.5, 0.75))
        axis.hlines(place, low, high, color="0.2", linewidth=9, alpha=0.25, zorder=3)
        axis.vlines(middle, place - 0.32, place + 0.32, color=PALETTE[1], linewidth=2.2, zorder=4)
    axis.set_yticks(range(len(methods)), labels)
    axis.set_ylim(len(methods) - 0.5, -0.5)
    _scale(axis.xaxis, np.concatenate(every) if every else np.array([]))
    axis.set_xlabel("NAD, %")
    bare(axis)
    return figure


@mpl.rc_context(STYLE)
def nad_sweep(rows: Sequence[Row], axis_column: str) -> Figure:
    """NAD against a swept setting: a line per method through the medians, a band from the lower to the upper quartile.

    A setting of many words has a row for each word: a bar of the first method's median, and a point per method.

    Args:
        rows: of a scenario run, with `kind`, `method`, `nad` and the swept column.
        axis_column: column of the swept setting.
    """
    values = axis_values(rows, axis_column)
    numeric = all(isinstance(value, int | float) for value in values)
    if not numeric and len(values) > FEW:
        return _by_word(rows, axis_column, values)
    places = np.array(values, dtype=float) if numeric else np.arange(len(values), dtype=float)
    figure = Figure(figsize=(5.4, 4.2), layout="constrained")
    axis = figure.subplots()
    kinds = list(dict.fromkeys(row["kind"] for row in rows))
    drawn: list[str] = []
    quartiles = []
    for method in methods_of(rows):
        known = [row for row in rows if row["method"] == method and row["nad"] is not None]
        if not known:
            continue
        kind = known[0]["kind"]
        present, (low, middle, high) = _quartiles(known, axis_column, values)
        look = kinds.index(kind) % len(PALETTE)
        axis.fill_between(places[present], low, high, color=PALETTE[look], alpha=0.12, linewidth=0)
        axis.plot(
            places[present], middle, color=PALETTE[look], marker=MARKERS[look], markersize=4, linewidth=1.4,
            linestyle=DASHES[drawn.count(kind) % len(DASHES)], label=method,
        )  # fmt: skip
        drawn.append(kind)
        quartiles += [low, middle, high]
    if numeric:
        _scale(axis.xaxis, places)
    if not numeric or len(places) <= FEW:
        axis.set_xticks(places, [f"{v:g}" if isinstance(v, float) else str(v) for v in values])
    _scale(axis.yaxis, np.concatenate(quartiles) if quartiles else np.array([]))
    axis.set_xlabel(axis_label(axis_column))
    axis.set_ylabel("NAD, %")
    if drawn:
        figure.legend(loc="outside lower center", ncols=3, fontsize=7, frameon=False, handlelength=3)
    bare(axis)
    return figure


def _quartiles(rows: Sequence[Row], axis_column: str, values: Sequence[object]) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the values of a setting with rows, (K,), and quartiles over objects of the NAD at them [%], (3, K).

    Each object counts once, with the mean over its draws.
    """
    found = [[*object_means(select(rows, **{axis_column: value}), None, "nad", 100.0).values()] for value in values]
    present = np.flatnonzero([len(each) > 0 for each in found])
    return present, np.reshape([np.quantile(found[i], (0.25, 0.5, 0.75)) for i in present], (-1, 3)).T


def _by_word(rows: Sequence[Row], axis_column: str, values: Sequence[object]) -> Figure:
    """Medians and quartiles of every method, a row for each word of a setting."""
    methods = methods_of(rows)
    figure = Figure(figsize=(6.4, 0.34 * len(values) + 1.2), layout="constrained")
    axis, every = figure.subplots(), []
    for index, method in enumerate(methods):
        known = [row for row in rows if row["method"] == method and row["nad"] is not None]
        present, (low, middle, high) = _quartiles(known, axis_column, values)
        if len(present) == 0:
            continue
        color, marker = PALETTE[index % len(PALETTE)], MARKERS[index % len(MARKERS)]
        at = present + 0.6 * ((index + 0.5) / len(methods) - 0.5)
        if index == 0:
            axis.barh(present, middle, height=0.8, color=color, alpha=0.18, linewidth=0)
        axis.hlines(at, low, high, color=color, linewidth=1.0, alpha=0.6)
        axis.plot(middle, at, color=color, marker=marker, markersize=4, linestyle="none", label=method)
        every += [low, middle, high]
    axis.set_yticks(range(len(values)), [str(value) for value in values])
    axis.set_ylim(len(values) - 0.5, -0.5)
    _scale(axis.xaxis, np.concatenate(every) if every else np.array([]))
    axis.set_xlabel("NAD, %")
    axis.set_ylabel(axis_label(axis_column))
    if every:
        figure.legend(loc="outside lower center", ncols=3, fontsize=7, frameon=False, handlelength=1)
    bare(axis)
    return figure


def axis_label(axis_column: str) -> str:
    """Name of a swept setting, with its unit if known."""
    name = axis_column.removeprefix(AXIS)
    last = name.rsplit(".", 1)[-1]
    unit = UNITS.get(last) or next((unit for end, unit in SUFFIXES.items() if last.endswith(end)), "")
    return f"{name}, {unit}" if unit else name


def _scale(axis: XAxis | YAxis, values: np.ndarray) -> None:
    """Make an axis logarithmic for values of a ratio of WIDE_RANGE or more.

    With zeros, it is linear up to the decade of the least positive value.
    """
    positive = values[values > 0]
    if len(positive) == 0 or values.min() < 0 or positive.max() < WIDE_RANGE * positive.min():
        return
    set_scale, set_limits = (getattr(axis.axes, f"set_{axis.axis_name}{what}") for what in ("scale", "lim"))
    if len(positive) < len(values):
        set_scale("symlog", linthresh=10 ** np.floor(np.log10(positive.min())))
        set_limits(0.0, BEYOND * positive.max())
    else:
        set_scale("log")
        decades = np.log10(positive.max() / positive.min())
        axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if decades < 2.5 else (1.0,)))
    plain_numbers(axis)
