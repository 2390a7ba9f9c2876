"""Lists of the report: the worst estimates, and the failures."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from estimators.evaluation.statistics import AXIS, Row, axes_of
from viz.report.tables import number
from viz.values import support_name

MOST_NAMES = 12
"""Largest number of objects of a failure that are named."""
NUMBERS = re.compile(r"[-+]?\d[\d.]*(e[-+]?\d+)?")
"""Numbers within a reason."""
CLAUSE = re.compile(r"[:;(]")
"""End of a reason's first clause."""


@dataclass(frozen=True)
class Worst:
    """One of the worst estimates."""

    row: Row
    nad: str
    """NAD [%]."""
    support: str
    swept: str
    """Swept settings and their values."""
    key: str
    """Folder of the estimate; empty where not known."""
    trials: tuple[str, ...]
    """Folders of its trials."""
    recording: str
    """Path of its recording; empty where there is none."""


@dataclass(frozen=True)
class FailedEstimates:
    """Estimates that are not ok for the same reason."""

    method: str
    """Method, or several."""
    status: str
    message: str
    count: int
    where: str
    """Supports and sensings."""
    objects: str
    traceback: str
    """Traceback at the end of the run; empty where there is none."""
    path: str
    """File with the traceback."""

    @property
    def line(self) -> str:
        """Method, number, status, objects, setting and reason."""
        place = "; ".join(filter(None, (self.objects, self.where)))
        return f"{self.method}: {self.count} {self.status} ({place}): {self.message}"


def worst_of(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """The ten estimates with the greatest NAD, and the five of the hidden states."""
    ranked = sorted((row for row in rows if row["nad"] is not None), key=lambda row: -row["nad"])
    return ranked[:10], [row for row in ranked if row["kind"] == "hidden_states"][:5]


def worst(rows: Sequence[Row], recording_of: Callable[[str], str]) -> list[Worst]:
    """Estimates with their files."""
    axes = axes_of(rows)
    return [
        Worst(
            row=row,
            nad=number(100 * row["nad"]),
            support=support_name(row["support"]),
            swept=", ".join(f"{a.removeprefix(AXIS)} = {row[a]}" for a in axes if row.get(a) is not None),
            key=(key := row["key"] or ""),
            trials=() if row["trial_keys"] is None else tuple(row["trial_keys"]),
            recording=recording_of(key) if key else "",
        )
        for row in rows
    ]


def failures(rows: Sequence[Row], tracebacks: Mapping[str, str]) -> list[FailedEstimates]:
    """Estimates that are not ok, by method, status and reason; the most frequent first.

    Answers of any method whose reasons begin alike, but for numbers, count as one: the first is shown.
    """
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row["status"] != "ok":
            method, message = row["method"], row["message"] or ""
            if row["status"] != "failed":
                method, message = "", NUMBERS.sub("", CLAUSE.split(message)[0])
            found.setdefault((method, row["status"], message), []).append(row)
    listed = []
    for (_, status, _), of in sorted(found.items(), key=lambda item: -len(item[1])):
        message, method = of[0]["message"] or "", names(list(dict.fromkeys(row["method"] or "" for row in of)))
        where = dict.fromkeys(", ".join(filter(None, (support_name(row["support"]), row["sensing"]))) for row in of)
        objects = names(list(dict.fromkeys(row["object"] for row in of)))
        path = _traceback_of(of, status, message, tracebacks)
        trace = tracebacks.get(path, "")
        listed.append(
            FailedEstimates(method or "every method", status, message, len(of), "; ".join(where), objects, trace, path)
        )
    return listed


def names(every: Sequence[str]) -> str:
    """The first few, and how many more."""
    more = f" and {len(every) - MOST_NAMES} more" if len(every) > MOST_NAMES else ""
    return ", ".join(every[:MOST_NAMES]) + more


def _traceback_of(rows: Sequence[Row], status: str, message: str, tracebacks: Mapping[str, str]) -> str:
    """Path of a traceback of these rows, or of one that ends in their message."""
    paths = [f"estimates/{row.get('key')}/error.txt" for row in rows]
    known = [path for path in paths if path in tracebacks]
    if status == "failed" and message:
        known += [path for path, text in tracebacks.items() if text.rstrip().endswith(message)]
    return known[0] if known else ""
