"""Lists of the report: the worst estimates, and the failures."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from estimators.evaluation.statistics import AXIS, Row, axes_of
from viz.report.tables import number
from viz.values import support_name

MOST_NAMES = 12
"""Largest number of names in a list of objects, supports or methods."""
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
    """Folder of the estimate; empty where unknown."""
    trials: tuple[str, ...]
    """Folders of its trials."""
    recording: str
    """Path of its recording; empty without a recording."""


@dataclass(frozen=True)
class FailedEstimates:
    """Estimates that are not ok for the same reason."""

    method: str
    """Names of the methods."""
    status: str
    message: str
    count: int
    where: str
    """Supports and sensings."""
    objects: str
    traceback: str
    """Traceback of one of the estimates; empty without any."""
    path: str
    """File with the traceback."""

    @property
    def line(self) -> str:
        """Method, count, status, objects, setting and reason in one line."""
        place = "; ".join(filter(None, (self.objects, self.where)))
        return f"{self.method}: {self.count} {self.status} ({place}): {self.message}"


def worst_of(rows: Sequence[Row]) -> tuple[list[Row], list[Row]]:
    """The ten estimates with the largest NAD, and the five with the largest NAD of the hidden states."""
    ranked = sorted((row for row in rows if row["nad"] is not None), key=lambda row: -row["nad"])
    return ranked[:10], [row for row in ranked if row["kind"] == "hidden_states"][:5]


def worst(rows: Sequence[Row], recording_of: Callable[[str], str]) -> list[Worst]:
    """Entries of estimates, with the paths of their files."""
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

    Estimates with a status other than "failed" share an entry, over all methods, if the first clauses of their reasons
    differ at most in numbers; the entry shows the first reason.
    """
    found: dict[tuple[str, str, str], list[Row]] = {}
    for row in rows:
        if row["status"] != "ok":
            method, message = row["method"], row["message"] or ""
            if row["status"] != "failed":
                method, message = "", NUMBERS.sub("", CLAUSE.split(message)[0])
            found.setdefault((method, row["status"], message), []).append(row)
    listed = []
    for (_, status, _), alike in sorted(found.items(), key=lambda item: -len(item[1])):
        message, method = alike[0]["message"] or "", names(list(dict.fromkeys(row["method"] or "" for row in alike)))
        where = dict.fromkeys(", ".join(filter(None, (support_name(row["support"]), row["sensing"]))) for row in alike)
        objects = names(list(dict.fromkeys(row["object"] for row in alike)))
        path = _traceback_of(alike, status, message, tracebacks)
        trace, count = tracebacks.get(path, ""), len(alike)
        listed.append(
            FailedEstimates(method or "every method", status, message, count, "; ".join(where), objects, trace, path)
        )
    return listed


def names(texts: Sequence[str]) -> str:
    """The first MOST_NAMES texts in a line, and the number of the others."""
    more = f" and {len(texts) - MOST_NAMES} more" if len(texts) > MOST_NAMES else ""
    return ", ".join(texts[:MOST_NAMES]) + more


def _traceback_of(rows: Sequence[Row], status: str, message: str, tracebacks: Mapping[str, str]) -> str:
    """Path of a traceback of these rows, else of one that ends in their message, else empty."""
    paths = [f"estimates/{row.get('key')}/error.txt" for row in rows]
    known = [path for path in paths if path in tracebacks]
    if status == "failed" and message:
        known += [path for path, text in tracebacks.items() if text.rstrip().endswith(message)]
    return known[0] if known else ""
