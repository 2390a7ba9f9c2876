"""The paper's Fig. absolute_diff: how far each block's mass is off, method by object, kilograms a block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from matplotlib.ticker import MaxNLocator

from estimators.evaluation.statistics import Row
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.trajectory import write_whole
from viz.recordings.estimate import LEVEL, EstimateShown, difference_scale_of, mass_scale_of
from viz.recordings.mass_map import Scale
from viz.style import (
    DASHES,
    DIFFERENCE_COLORS,
    ESTIMATE,
    MARKERS,
    MASS_COLORS,
    NO_ANSWER,
    PALETTE,
    STYLE,
    TOP,
    TRUTH,
    bare,
    plain_numbers,
)


def absolute_difference(rows: Sequence[Mapping[str, Any]], shapes: Mapping[str, ObjectShape], title: str) -> Figure:
    """One figure: a row an object, a column a method; each mass group in its place, with its number.

    Args:
        rows: of a scenario run, under one support and sensing; differences are means over the draws.
        shapes: of every object, by name.
        title: what the rows have in common.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    differences = {
        (name, method): _difference([row for row in rows if (row["object"], row["method"]) == (name, method)])
        for name in shapes
        for method in methods
    }
    known = [value for value in differences.values() if value is not None]
    top = float(np.percentile(np.concatenate(known), TOP)) if known else 1.0
    norm = Normalize(0.0, max(top, 1e-3))
    with mpl.rc_context({**STYLE, "font.size": 8.0}):
        heights = [_map_height(shape) for shape in shapes.values()]
        figure = Figure(figsize=(1.35 * len(methods) + 1.6, 1.35 * sum(heights) + 0.9), layout="constrained")
        axes = figure.subplots(len(shapes), len(methods), squeeze=False, height_ratios=heights)
        for i, (name, shape) in enumerate(shapes.items()):
            for j, method in enumerate(methods):
                axis = axes[i, j]
                draw_groups(axis, shape, differences[name, method], norm)
                if i == 0:
                    axis.set_title(method.replace("_", " ").replace(" ", "\n", 1), fontsize=8)
                if j == 0:
                    axis.set_ylabel(name, rotation=0, ha="right", va="center", fontsize=9)
        scale = ScalarMappable(norm, DIFFERENCE_COLORS)
        bar = figure.colorbar(scale, ax=axes, extend="max", shrink=0.6, aspect=35, pad=0.01)
        bar.set_label("absolute difference of mass, kg a group")
        figure.suptitle(title, fontsize=9)
    return figure


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PDF and PNG; the files, which are `path` with each suffix."""
    stamps: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "png": {"Software": None}}
    files = {kind: path.with_name(f"{path.name}.{kind}") for kind in stamps}
    with mpl.rc_context(STYLE):
        figure.draw_without_rendering()  # lays it out, once for both files
        figure.set_layout_engine("none")
        for kind, stamp in stamps.items():  # the same figure is the same file
            write_whole(files[kind], lambda part, k=kind, s=stamp: figure.savefig(part, format=k, dpi=200, metadata=s))
    return list(files.values())


def _difference(rows: Sequence[Mapping[str, Any]]) -> np.ndarray | None:
    """Mean over draws of |estimate - truth|, kg a group, (n_m,); None where no draw has an answer."""
    off = [np.abs(np.subtract(row["mass_kg"], row["true_mass_kg"])) for row in rows if row["mass_kg"] is not None]
    return np.mean(off, axis=0) if off else None


def _map_height(shape: ObjectShape) -> float:
    """Of a panel, over its width: low objects need no tall one."""
    width, height = np.ptp(shape.particles, axis=0) + shape.cell
    return float(np.clip(height / width, 0.3, 1.0))


def draw_groups(
    axis: Axes,
    shape: ObjectShape,
    values: np.ndarray | None,
    norm: Normalize,
    colors: str = DIFFERENCE_COLORS,
    digits: int = 2,
) -> None:
    """One object: its cells coloured by their group's value, kg, (n_m,), and the number at each group's middle.

    Args:
        axis: where to.
        shape: geometry.
        values: kg a group, (n_m,); None where there is no answer.
        norm: of the colours.
        colors: name of the colour map.
        digits: of the numbers, after the point.
    """
    half = shape.cell / 2
    cells = [Rectangle((x - half, y - half), shape.cell, shape.cell) for x, y in shape.particles]
    if values is None:
        axis.add_collection(PatchCollection(cells, facecolor="white", edgecolor="0.7", hatch="////", linewidth=0.2))
        axis.text(0.5, 0.5, "no answer", transform=axis.transAxes, ha="center", va="center", fontsize=6)
    else:
        patches = PatchCollection(cells, cmap=colors, norm=norm, linewidth=0, antialiased=False)
        patches.set_array(values[shape.mass_group])
        axis.add_collection(patches)
        for group, value in enumerate(values):
            x, y = shape.particles[shape.mass_group == group].mean(axis=0)
            dark = mpl.colormaps[colors](norm(value))[1] < 0.5
            axis.text(
                x, y, f"{value:.{digits}f}", ha="center", va="center", fontsize=5, color="white" if dark else "black"
            )
    low, high = shape.particles.min(axis=0) - 1.5 * half, shape.particles.max(axis=0) + 1.5 * half
    axis.set_xlim(low[0], high[0])
    axis.set_ylim(low[1], high[1])
    axis.set_aspect("equal")
    axis.set_xticks([])
    axis.set_yticks([])
    for side in axis.spines.values():
        side.set_visible(False)


@dataclass(frozen=True, eq=False)
class Answer:
    """What a method says of an object, under one support and sensing: means over its estimates."""

    method: str
    mass: np.ndarray
    """kg a group, (n_m,)."""
    difference: np.ndarray
    """Mean of |estimate - truth|, kg a group, (n_m,)."""


def answer_of(rows: Sequence[Row], method: str) -> Answer | None:
    """The mean of a method's answers; None without any."""
    found = [row for row in rows if row["method"] == method and row["mass_kg"] is not None]
    if not found:
        return None
    masses = np.array([row["mass_kg"] for row in found], dtype=float)
    truths = np.array([row["true_mass_kg"] for row in found], dtype=float)
    return Answer(method, masses.mean(axis=0), np.abs(masses - truths).mean(axis=0))


def shown_methods(rows: Sequence[Row]) -> list[str]:
    """The method of hidden states, and the best other one by mean NAD on these rows."""
    nads: dict[str, list[float]] = {}
    for row in rows:
        if row["nad"] is not None:
            nads.setdefault(row["method"], []).append(row["nad"])
    own = [m for m in nads if any(row["method"] == m and row["kind"] == "hidden_states" for row in rows)]
    others = sorted((m for m in nads if m not in own), key=lambda m: float(np.mean(nads[m])))
    return own[:1] + others[: 1 if own else 2]


@mpl.rc_context(STYLE)
def mass_maps(shape: ObjectShape, truth: np.ndarray, groups: Mapping[str, Sequence[Answer]]) -> Figure:
    """A row a support and sensing; the truth, then each method's mass and difference.

    Args:
        shape: geometry.
        truth: kg a group, (n_m,).
        groups: answers by support and sensing, in words.
    """
    answers = [answer for found in groups.values() for answer in found]
    most = max((len(found) for found in groups.values()), default=0)
    top = max(float(truth.max()), _top([a.mass for a in answers]))
    mass_norm, off_norm = Normalize(0.0, top), Normalize(0.0, max(_top([a.difference for a in answers]), 1e-3))
    figure = Figure(
        figsize=(1.5 * (1 + 2 * most) + 0.5, (1.4 * _height(shape) + 0.35) * len(groups) + 0.8), layout="constrained"
    )
    axes = figure.subplots(len(groups), 1 + 2 * most, squeeze=False)
    for line, (label, found) in zip(axes, groups.items(), strict=True):
        line[0].set_ylabel(label.replace(", ", "\n"), fontsize=8, rotation=0, ha="right", va="center")
        draw_groups(line[0], shape, truth, mass_norm, MASS_COLORS)
        line[0].set_title("true mass", fontsize=8)
        for axis in line[1 + 2 * len(found) :]:
            axis.set_visible(False)
        for answer, left, right in zip(found, line[1::2], line[2::2], strict=False):
            draw_groups(left, shape, answer.mass, mass_norm, MASS_COLORS)
            left.set_title(f"{answer.method}:\nmass", fontsize=8)
            draw_groups(right, shape, answer.difference, off_norm)
            right.set_title(f"{answer.method}:\ndifference", fontsize=8)
    for axis in figure.axes:
        for text in axis.texts:
            text.set_fontsize(6.5)
    half: dict[str, Any] = {"orientation": "horizontal", "shrink": 0.8, "aspect": 30, "extend": "max", "pad": 0.03}
    left = figure.colorbar(ScalarMappable(mass_norm, MASS_COLORS), ax=axes[:, : most + 1].ravel().tolist(), **half)
    left.set_label("mass, true and estimated, kg a group", fontsize=8)
    if most:
        right = figure.colorbar(
            ScalarMappable(off_norm, DIFFERENCE_COLORS), ax=axes[:, most + 1 :].ravel().tolist(), **half
        )
        right.set_label("absolute difference, kg a group", fontsize=8)
    return figure


@mpl.rc_context(STYLE)
def mass_bars(names: Sequence[str], truth: np.ndarray, groups: Mapping[str, Sequence[Answer]]) -> Figure:
    """The same without geometry: a bar to the truth of each group, a mark a method, support and sensing."""
    series = [(f"{a.method}, {label}", a.mass) for label, found in groups.items() for a in found]
    figure = Figure(figsize=(4.8, 0.3 * len(names) + 0.9 + 0.1 * len(series)), layout="constrained")
    axis = figure.subplots()
    axis.barh(np.arange(len(names)), truth, 0.7, color="0.82", edgecolor="0.3", label="truth")
    for i, (label, values) in enumerate(series):
        height = np.arange(len(names)) + 0.6 * ((i + 0.5) / len(series) - 0.5)
        mark = MARKERS[i % len(MARKERS)]
        axis.plot(values, height, mark, color=PALETTE[i % len(PALETTE)], markersize=4, label=label)
    axis.set_yticks(range(len(names)), names)
    axis.invert_yaxis()
    axis.set_xlabel("mass, kg a group")
    figure.legend(loc="outside lower center", ncols=1, fontsize=8, frameon=False)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)
    return figure


def as_pixels(figure: Figure) -> Figure:
    """Draw the many small cells as pixels: a fraction of the size as SVG."""
    for axis in figure.axes:
        for patches in axis.collections:
            patches.set_rasterized(patches.get_array() is not None)
    return figure


def _height(shape: ObjectShape) -> float:
    """Over the width; low objects need no tall panel."""
    width, height = np.ptp(shape.particles, axis=0) + shape.cell
    return float(np.clip(height / width, 0.3, 1.0))


def _top(values: Sequence[np.ndarray]) -> float:
    return float(np.percentile(np.concatenate(values), TOP)) if values else 0.0


WIDTH = 3.4
"""Of the figure, inches."""
MOST_NAMED_ERRORS = 30
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
        text.set_visible(shape.n_m <= MOST_NAMED_ERRORS)
        if not seen[group]:
            text.set_text("not seen" if shape.n_m <= MOST_NAMED_ERRORS // 2 else "-")
            text.set(color="black", zorder=5, fontsize=5)
    axis.set_title(title, fontsize=9)
    if not seen.any():
        return figure
    colors = ScalarMappable(Normalize(0.0, top), DIFFERENCE_COLORS)
    bar = figure.colorbar(colors, ax=axis, orientation="horizontal", shrink=0.85, aspect=18, pad=0.04)
    bar.set_label("standard error, % of the mean group's mass")
    return figure


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
