"""The paper's Fig. absolute_diff: how far each block's mass is off, method by object, kilograms a block."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.cm import ScalarMappable
from matplotlib.collections import PatchCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle

from testbed.objects import ObjectShape
from testbed.trajectory import write_whole
from viz.style import DIFFERENCE_COLORS, STYLE, TOP


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
        heights = [_height(shape) for shape in shapes.values()]
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


def _height(shape: ObjectShape) -> float:
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
