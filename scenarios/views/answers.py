"""Answers of a results folder: for the terminal, as a table and as plain data."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from estimators.base import Estimate
from estimators.evaluation.statistics import Row
from estimators.posterior.support import DECISIVE, EVIDENCE, SupportTest
from scenarios.results.estimates import load_estimate
from scenarios.results.table import has_files
from scenarios.views.values import estimate_view
from testbed.files import write_text, write_whole
from viz.report.answers import Answer, answer_fields, answer_rows


def answers_of(folder: Path, rows: Sequence[Row]) -> list[list[Answer]]:
    """Answers of the rows with stored files, by object and support.

    Raises:
        HeftError: a file of an estimate is damaged.
    """
    groups: dict[tuple[Any, Any], list[Answer]] = {}
    for row in rows:
        if has_files(row):
            groups.setdefault((row["object"], row["support"]), []).append(_answer(folder, row))
    return list(groups.values())


def write_answers(folder: Path, groups: Sequence[Sequence[Answer]]) -> list[Path]:
    """Write masses.csv, one row per quantity, and masses.json into a results folder; returns their paths."""
    answers = [answer for group in groups for answer in group]
    table, fields = pd.DataFrame(answer_rows(answers)), [answer_fields(answer) for answer in answers]
    write_whole(folder / "masses.csv", lambda part: table.to_csv(part, index=False))
    write_text(folder / "masses.json", json.dumps(fields, indent=1))
    return [folder / "masses.csv", folder / "masses.json"]


def support_verdict(estimate: Estimate) -> tuple[str, str]:
    """Verdict of the trials on the support in one to three words, and in a sentence, empty without a test."""
    numbers = estimate.diagnostics
    if any(name not in numbers for name in EVIDENCE):
        return ("assumed" if estimate.assumes else "not tested"), ""
    if estimate.status == "assumption_violated":
        return "not own weight", estimate.message
    kind = "own_weight" if numbers["log10_bayes_factor"] > DECISIVE else "undecided"
    factor, share, error = (numbers[name] for name in EVIDENCE)
    return kind.replace("_", " "), SupportTest(kind, factor, share, error).sentence


def _answer(folder: Path, row: Row) -> Answer:
    view, estimate = estimate_view(folder, row), load_estimate(folder, row["key"])
    verdict, evidence = support_verdict(estimate)
    misfit = row.get("misfit")
    return Answer(
        str(row["object"]),
        str(row["support"]),
        str(row["method"]),
        estimate.status,
        estimate.message,
        view.shape,
        estimate.distribution,
        estimate.covariance,
        math.nan if misfit is None else float(misfit),
        verdict,
        evidence,
    )
