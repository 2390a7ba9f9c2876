"""Maps of a measured object's answers: each group's mass, and the half width of its interval."""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from viz.figures.maps import add_bar, draw_groups
from viz.report.answers import Answer
from viz.style import DIFFERENCE_COLORS, MASS_COLORS, STYLE, Scale, aspect
from viz.values import DEVIATIONS

MOST_DRAWN = 3
"""Largest number of answers that are drawn; where some have intervals, only those."""


@mpl.rc_context(STYLE)
def answer_maps(answers: Sequence[Answer]) -> Figure:
    """A row per method: its masses, and half of each 90 % interval, hatched where there is none.

    Args:
        answers: of one object, one or more with masses.
    """
    known = [answer for answer in answers if answer.distribution is not None]
    drawn = ([answer for answer in known if answer.covariance is not None] or known)[:MOST_DRAWN]
    shape = drawn[0].shape
    found = [answer.quantities[: shape.n_m] for answer in drawn]
    masses = np.array([[quantity.value for quantity in row] for row in found])
    halves = DEVIATIONS * np.array([[quantity.error for quantity in row] for row in found])
    finite = halves[np.isfinite(halves)]
    scales = (
        Scale(max(float(masses.max()), 1e-3), MASS_COLORS, "mass, kg per group"),
        Scale(max(float(finite.max(initial=0.0)), 1e-3), DIFFERENCE_COLORS, "half of the 90 % interval, kg"),
    )
    figure = Figure(figsize=(5.5, 2.0 * aspect(shape, 0.3, 1.0) * len(drawn) + 0.8), layout="constrained")
    axes = figure.subplots(len(drawn), 2, squeeze=False)
    for line, answer, mass, half in zip(axes, drawn, masses, halves, strict=True):
        line[0].set_ylabel(f"{answer.method}\n{answer.status}", fontsize=8, rotation=0, ha="right", va="center")
        draw_groups(line[0], shape, mass, scales[0], digits=3, letters=6.5)
        draw_groups(line[1], shape, half, scales[1], digits=3, letters=6.5)
    for column, scale in enumerate(scales):
        add_bar(figure, axes[:, column].tolist(), scale, aspect=30, fontsize=8, ticks=MaxNLocator(4))
    return figure
