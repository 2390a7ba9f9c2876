"""Results as tables: methods down, objects across; ours, and in the same cell the paper's."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from rich import box
from rich.table import Table
from rich.text import Text

from estimators.evaluation import paper
from estimators.evaluation.statistics import (
    AXIS,
    Draws,
    Row,
    axes_of,
    draws_of,
    select,
    significantly_best,
    summarize,
)

SUPPORT_NAMES = {"own_weight": "own weight", "rigid": "rigid body"}


@dataclass(frozen=True)
class Metric:
    """One measure of the comparison."""

    column: str
    """In the results."""
    title: str
    scale: float
    """From the results' unit to the title's."""
    paper: dict[str, dict[str, float]]
    reference: str | None = None
    """Column with what the truth itself would score."""


NAD = Metric("nad", "Normalized absolute difference of the mass distribution (NAD), %", 100.0, paper.NAD)
MPD_OPEN_LOOP = Metric(
    "mpd_open_loop_m",
    "Mean particle distance (MPD) after 1 s of open loop, cm",
    100.0,
    paper.MPD,
    "mpd_open_loop_of_truth_m",
)
MPD_TURN = Metric(
    "mpd_turn_m",
    "Mean particle distance (MPD) over a whole turn, state reset each step, cm",
    100.0,
    paper.MPD,
    "mpd_turn_of_truth_m",
)
METRICS = (NAD, MPD_OPEN_LOOP, MPD_TURN)


def metric_table(results: Iterable[Row], metric: Metric, support: str, sensing: str, objects: list[str]) -> Table:
    """One metric under one support and sensing. Cells: mean and spread over draws; interval; the paper's figure."""
    rows = select(results, support=support, sensing=sensing)
    table = _table(f"{metric.title}: {SUPPORT_NAMES.get(support, support)}, {sensing}", objects)
    methods = list(dict.fromkeys(row["method"] for row in rows))
    of = {name: {m: select(rows, object=name, method=m) for m in methods} for name in objects}
    draws = {name: {m: draws_of(of[name][m], metric.column, metric.scale) for m in methods} for name in objects}
    best = {name: significantly_best(draws[name]) for name in objects}
    for method in methods:
        cells = []
        for name in objects:
            cell = _cell(draws[name][method], best=best[name] == method)
            if cell is None:
                cell = Text(of[name][method][0]["status"] if of[name][method] else "-")
            published = metric.paper.get(method, {}).get(name)
            if published is not None:
                cell.append(f"\npaper {published}", style="dim not bold")
            cells.append(cell)
        table.add_row(method, *cells)
    if metric.reference and methods:
        table.add_section()
        scores = [draws_of(of[name][methods[0]], metric.reference, metric.scale) for name in objects]
        table.add_row("the true masses", *(_cell(score, best=False) or "-" for score in scores), style="dim")
    return table


def quantile_table(results: Sequence[Row], metric: Metric) -> Table:
    """One metric over many objects: a row a support, sensing, point of the sweep and method; quantiles over objects.

    The draws of an object count as their mean, so that every object weighs the same.
    """
    table = Table(
        title=f"{metric.title}, over objects", title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    axes = axes_of(results)
    for column in ("support", "sensing", *(axis.removeprefix(AXIS) for axis in axes), "method"):
        table.add_column(column, no_wrap=True)
    for column in ("objects", "10 %", "median", "90 %", "mean", "no answer"):
        table.add_column(column, justify="right", no_wrap=True)
    asked = [row for row in results if row["status"] != "infeasible"]
    for kind in dict.fromkeys(
        (row["support"], row["sensing"], *(row[a] for a in axes), row["method"]) for row in asked
    ):
        support, sensing, *point, method = kind
        rows = select(asked, support=support, sensing=sensing, method=method, **dict(zip(axes, point, strict=True)))
        names = dict.fromkeys(row["object"] for row in rows)
        means = [summarize(draws_of(select(rows, object=name), metric.column, metric.scale)) for name in names]
        values = [mean.mean for mean in means if mean is not None]
        missing = sum(row.get(metric.column) is None for row in rows)
        cells = (
            [_short(float(q)) for q in (*np.quantile(values, (0.1, 0.5, 0.9)), np.mean(values))]
            if values
            else ["-"] * 4
        )
        said = [SUPPORT_NAMES.get(support, support), sensing, *(_told(v) for v in point), method]
        table.add_row(*said, str(len(names)), *cells, f"{missing} of {len(rows)}" if missing else "")
    return table


def _told(value: object) -> str:
    return f"{value:g}" if isinstance(value, int | float) and not isinstance(value, bool) else str(value)


def hidden_table(results: Iterable[Row], objects: list[str]) -> Table:
    """Errors of the centre of mass and of I_cm where groups rest on their own weight: mean size over the draws."""
    table = _table("Hidden states, own weight: mean error", objects)
    rows = select(results, support="own_weight", status="ok", kind="hidden_states")
    for column, scale, label in (("com_error_m", 1e3, "c, mm"), ("inertia_error", 100, "I_cm, %")):
        for sensing in dict.fromkeys(row["sensing"] for row in rows):
            cells = []
            for name in objects:
                found = select(rows, object=name, sensing=sensing)
                values = np.array(list(draws_of(found, column, scale).values()))
                seen = np.abs(values[~np.isnan(values)])
                confounded = any("confounded" in row["unobserved"] for row in found)
                cells.append(f"{seen.mean():.2f}" if len(seen) else "confounded" if confounded else "not felt")
            table.add_row(f"{label}, {sensing}", *cells)
    return table


def _table(title: str, objects: list[str]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True, min_width=20)
    for name in objects:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _cell(draws: Draws, *, best: bool) -> Text | None:
    """ "0.6±0.3", and below it "[0.4 0.9]"; "-n" counts draws without an answer, "*" marks what is best for sure."""
    summary = summarize(draws)
    if summary is None:
        return None
    missing = f" -{summary.missing}" if summary.missing else ""
    if np.isnan(summary.spread):
        return Text(f"{summary.mean:.2f}{missing}")
    text = f"{_short(summary.mean)}±{_short(summary.spread)}{'*' if best else ''}{missing}"
    interval = f"\n[{_short(summary.low)} {_short(summary.high)}]"
    return Text.assemble((text, "bold" if best else ""), (interval, "dim"))


def _short(number: float) -> str:
    """Two digits or so."""
    return f"{number:.0f}" if number >= 10 else f"{number:.1f}"
