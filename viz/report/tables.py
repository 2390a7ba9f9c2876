"""The report's tables of numbers: methods down; objects, or quantiles over many objects, across."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from estimators.evaluation.statistics import (
    Draws,
    Row,
    axes_of,
    draws_of,
    select,
    significantly_best,
    summarize,
)
from viz.report.terminal import NAD, Metric

MOST_OBJECTS = 12
"""More objects than this are not shown one by one."""
TRUTH = "the true masses"


@dataclass(frozen=True)
class Cell:
    """One number and what is known of it."""

    text: str
    interval: str = ""
    """Bootstrap interval of the mean."""
    paper: str = ""
    """The paper's figure for the same cell."""
    note: str = ""
    """Draws or objects without an answer."""
    best: bool = False
    """Better than every other method, for sure."""


@dataclass(frozen=True)
class Table:
    """A head and rows; each row has a label and a cell a column."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[str, tuple[Cell, ...]], ...]


def number(value: float, like: float | None = None) -> str:
    """Three digits or so: 0.17, 3.46, 23.1, 174; as many after the point as for `like`, if given."""
    if np.isnan(value):
        return "-"
    size = abs(value if like is None else like)
    return f"{value:.{2 if size < 10 else 1 if size < 100 else 0}f}"


def methods_of(rows: Sequence[Row]) -> list[str]:
    """Methods, in the order of the rows."""
    return list(dict.fromkeys(row["method"] for row in rows))


def metric_table(rows: Sequence[Row], metric: Metric, title: str) -> Table | None:
    """One metric under one support and sensing; None where nobody has a number."""
    if all(row[metric.column] is None for row in rows):
        return None
    objects = list(dict.fromkeys(row["object"] for row in rows))
    aggregated = len(objects) > MOST_OBJECTS or axes_of(rows)
    return _over_objects(rows, metric, title) if aggregated else _by_object(rows, metric, title, objects)


def _by_object(rows: Sequence[Row], metric: Metric, title: str, objects: list[str]) -> Table:
    methods = methods_of(rows)
    of = {name: {m: select(rows, object=name, method=m) for m in methods} for name in objects}
    draws = {name: {m: draws_of(of[name][m], metric.column, metric.scale) for m in methods} for name in objects}
    best = {name: significantly_best(draws[name]) for name in objects}
    lines = []
    for method in methods:
        cells = []
        for name in objects:
            status = of[name][method][0]["status"] if of[name][method] else "-"
            published = metric.paper.get(method, {}).get(name)
            paper = "" if published is None else f"{published:.1f}"
            cells.append(_cell(draws[name][method], status, paper, best[name] == method))
        lines.append((method, tuple(cells)))
    if metric.reference and methods:
        known = [row for row in rows if row[metric.reference] is not None]
        scores = [draws_of(select(known, object=name), metric.reference, metric.scale) for name in objects]
        lines.append((TRUTH, tuple(_cell(score, "-") for score in scores)))
    return Table(title, tuple(objects), tuple(lines))


def _over_objects(rows: Sequence[Row], metric: Metric, title: str) -> Table:
    """Means over draws and swept settings first, then quantiles over objects: points of one object are no sample."""
    means = {method: object_means(rows, method, metric.column, metric.scale) for method in methods_of(rows)}
    best = significantly_best(means)
    lines = []
    for method, values in means.items():
        missing = sum(row["method"] == method and row[metric.column] is None for row in rows)
        note = f"{missing} estimates without an answer" if missing else ""
        lines.append((method, _quantiles(values, note, best=method == best)))
    if metric.reference and means:
        lines.append((TRUTH, _quantiles(object_means(rows, None, metric.reference, metric.scale), "", best=False)))
    return Table(title, ("mean", "10\u00a0%", "median", "90\u00a0%", "worst"), tuple(lines))


def object_means(rows: Sequence[Row], method: str | None, column: str, scale: float) -> dict[int, float]:
    """Mean over draws and swept settings, by the object's place; NaN without an answer. None: of any method."""
    values: dict[str, list[float]] = {row["object"]: [] for row in rows}
    for row in rows:
        if method in (None, row["method"]) and row[column] is not None:
            values[row["object"]].append(scale * row[column])
    return {i: float(np.mean(v)) if v else np.nan for i, v in enumerate(values.values())}


def _quantiles(objects: Draws, note: str, *, best: bool) -> tuple[Cell, ...]:
    good = [value for value in objects.values() if not np.isnan(value)]
    rest = np.quantile(good, (0.1, 0.5, 0.9, 1.0)) if good else (np.nan,) * 4
    first = replace(_cell(objects, "-", best=best), note=note)
    return first, *(Cell(number(float(value))) for value in rest)


def _cell(draws: Draws, status: str, paper: str = "", best: bool = False) -> Cell:
    summary = summarize(draws)
    if summary is None:
        return Cell(status, paper=paper)
    note = f"{summary.missing} of {len(draws)} draws without an answer" if summary.missing else ""
    if np.isnan(summary.spread):
        return Cell(number(summary.mean), paper=paper, note=note)
    mean, spread, low, high = (
        number(v, summary.mean) for v in (summary.mean, summary.spread, summary.low, summary.high)
    )
    return Cell(f"{mean} ± {spread}", f"[{low}, {high}]", paper, note, best)


def overview(groups: Mapping[str, Sequence[Row]]) -> Table:
    """Median NAD over objects: methods down, supports and sensings across."""
    methods = list(dict.fromkeys(m for rows in groups.values() for m in methods_of(rows)))
    median: Callable[[Sequence[Row], str], Cell] = lambda rows, m: _median(  # noqa: E731
        list(object_means(rows, m, NAD.column, NAD.scale).values())
    )
    lines = tuple((m, tuple(median(rows, m) for rows in groups.values())) for m in methods)
    return Table("Median over objects of the mean NAD, %", tuple(groups), lines)


def sweep_table(rows: Sequence[Row], axis: str, title: str) -> Table:
    """Median NAD at each value of a swept setting."""
    values = axis_values(rows, axis)
    at = {value: [row for row in rows if row.get(axis) == value] for value in values}
    column = lambda found, m: [NAD.scale * r["nad"] for r in found if r["method"] == m and r["nad"] is not None]  # noqa: E731
    lines = tuple((m, tuple(_median(column(at[value], m)) for value in values)) for m in methods_of(rows))
    return Table(title, tuple(f"{v:g}" if isinstance(v, float) else str(v) for v in values), lines)


def axis_values(rows: Sequence[Row], axis: str) -> list[object]:
    """Values of a swept setting: numbers in order, words as they come."""
    values = list(dict.fromkeys(row[axis] for row in rows if row.get(axis) is not None))
    numbers = all(isinstance(value, int | float) for value in values)
    return sorted(values) if numbers else values


def _median(values: Sequence[float]) -> Cell:
    good = [value for value in values if not np.isnan(value)]
    return Cell(number(float(np.median(good))) if good else "-")
