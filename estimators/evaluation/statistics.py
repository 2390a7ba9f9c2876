"""Statistics over draws: mean, spread, interval of the mean, and the significantly best method."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import stats

LEVEL = 0.95
"""Level of the interval of a mean."""
FEWEST = 5
"""Least number of draws for an interval or a test."""
SIGNIFICANT = 0.05
"""Probability by chance below which a paired difference counts."""
NINETY = float(stats.norm.isf(0.05))
"""Standard errors within which 90 % of normal errors lie."""
ROUNDING = 1e-9
"""Relative difference up to which two values are equal."""
SILENT = 3.0
"""Claimed errors beyond which an answer with status ok is silently wrong."""
Row = Mapping[str, Any]
"""Row of results.parquet: one estimate of a run."""
AXIS = "axis."
"""Prefix of the column of a swept field."""
Draws = Mapping[int, float]
"""Number of each draw by its seed; NaN without an answer."""


@dataclass(frozen=True)
class Summary:
    """Summary of one method on one object over N draws."""

    count: int
    """Number of draws with an answer."""
    mean: float
    spread: float
    """Standard deviation over draws; NaN for a single one."""
    low: float
    high: float
    """Interval of the mean at LEVEL by Student's t distribution, not below 0 if no draw is; NaN below FEWEST draws."""
    missing: int
    """Number of draws without an answer."""


def axis_columns(axes: Mapping[str, Any]) -> dict[str, Any]:
    """Columns of a row for the swept settings; tables and lists as text, a list of one as its item."""
    return {f"{AXIS}{name}": _in_words(value) for name, value in axes.items()}


def _in_words(value: Any) -> Any:
    if isinstance(value, list | tuple):
        return _in_words(value[0]) if len(value) == 1 else ", ".join(map(str, value)) or "none"
    if isinstance(value, dict):
        return ", ".join(f"{name} = {each}" for name, each in value.items()) or "none"
    return value


def axes_of(rows: Sequence[Row]) -> list[str]:
    """Columns with a swept setting that some row has."""
    columns = dict.fromkeys(name for row in rows for name in row if name.startswith(AXIS))
    return [name for name in columns if any(row.get(name) is not None for row in rows)]


def axis_values(rows: Sequence[Row], axis: str) -> list[object]:
    """Values of a swept setting: numbers in order, words as they come."""
    values = list(dict.fromkeys(row[axis] for row in rows if row.get(axis) is not None))
    numbers = all(isinstance(value, int | float) for value in values)
    return sorted(values) if numbers else values


def methods_of(rows: Iterable[Row]) -> list[str]:
    """Names of the methods, in the order of the rows."""
    return list(dict.fromkeys(row["method"] for row in rows))


def select(rows: Iterable[Row], **equal: object) -> list[Row]:
    """Rows whose columns have the given values."""
    return [row for row in rows if all(row.get(column) == value for column, value in equal.items())]


def assumptions(rows: Iterable[Row]) -> list[str]:
    """A sentence for each assumption that answers rest on and no trial tested, with their methods."""
    by: dict[str, dict[str, None]] = {}
    for row in rows:
        if row.get("assumes"):
            by.setdefault(row["assumes"], {})[row["method"]] = None
    return [f"Assumed, not tested: {what} ({', '.join(methods)})." for what, methods in by.items()]


def draws_of(rows: Iterable[Row], column: str, scale: float = 1.0) -> dict[int, float]:
    """Column times `scale`, by draw; NaN where it is missing."""
    return {row["seed"]: np.nan if row.get(column) is None else scale * row[column] for row in rows}


def object_means(rows: Sequence[Row], method: str | None, column: str, scale: float) -> dict[int, float]:
    """Mean over draws and swept settings by index of the object, NaN without an answer; over all methods for None."""
    values: dict[str, list[float]] = {row["object"]: [] for row in rows}
    for row in rows:
        if method in (None, row["method"]) and row[column] is not None:
            values[row["object"]].append(scale * row[column])
    return {i: float(np.mean(v)) if v else np.nan for i, v in enumerate(values.values())}


def summarize(draws: Draws) -> Summary | None:
    """Summary of draws; None where no draw has an answer."""
    values = np.array(list(draws.values()), dtype=float)
    good = values[~np.isnan(values)]
    missing = len(values) - len(good)
    if len(good) == 0:
        return None
    low = high = np.nan
    if len(good) >= FEWEST:
        half = float(stats.t.isf((1 - LEVEL) / 2, len(good) - 1) * stats.sem(good))
        low, high = max(good.mean() - half, min(good.min(), 0.0)), good.mean() + half
    spread = float(good.std(ddof=1)) if len(good) > 1 else np.nan
    return Summary(len(good), float(good.mean()), spread, float(low), float(high), missing)


@dataclass(frozen=True)
class Claims:
    """Errors of the masses relative to the errors that their answers claim."""

    count: int
    """Number of answers that claim a finite error of a known mass."""
    ratio: float
    """Root mean square of error over claimed error; errors without bound are left out."""
    held: float
    """Part of the 90 % intervals that hold the true mass; errors without bound are left out."""
    silent: float
    """Part of these answers with status ok and a group off by more than SILENT claimed errors."""

    @staticmethod
    def of(rows: Iterable[Row]) -> Claims | None:
        """Claims of the answers in `rows`; None without an answer that claims a finite error of a known mass."""
        needed = "mass_kg", "mass_error_kg", "true_mass_kg"
        each, silent = [], []
        for row in rows:
            if any(row.get(name) is None for name in needed):
                continue
            error = np.array(row["mass_error_kg"], dtype=float)  # None for a mass that is not observed
            if (finite := np.isfinite(error)).any():
                wrong = np.abs(np.subtract(row["mass_kg"], row["true_mass_kg"]))
                each.append(wrong[finite] / np.maximum(error[finite], 1e-12))
                silent.append(row["status"] == "ok" and each[-1].max() > SILENT)
        if not each:
            return None
        off = np.concatenate(each)
        return Claims(len(each), float(np.sqrt(np.mean(off**2))), float(np.mean(off < NINETY)), float(np.mean(silent)))


def significantly_best(methods: Mapping[str, Draws]) -> str | None:
    """Method with the least mean, if it beats every other by a t-test of the differences, paired by draw.

    A method without any answer is left out, and so is a draw that a method has no answer to. None below FEWEST draws.
    """
    answered = {name: draws for name, draws in methods.items() if not all(np.isnan(v) for v in draws.values())}
    seeds = sorted(set.intersection(*(set(draws) for draws in answered.values()))) if answered else []
    table = np.array([[draws[seed] for seed in seeds] for draws in answered.values()])
    table = table[:, ~np.isnan(table).any(axis=0)] if table.size else table
    if len(answered) < 2 or table.shape[1] < FEWEST:
        return None
    best = int(table.mean(axis=1).argmin())
    beaten = [_smaller(table[best], other) for other in np.delete(table, best, axis=0)]
    return list(answered)[best] if all(beaten) else None


def _smaller(first: Sequence[float], second: Sequence[float]) -> bool:
    difference = np.subtract(second, first)
    if np.abs(difference).max() <= ROUNDING * np.abs(second).max():
        return False
    if np.ptp(difference) == 0:
        return bool(difference[0] > 0)
    chance = np.asarray(stats.ttest_1samp(difference, 0.0, alternative="two-sided"))[1]
    return bool(difference.mean() > 0 and chance < SIGNIFICANT)
