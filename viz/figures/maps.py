"""Mass maps: each group's mass, difference or error as colored cells with a number.

`absolute_difference` is the paper's Fig. absolute_diff.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PolyCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Affine2D, Transform

from estimators.evaluation.statistics import Row
from testbed.files import write_whole
from testbed.objects.chain import Chain
from testbed.objects.model import ObjectModel, ObjectShape
from viz.style import (
    DIFFERENCE_COLORS,
    MASS_COLORS,
    MOST_NAMED,
    NO_ANSWER,
    STYLE,
    Scale,
    aspect,
    difference_scale,
    group_middles,
    mass_scale,
    narrowest_group,
    top_of,
)
from viz.values import EstimateView

PANEL = 2.3
"""Width of an estimate's map [inches]."""
LETTERS = (4.0, 7.0)
"""Least and largest size of a number in an estimate's map [points]."""
ERROR_WIDTH = 3.4
"""Width of the figure of expected errors [inches]."""


def draw_groups(
    axis: Axes,
    shape: ObjectShape,
    values: np.ndarray | None,
    scale: Scale,
    *,
    digits: int = 2,
    letters: float = 5.0,
    place: Affine2D | None = None,
) -> None:
    """Draw one object: cells in the color of their group's value, and the number at each group's middle.

    Args:
        axis: matplotlib's axes.
        shape: geometry of the object.
        values: value of each group, (n_m,), hatched where not finite; None without an answer.
        scale: scale of the colors.
        digits: decimal places of the numbers.
        letters: size of the numbers [points]; 0 without numbers.
        place: transform from the object frame to shared axes; None for axes of the object alone.
    """
    on = axis.transData if place is None else place + axis.transData
    low, high = extent(shape)
    half, group = shape.cell / 2, shape.mass_group[shape.cells]
    cells = shape.particles[shape.cells, None] + half * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])

    def fill(corners: np.ndarray, **look: Any) -> None:
        axis.add_collection(PolyCollection(list(corners), transform=on, **look))

    if values is None:
        fill(cells, facecolor="white", edgecolor="0.7", hatch="////", linewidth=0.2)
        middle = {"transform": on, "ha": "center", "va": "center"}
        x, y = (low + high) / 2
        axis.text(x, y, "no answer", fontsize=max(letters, 6.0), **middle)
    else:
        known, norm = np.isfinite(values), Normalize(0.0, scale.top)
        values = np.where(known, values, 0.0)
        fill(cells, cmap=scale.colors, norm=norm, linewidth=0, antialiased=False, array=values[group])
        if not known.all():
            fill(cells[~known[group]], facecolor=NO_ANSWER, edgecolor="white", hatch="////", linewidth=0)
        unknown = "not observed" if shape.n_m <= MOST_NAMED // 2 else "-"
        for (x, y), value, finite in zip(group_middles(shape), values, known, strict=True) if letters else ():
            dark = mpl.colormaps[scale.colors](norm(value))[1] < 0.5 and finite
            text, size = (f"{value:.{digits}f}", letters) if finite else (unknown, 5.0)
            look = {"color": "white" if dark else "black", "fontsize": size, "zorder": 3 if finite else 5}
            axis.text(x, y, text, ha="center", va="center", transform=on, **look).set_in_layout(False)
    if shape.chain is not None:
        draw_hinges(axis, shape.chain, on)
    if place is not None:
        return
    axis.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), aspect="equal", xticks=[], yticks=[])
    for side in axis.spines.values():
        side.set_visible(False)
    for ruler in (axis.xaxis, axis.yaxis):  # the layout of absent ticks takes most of a figure's time
        ruler.set_visible(bool(ruler.get_label_text()))


def draw_hinges(axis: Axes, chain: Chain, on: Transform) -> None:
    """Draw a ring with a dot at each hinge."""
    look = {"color": "black", "linestyle": "none", "transform": on, "zorder": 2.5}
    axis.plot(*chain.hinges.T, marker="o", markersize=4.5, markerfacecolor="white", markeredgewidth=0.8, **look)
    axis.plot(*chain.hinges.T, marker=".", markersize=1.5, **look)


def extent(shape: ObjectShape) -> tuple[Float[np.ndarray, "2"], Float[np.ndarray, "2"]]:
    """Lower left and upper right corner of an object with a margin of a quarter of a cell [m]."""
    return shape.particles.min(axis=0) - 0.75 * shape.cell, shape.particles.max(axis=0) + 0.75 * shape.cell


def add_bar(figure: Figure, axes: Any, scale: Scale, **look: Any) -> None:
    """Draw the color bar of a scale, below the axes by default; `look` are further options of `colorbar`."""
    default = {"orientation": "horizontal", "shrink": 0.85, "pad": 0.04}
    size = {"fontsize": look.pop("fontsize")} if "fontsize" in look else {}
    colors = ScalarMappable(Normalize(0.0, scale.top), scale.colors)
    figure.colorbar(colors, ax=axes, **default | look).set_label(scale.title, wrap=True, **size)


def save_figure(figure: Figure, path: Path) -> list[Path]:
    """Write a figure as PDF and PNG; returns their paths: `path` with each suffix in place of its own .pdf or .png."""
    stamps: dict[str, dict[str, Any]] = {"pdf": {"CreationDate": None}, "png": {"Software": None}}
    name = path.stem if path.suffix[1:] in stamps else path.name
    files = {kind: path.with_name(f"{name}.{kind}") for kind in stamps}
    with mpl.rc_context(STYLE):
        lay_out(figure)
        for kind, stamp in stamps.items():  # without date and version: files are reproducible
            content = BytesIO()  # matplotlib's error for a PDF that cannot be written gives no reason
            figure.savefig(content, format=kind, dpi=200, metadata=stamp)
            write_whole(files[kind], partial(Path.write_bytes, data=content.getvalue()))
    return list(files.values())


def lay_out(figure: Figure) -> None:
    """Fix the layout of a figure, which matplotlib else computes again for each file."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    figure.set_layout_engine(None)


def as_pixels(figure: Figure) -> Figure:
    """Rasterize the cells of a figure, which makes its SVG smaller."""
    for axis in figure.axes:
        for patches in axis.collections:
            patches.set_rasterized(patches.get_array() is not None)
    return figure


@dataclass(frozen=True, eq=False)
class MeanAnswer:
    """Mean answer of a method on one object, over its estimates under one support and sensing."""

    method: str
    """Name of the method."""
    mass: Float[np.ndarray, "n_m"]
    """Mean mass of each group [kg]."""
    difference: Float[np.ndarray, "n_m"]
    """Mean of |estimate - truth| of each group [kg]."""

    @staticmethod
    def of(rows: Sequence[Row], method: str) -> MeanAnswer | None:
        """Mean over the rows of a method; None without an answer."""
        found = [row for row in rows if row["method"] == method and row["mass_kg"] is not None]
        if not found:
            return None
        masses = np.array([row["mass_kg"] for row in found], dtype=float)
        truths = np.array([row["true_mass_kg"] for row in found], dtype=float)
        return MeanAnswer(method, masses.mean(axis=0), np.abs(masses - truths).mean(axis=0))


def absolute_difference(rows: Sequence[Row], shapes: Mapping[str, ObjectShape], title: str) -> Figure:
    """Differences of mass [kg per group], means over draws: a row per object, a column per method.

    Args:
        rows: of a scenario run, under one support and sensing.
        shapes: geometry of every object, by name.
        title: title of the figure.
    """
    methods = list(dict.fromkeys(row["method"] for row in rows))
    answers = {
        (name, method): MeanAnswer.of([row for row in rows if row["object"] == name], method)
        for name in shapes
        for method in methods
    }
    known = [answer.difference for answer in answers.values() if answer]
    scale = Scale(
        max(top_of(known), 1e-3) if known else 1.0, DIFFERENCE_COLORS, "absolute difference of mass, kg per group"
    )
    with mpl.rc_context({**STYLE, "font.size": 8.0}):
        heights = [aspect(shape, 0.3, 1.0) for shape in shapes.values()]
        figure = Figure(figsize=(1.35 * len(methods) + 1.6, 1.35 * sum(heights) + 0.9), layout="constrained")
        axis = figure.subplots()  # shared by all maps: creation and layout of axes take longer than drawing
        bottom = 0.0
        for (name, shape), height in zip(shapes.items(), heights, strict=True):
            bottom -= height
            axis.text(-0.05, bottom + height / 2, name, ha="right", va="center", fontsize=9)
            low, high = extent(shape)
            size = 0.96 * min(1 / (high - low)[0], height / (high - low)[1])
            for column, method in enumerate(methods):
                x, y = np.array([column + 0.5, bottom + height / 2]) - size * (low + high) / 2
                answer = answers[name, method]
                draw_groups(
                    axis, shape, answer and answer.difference, scale, place=Affine2D().scale(size).translate(x, y)
                )
        for column, method in enumerate(methods):
            label = method.replace("_", " ").replace(" ", "\n", 1)
            axis.text(column + 0.5, 0.03, label, ha="center", va="bottom", fontsize=8)
        axis.set(xlim=(0, len(methods)), ylim=(bottom, 0), aspect="equal")
        axis.set_axis_off()
        upright = {"orientation": "vertical", "shrink": 0.6, "pad": 0.01}
        add_bar(figure, axis, scale, extend="max", aspect=35, **upright)
        figure.suptitle(title, fontsize=9)
    return figure


def compared_methods(rows: Sequence[Row]) -> list[str]:
    """Methods whose maps are compared: the hidden states, and the other method with the lowest mean NAD."""
    nads: dict[str, list[float]] = {}
    for row in rows:
        if row["nad"] is not None:
            nads.setdefault(row["method"], []).append(row["nad"])
    own = [m for m in nads if any(row["method"] == m and row["kind"] == "hidden_states" for row in rows)]
    others = sorted((m for m in nads if m not in own), key=lambda m: float(np.mean(nads[m])))
    return own[:1] + others[: 1 if own else 2]


def map_scales(truths: Sequence[np.ndarray], answers: Sequence[MeanAnswer]) -> tuple[Scale, Scale]:
    """Scales of mass and of difference for the maps of several objects.

    Args:
        truths: true masses of each object [kg per group], (n_m,).
        answers: all drawn answers.
    """
    mass, difference = top_of([*truths, *(a.mass for a in answers)]), top_of([a.difference for a in answers])
    return (
        Scale(max(mass, 1e-3), MASS_COLORS, "mass, true and estimated, kg per group"),
        Scale(max(difference, 1e-3), DIFFERENCE_COLORS, "absolute difference, kg per group"),
    )


@mpl.rc_context(STYLE)
def mass_maps(
    shape: ObjectShape, truth: np.ndarray, groups: Mapping[str, Sequence[MeanAnswer]], scales: tuple[Scale, Scale]
) -> Figure:
    """Masses and differences of one object: a row per support and sensing; the truth, then two maps per method.

    Args:
        shape: geometry of the object.
        truth: true masses [kg per group], (n_m,).
        groups: answers by the name of support and sensing.
        scales: scales of mass and of difference, from `map_scales`.
    """
    most = max((len(found) for found in groups.values()), default=0)
    mass, difference = scales
    size = (1.5 * (1 + 2 * most) + 0.5, (1.4 * aspect(shape, 0.3, 1.0) + 0.35) * len(groups) + 0.8)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(len(groups), 1 + 2 * most, squeeze=False)
    for line, (label, found) in zip(axes, groups.items(), strict=True):
        line[0].set_ylabel(label.replace(", ", "\n"), fontsize=8, rotation=0, ha="right", va="center")
        panels = [("true mass", truth, mass)]
        for each in found:
            panels += [(f"{each.method}:\nmass", each.mass, mass)]
            panels += [(f"{each.method}:\ndifference", each.difference, difference)]
        for axis, (title, values, scale) in zip(line, panels, strict=False):
            draw_groups(axis, shape, values, scale, letters=6.5)
            axis.set_title(title, fontsize=8)
        for axis in line[len(panels) :]:
            axis.set_visible(False)
    look: dict[str, Any] = {"shrink": 0.8, "aspect": 30, "extend": "max", "pad": 0.03, "fontsize": 8}
    add_bar(figure, axes[:, : most + 1].ravel().tolist(), mass, **look)
    if most:
        add_bar(figure, axes[:, most + 1 :].ravel().tolist(), difference, **look)
    return figure


@mpl.rc_context(STYLE)
def error_figure(model: ObjectModel, standard_error: Float[np.ndarray, "n_m"], title: str) -> Figure:
    """Expected standard error of each group [g]; hatched where infinite.

    Args:
        model: object.
        standard_error: standard error of every group [kg]; infinite where the trials do not determine its mass.
        title: description of the trials and their sensing.
    """
    shape, error = model.shape, 1e3 * standard_error
    known = error[np.isfinite(error)]
    scale = Scale(max([0.1, *known]) if known.size else 1.0, DIFFERENCE_COLORS, "standard error, g")
    height = ERROR_WIDTH * aspect(shape, 0.2, 1.4) * 0.8 + 1.2
    figure = Figure(figsize=(ERROR_WIDTH, height), layout="constrained")
    axis = figure.subplots()
    letters = 7.0 if shape.n_m <= MOST_NAMED else 0.0
    draw_groups(axis, shape, error, scale, digits=decimals(scale.top), letters=letters)
    axis.set_title(title, fontsize=9)
    if known.size:
        add_bar(figure, axis, scale, aspect=18)
    return figure


@mpl.rc_context(STYLE)
def estimate_maps(view: EstimateView) -> Figure:
    """True mass, estimated mass and absolute difference, as in the Rerun view; the estimate alone without a truth."""
    mass, difference, shape = mass_scale([view]), difference_scale([view]), view.shape
    panels: list[tuple[str, np.ndarray | None, Scale]] = [("estimated mass", view.mass, mass)]
    if view.truth is not None:
        panels = [("true mass", view.true_mass, mass), *panels, ("absolute difference", view.difference, difference)]
    size = (PANEL * len(panels), 2.1 * aspect(shape, 0.2, 1.4) + 1.1)
    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(1, len(panels), squeeze=False)[0]
    whole = float(np.ptp(shape.particles[:, 0])) + shape.cell
    room = 72 * 0.9 * PANEL * narrowest_group(shape) / whole
    for axis, (title, values, scale) in zip(axes, panels, strict=True):
        texts = ["no answer"] if values is None else [f"{value:.{scale.digits}f}" for value in values]
        letters = min(LETTERS[1], room / (0.62 * max(map(len, texts))))
        letters = letters if shape.n_m <= MOST_NAMED and letters >= LETTERS[0] else 0.0
        draw_groups(axis, shape, values, scale, digits=scale.digits, letters=letters)
        axis.set_title(title)
    masses = [axis for axis, (*_, scale) in zip(axes, panels, strict=True) if scale is mass]
    add_bar(figure, masses, mass, ticks=MaxNLocator(4), aspect=16 * len(masses))
    if view.truth is not None:
        add_bar(figure, [axes[-1]], difference, ticks=MaxNLocator(4), aspect=16)
    figure.suptitle(view.title, fontsize=9)
    return figure


def decimals(largest: float) -> int:
    """Decimal places that show three significant digits of `largest`, 0 to 3."""
    return int(np.clip(2 - np.floor(np.log10(max(largest, 1e-9))), 0, 3))
