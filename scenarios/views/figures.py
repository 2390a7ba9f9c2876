"""Figures of a results folder, or of one of its estimates, as files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from pathlib import Path

from matplotlib.figure import Figure

from estimators.evaluation.statistics import AXIS, Row, axes_of, axis_values
from scenarios.results.estimates import load_losses, load_rows
from scenarios.results.files import inside
from scenarios.views.values import estimate_view, fits_of
from testbed.errors import InvalidValueError
from testbed.files import unless_damaged
from testbed.objects.model import ObjectShape
from viz.figures.bars import estimate_bars
from viz.figures.loss import estimate_losses, loss_figure
from viz.figures.maps import absolute_difference, estimate_maps, save_figure
from viz.figures.nad import nad_distribution, nad_sweep
from viz.figures.wrench import wrench_fit_figure
from viz.report.tables import MOST_OBJECTS, by_setting
from viz.values import support_name

TRIALS_A_FIGURE = 4
"""Largest number of wrench fits side by side on a page."""


def figures(folder: Path, what: Row | None = None) -> list[Path]:
    """Write figures into folder/figures, each whole or not at all; returns their paths.

    Args:
        folder: results folder.
        what: row of the estimate to draw; None for the figures of the whole folder.

    Raises:
        InvalidValueError: no estimates in the folder.
        HeftError: a file is damaged.
    """
    drawn = _of_all(folder) if what is None else _of_estimate(folder, what)
    return [path for name, figure in drawn for path in save_figure(figure, inside(folder, "figures", file_name(name)))]


def file_name(title: str) -> str:
    """File name of a title, in letters, digits, dots, dashes and underscores."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", title.replace("/", " per ")).strip("_.")


def _of_all(folder: Path) -> Iterator[tuple[str, Figure]]:
    """Names and figures of a folder: NAD by method and against swept settings, differences by object, and losses."""
    rows = [row for row in load_rows(folder) if row["method"]]
    if not rows:
        raise InvalidValueError("DIR", str(folder), "a results folder with estimates, as `heft run` makes it")
    groups = {f"{support} {sensing}": found for (support, sensing), found in by_setting(rows).items()}
    for under, found in groups.items():
        title = f"{support_name(found[0]['support'])}, {found[0]['sensing']}"
        if any(row["nad"] is not None for row in found):
            yield f"nad {under}", nad_distribution(found)
        shapes = _shapes(folder, found)
        if shapes:
            yield f"absolute_difference {under}", absolute_difference(found, shapes, title)
    for axis in axes_of(rows):
        swept = {f" {under}": found for under, found in groups.items() if len(axis_values(found, axis)) > 1}
        for under, found in (swept or {"": rows}).items():
            yield f"nad_against {axis.removeprefix(AXIS)}{under}", nad_sweep(found, axis)
    for method, losses in load_losses(folder, rows).items():
        yield f"loss {method}", loss_figure(losses)


def _of_estimate(folder: Path, row: Row) -> Iterator[tuple[str, Figure]]:
    """Names and figures of an estimate: maps, bars, losses, and the wrench of its trials, measured and predicted."""
    shown = estimate_view(folder, row)
    name = f"{row['object']} {row['method']} {str(row['key'])[:8]}"
    yield f"{name} maps", estimate_maps(shown)
    yield f"{name} bars", estimate_bars(shown)
    losses = estimate_losses(shown)
    if losses is not None:
        yield f"{name} loss", losses
    fits = [fit for _, _, fit in fits_of(folder, row, shown)]
    for page, begin in enumerate(range(0, len(fits), TRIALS_A_FIGURE)):
        yield f"{name} wrenches {page + 1}", wrench_fit_figure(fits[begin : begin + TRIALS_A_FIGURE])


def _shapes(folder: Path, rows: Sequence[Row]) -> dict[str, ObjectShape]:
    """Geometry of each object with known masses; empty in a sweep, or for more than MOST_OBJECTS objects."""
    answered = [row for row in reversed(rows) if row.get("key") and row["mass_kg"] is not None]
    first = {row["object"]: row for row in answered if row["true_mass_kg"] is not None}
    if axes_of(rows) or len(first) > MOST_OBJECTS:
        return {}
    shapes = {}
    for name in dict.fromkeys(row["object"] for row in rows if row["object"] in first):
        view = unless_damaged(lambda name=name: estimate_view(folder, first[name]), "drawn without it")
        if view is not None:
            shapes[name] = view.shape
    return shapes
