"""Tables of metrics: methods down; objects, or quantiles over many objects, across."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from estimators.evaluation import paper
from estimators.evaluation.statistics import (
    AXIS,
    SILENT,
    Claims,
    Draws,
    Row,
    Summary,
    axes_of,
    axis_values,
    draws_of,
    methods_of,
    object_means,
    select,
    significantly_best,
    summarize,
)
from testbed.validation import is_number
from viz.values import support_name

MOST_OBJECTS = 12
"""Largest number of objects with a column each."""
TRUTH = "the true masses"
PAPER = "  paper, real robot"
"""Labels of rows without a method: scores of the true masses, and the paper's values of the method above."""


BEYOND = 1000.0
"""Largest mean that is printed; larger ones, as of a predicted pose that is meters off, are "> 1000"."""


@dataclass(frozen=True)
class Metric:
    """A metric of the comparison."""

    column: str
    """Column of the results."""
    title: str
    scale: float
    """Factor from the unit of the results to that of the title."""
    paper: dict[str, dict[str, float]]
    """The paper's values by method and object."""
    reference: str | None = None
    """Column with the score of the true masses."""
    folded: str = ""
    """Summary under which a report folds its table; empty where it is open."""


NAD = Metric("nad", "Normalized absolute difference of the mass distribution (NAD), %", 100.0, paper.NAD)
MPD = Metric(
    "mpd_m",
    "Mean particle distance (MPD) at the end of a turn, open loop, cm",
    100.0,
    paper.MPD,
    "mpd_of_truth_m",
    "Mean particle distance at the end of a turn, open loop: errors grow along the way, of the true masses too",
)
SHORTER_MPDS = tuple(
    Metric(f"mpd_{name}_m", f"{title}, cm", 100.0, {}, f"mpd_{name}_of_truth_m", title)
    for name, title in (
        ("open_loop", "Mean particle distance after 1 s of open loop"),
        ("turn", "Mean particle distance over a whole turn, state reset each step"),
    )
)
METRICS = (NAD, *SHORTER_MPDS, MPD)
HINGES = Metric("hinge_error", "Mean error of the hinges' friction over its mean, %", 100.0, {})
COM = Metric("com_error_m", "Distance of the center of mass from the true one, mm", 1e3, {})
INERTIA = Metric("inertia_error", "I_cm over the true one less 1, %", 100.0, {})


def metrics_of(rows: Sequence[Row]) -> list[Metric]:
    """Metrics with a value in some row; the friction of hinges comes after NAD."""
    values = [(metric, [row.get(metric.column) for row in rows]) for metric in (NAD, HINGES, *METRICS[1:])]
    return [metric for metric, column in values if any(v is not None and math.isfinite(v) for v in column)]


def number(value: float, like: float | None = None) -> str:
    """Text of a value with about three digits: 0.17, 3.46, 23.1, 174; with the decimal places of `like`, if given."""
    if np.isnan(value):
        return "-"
    size = abs(value if like is None else like)
    return f"{value:.{2 if size < 10 else 1 if size < 100 else 0}f}"


@dataclass(frozen=True)
class Entry:
    """A mean over draws or objects, or a text."""

    text: str = ""
    """Text where there is no summary."""
    summary: Summary | None = None
    """Mean, spread and interval."""
    missing: str = ""
    """Number of draws or estimates without an answer, or with the status ok, as text."""
    best: bool = False
    """True if significantly better than every other method."""
    doubted: bool = False
    """True if some of the answers have a status other than ok."""

    @staticmethod
    def of(draws: Draws, status: str = "-", *, best: bool = False) -> Entry:
        """Entry with the summary of draws; with the status where no draw has an answer."""
        summary = summarize(draws)
        if summary is None:
            return Entry(status)
        missing = f"{summary.missing} of {len(draws)} draws without an answer" if summary.missing else ""
        return Entry("", summary, missing, best)

    @property
    def words(self) -> str:
        """Mean and spread, or the text."""
        if self.summary is None:
            return self.text
        mean, spread = self.summary.mean, self.summary.spread
        if mean > BEYOND:
            return f"> {BEYOND:.0f}"
        return number(mean) if np.isnan(spread) else f"{number(mean)} ± {number(spread, mean)}"

    @property
    def interval(self) -> str:
        """Interval of the mean; empty below FEWEST draws."""
        if self.summary is None or np.isnan(self.summary.low):
            return ""
        return f"[{number(self.summary.low, self.summary.mean)}, {number(self.summary.high, self.summary.mean)}]"


@dataclass(frozen=True)
class Table:
    """A table: heads, and rows of labels and cells."""

    title: str
    columns: tuple[str, ...]
    """Heads of the cells."""
    rows: tuple[tuple[tuple[str, ...], tuple[Entry, ...]], ...]
    """Labels and cells of each row."""
    labels: tuple[str, ...] = ("method",)
    """Heads of the labels."""
    note: str = ""
    """A sentence below it."""
    folded: str = ""
    """Summary under which a report folds it, as `Metric.folded`; empty where it is open."""


def metric_table(rows: Sequence[Row], metric: Metric, title: str, objects: Sequence[str] | None = None) -> Table:
    """Table of one metric under one support and sensing: methods down, objects across."""
    methods = _methods_with(rows, metric)
    objects = list(dict.fromkeys(row["object"] for row in rows)) if objects is None else objects
    own = {name: {m: select(rows, object=name, method=m) for m in methods} for name in objects}
    draws = {name: {m: draws_of(own[name][m], metric.column, metric.scale) for m in methods} for name in objects}
    best = {name: significantly_best(draws[name]) for name in objects}
    lines = []
    for method in methods:
        cells = [
            _over_draws(own[name][method], draws[name][method], metric, best=best[name] == method) for name in objects
        ]
        lines.append(((method,), tuple(cells)))
        published = metric.paper.get(method, {})
        if published.keys() & set(objects):
            figures = (f"{published[name]:.1f}" if name in published else "" for name in objects)
            lines.append(((PAPER,), tuple(map(Entry, figures))))
    if metric.reference and methods:
        known = [row for row in rows if row.get(metric.reference) is not None]
        scores = [draws_of(select(known, object=name), metric.reference, metric.scale) for name in objects]
        lines.append(((TRUTH,), tuple(Entry.of(score) for score in scores)))
    counts = (len(draws[name][method]) for name in objects for method in methods)
    note = _one_unknown(rows, objects) if metric is NAD else ""
    return Table(_counted(title, counts, "draw"), tuple(objects), tuple(lines), note=note, folded=metric.folded)


def _over_draws(rows: Sequence[Row], draws: Draws, metric: Metric, *, best: bool) -> Entry:
    """Mean over a method's draws, or its status without an answer; with the count of ok answers where not all are."""
    entry = Entry.of(draws, rows[0]["status"] if rows else "-", best=best)
    good = sum(row["status"] == "ok" for row in rows)
    doubted = metric is NAD and entry.summary is not None and good < len(rows)
    return replace(entry, missing=f"{good} of {len(rows)} ok", doubted=True) if doubted else entry


def _methods_with(rows: Sequence[Row], metric: Metric) -> list[str]:
    """Methods in the rows of a metric; for HINGES, those that report hinges."""
    return methods_of([r for r in rows if metric is not HINGES or is_number(r.get(HINGES.column))])


def _one_unknown(rows: Sequence[Row], objects: Sequence[str]) -> str:
    """Note on the objects with two groups, whose total mass M leaves one unknown; empty without such objects."""
    group_names = {row["object"]: row.get("group_names") for row in rows}
    pairs = [name for name in objects if (groups := group_names.get(name)) is not None and len(groups) == 2]
    return f"{', '.join(pairs)}: two masses, so one unknown where M is given" if pairs else ""


def _counted(title: str, counts: Iterable[int], unit: str) -> str:
    """Title with the range of the sample sizes of its means."""
    sizes = sorted({count for count in counts if count})
    words = " to ".join(dict.fromkeys(map(str, (*sizes[:1], *sizes[-1:]))))
    return f"{title}; {words} {unit}{'s' if sizes[-1] > 1 else ''}" if sizes else title


def over_objects(rows: Sequence[Row], metric: Metric, title: str) -> Table:
    """Table of one metric under one support and sensing: methods down, mean and quantiles over objects across.

    Each object counts once, with its mean over draws and swept settings, which are no independent samples.
    """
    means = {method: object_means(rows, method, metric.column, metric.scale) for method in _methods_with(rows, metric)}
    best = significantly_best(means)
    lines = []
    for method, values in means.items():
        missing = sum(row["method"] == method and row[metric.column] is None for row in rows)
        words = f"{missing} estimates without an answer" if missing else ""
        lines.append(((method,), _quantiles(values, words, best=method == best)))
    if metric.reference and means:
        truth = object_means(rows, None, metric.reference, metric.scale)
        lines.append(((TRUTH,), _quantiles(truth, "", best=False)))
    title = _counted(title, map(len, means.values()), "object")
    return Table(title, ("mean", "10\u00a0%", "median", "90\u00a0%", "worst"), tuple(lines), folded=metric.folded)


def _quantiles(objects: Draws, missing: str, *, best: bool) -> tuple[Entry, ...]:
    """Mean, 10 %, 50 % and 90 % quantile and maximum over objects."""
    known = [value for value in objects.values() if not np.isnan(value)]
    quantiles = np.quantile(known, (0.1, 0.5, 0.9, 1.0)) if known else (np.nan,) * 4
    mean = replace(Entry.of(objects, best=best), missing=missing)
    return mean, *(Entry(number(float(value))) for value in quantiles)


def by_setting(rows: Sequence[Row]) -> dict[tuple[str, str], list[Row]]:
    """Rows under each support and sensing, in the order of the rows."""
    settings = dict.fromkeys((row["support"], row["sensing"]) for row in rows)
    return {(support, sensing): select(rows, support=support, sensing=sensing) for support, sensing in settings}


def points_of(rows: Sequence[Row]) -> dict[str, list[Row]]:
    """Rows by support, sensing and point of a sweep; names list the settings that vary."""
    axes = axes_of(rows)
    fields = {axis: axis.rpartition(".")[2] for axis in axes}
    swept = [[f"{field} {_setting(row.get(axis))}" for axis, field in fields.items()] for row in rows]
    words = [(support_name(row["support"]), row["sensing"], *own) for row, own in zip(rows, swept, strict=True)]
    varied = [len(set(each)) > 1 for each in zip(*words, strict=True)]
    groups: dict[str, list[Row]] = {}
    for row, own in zip(rows, words, strict=True):
        name = [word for word, differs in zip(own, varied, strict=True) if differs] or own[:2]
        groups.setdefault(", ".join(name), []).append(row)
    return groups


def overview(groups: Mapping[str, Sequence[Row]]) -> Table:
    """Table of the median NAD over objects: methods down, groups of rows across, and the paper's own values.

    Methods are sorted by their number of estimates without a NAD, then by their median in the first group.

    Args:
        groups: rows by the name of their support, sensing or point of a sweep.
    """
    methods = list(dict.fromkeys(m for rows in groups.values() for m in methods_of(rows)))
    lines = {method: [_over_objects(rows, method) for rows in groups.values()] for method in methods}

    def place(method: str) -> tuple[float, ...]:
        lost = sum(row["method"] == method and row["nad"] is None for rows in groups.values() for row in rows)
        return lost, *(math.inf if cell.text == "-" else float(cell.text) for cell in lines[method])

    best = sorted(methods, key=place)
    objects = {row["object"] for rows in groups.values() for row in rows}
    published = {m: [nad for name, nad in NAD.paper.get(m, {}).items() if name in objects] for m in best}
    columns = tuple(groups)
    if any(published.values()):
        columns = (*columns, PAPER.strip())
        for method in best:
            lines[method].append(Entry(number(float(np.median(published[method]))) if published[method] else ""))
    some = any(cell.missing for m in best for cell in lines[m])
    note = "ok: number of answers with the status ok; do not use the others" if some else ""
    return Table(
        "Normalized absolute difference (NAD), median over objects, %",
        columns,
        tuple(((m,), tuple(lines[m])) for m in best),
        note=note,
    )


def _over_objects(rows: Sequence[Row], method: str) -> Entry:
    """Median over objects of the mean NAD over draws; with the count of ok answers where not all are."""
    own = [row for row in rows if row["method"] == method]
    good = sum(row["status"] == "ok" for row in own)
    median = _median(object_means(rows, method, NAD.column, NAD.scale).values())
    return replace(median, missing=f"{good} of {len(own)} ok" if good < len(own) else "")


def percent(part: float) -> str:
    """Text of a fraction in whole percent."""
    return f"{100 * part:.0f} %"


def sweep_table(rows: Sequence[Row], axis: str, title: str) -> Table:
    """Table of the median NAD over objects by value of a swept setting; of words, values down, with claims."""
    values = axis_values(rows, axis)
    if any(isinstance(value, str) for value in values):
        return _sources_table(rows, axis, title)
    at = {value: [row for row in rows if row.get(axis) == value] for value in values}
    lines = tuple(((m,), tuple(_over_objects(at[value], m) for value in values)) for m in methods_of(rows))
    return Table(title, tuple(f"{v:g}" if isinstance(v, float) else str(v) for v in values), lines)


def _sources_table(rows: Sequence[Row], axis: str, title: str) -> Table:
    """Table of a setting of words: values down, methods across; median NAD over objects, error over claimed error."""
    methods, lines = methods_of(rows), []
    for value in axis_values(rows, axis):
        own, cells = [row for row in rows if row.get(axis) == value], []
        for method in methods:
            claims, nad = Claims.of([row for row in own if row["method"] == method]), _over_objects(own, method)
            cells.append(replace(nad, text=nad.text + (f" ({claims.ratio:.1f})" if claims else "")))
        lines.append(((str(value),), tuple(cells)))
    return Table(title, tuple(methods), tuple(lines), note="in brackets: error over claimed error, root mean square")


def _median(values: Iterable[float]) -> Entry:
    good = [value for value in values if not np.isnan(value)]
    return Entry(number(float(np.median(good))) if good else "-")


def quantile_table(results: Sequence[Row], metric: Metric) -> Table:
    """Quantiles of one metric over objects: a row per support, sensing, point of the sweep and method.

    Each object counts once, with the mean over its draws.
    """
    axes = axes_of(results)
    estimates = [row for row in results if row["status"] != "infeasible"]
    lines = []
    for kind in dict.fromkeys(
        (row["support"], row["sensing"], *(row[a] for a in axes), row["method"]) for row in estimates
    ):
        support, sensing, *point, method = kind
        rows = select(estimates, support=support, sensing=sensing, method=method, **dict(zip(axes, point, strict=True)))
        names = dict.fromkeys(row["object"] for row in rows)
        means = [summarize(draws_of(select(rows, object=name), metric.column, metric.scale)) for name in names]
        values = [mean.mean for mean in means if mean is not None]
        missing = sum(row.get(metric.column) is None for row in rows)
        texts = ["-"] * 4
        if values:
            texts = [short(float(q)) for q in (*np.quantile(values, (0.1, 0.5, 0.9)), np.mean(values))]
        labels = (support_name(support), sensing, *(_setting(value) for value in point), method)
        claims = Claims.of(rows) if metric is NAD else None
        texts += [f"{claims.ratio:.2f}", percent(claims.held)] if claims else ["", ""] if metric is NAD else []
        cells = (str(len(names)), *texts, f"{missing} of {len(rows)}" if missing else "")
        lines.append((labels, tuple(Entry(text) for text in cells)))
    heads = ("support", "sensing", *(axis.removeprefix(AXIS) for axis in axes), "method")
    of_claims = ("error / claimed", "90 % hold") if metric is NAD else ()
    columns = ("objects", "10 %", "median", "90 %", "mean", *of_claims, "no answer")
    return Table(f"{metric.title}, over objects", columns, tuple(lines), heads)


def _setting(value: object) -> str:
    return f"{value:.12g}" if isinstance(value, float) else str(value)


def short(value: float) -> str:
    """Text of a value with about two digits."""
    return f"{value:.0f}" if value >= 10 else f"{value:.1f}"


def hidden_table(results: Iterable[Row], objects: Sequence[str]) -> Table:
    """Table of the mean absolute errors of the center of mass and of I_cm over draws, under own weight."""
    own = select(results, support="own_weight", kind="hidden_states")
    rows = [row for row in own if row["status"] in ("ok", "unexplained", "not_converged")]
    methods = methods_of(rows)
    lines = []
    for column, scale, label in (("com_error_m", 1e3, "c, mm"), ("inertia_error", 100, "I_cm, %")):
        for sensing, method in product(dict.fromkeys(row["sensing"] for row in rows), methods):
            cells = []
            for name in objects:
                found = select(rows, object=name, sensing=sensing, method=method)
                values = np.array(list(draws_of(found, column, scale).values()))
                known = np.abs(values[~np.isnan(values)])
                confounded = any("confounded" in row["unobserved"] for row in found)
                cells.append(
                    Entry(f"{known.mean():.2f}" if len(known) else "confounded" if confounded else "unobserved")
                )
            named = f", {method}" if len(methods) > 1 else ""
            lines.append(((f"{label}, {sensing}{named}",), tuple(cells)))
    return Table("Hidden states, own weight: mean error", tuple(objects), tuple(lines), ("",))


CLAIMS = "Errors of the masses over those claimed"


def claims_table(rows: Sequence[Row], title: str = CLAIMS) -> Table | None:
    """Table of errors relative to claimed errors: a row per method; None where no method claims errors."""
    lines = []
    for method in methods_of(rows):
        own = select(rows, method=method)
        if (found := Claims.of(own)) is not None:
            good = sum(row["status"] == "ok" for row in own)
            misfit = [row["misfit"] for row in own if row.get("misfit") is not None]
            claims = (f"{found.ratio:.2f}", percent(found.held), percent(good / len(own)), percent(found.silent))
            cells = (*claims, f"{np.median(misfit):.2g}" if misfit else "-")
            lines.append(((method,), tuple(map(Entry, cells))))
    off = f"status ok, and a group off by over {SILENT:g} claimed errors"
    note = f"errors without bound are left out; silent, as a part of the answers with errors: {off}"
    columns = ("error / claimed", "90 % intervals hold", "status ok", "silent", "misfit")
    return Table(title, columns, tuple(lines), note=note) if lines else None
