"""One object: its true mass, what methods say it is, and how far they are off, each group in its place."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from scenarios.comparison import Row
from testbed.objects import ObjectShape
from viz.heatmap import draw_groups
from viz.style import DIFFERENCE_COLORS, MARKERS, MASS_COLORS, PALETTE, STYLE, TOP


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
