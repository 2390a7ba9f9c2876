"""`heft score`: scores of answers to a benchmark, as tables and JSON."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from scenarios.cli.terminal import open_console
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from rich.table import Table

    from scenarios.benchmark.answers import Answer
    from scenarios.benchmark.dataset import Benchmark, Truth

EVEN = "even masses"
"""Name of the answer that every mass is as large as its part of the area: the reference."""
MOST_NAMED = 3
"""Problems that a line names."""
COLUMNS = {
    "problems": ("problems", 1.0, ".0f"),
    "answered": ("ok, %", 100.0, ".0f"),
    "nad": ("NAD, %", 100.0, ".3g"),
    "nad_median": ("median", 100.0, ".3g"),
    "com_error_m": ("c, mm", 1e3, ".2g"),
    "inertia_error": ("I, %", 100.0, ".2g"),
    "held": ("90 % hold", 100.0, ".0f"),
    "interval_score": ("interval, %", 100.0, ".3g"),
    "silent": ("silent, %", 100.0, ".0f"),
    "robot_s": ("robot, s", 1.0, ".0f"),
}
"""Heading, factor and format of each figure."""
NOTES = (
    "NAD: mean and median; c, I: median errors of center of mass and inertia; interval: mean interval score of 90 % "
    "intervals over the object's mass, less is better; silent: of the answers that claim errors, those with status ok "
    "and a mass off by more than 3 of them; -: no errors claimed. A missing answer counts as even masses."
)


def score(
    answers: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="ANSWERS.csv ...")],
    *,
    benchmark: Annotated[Path, tyro.conf.arg(metavar="DIR")],
    truth: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    split: Annotated[str | None, tyro.conf.arg(metavar="SPLIT")] = None,
    json: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Score answers to a benchmark by world and kind of trial, and compare several files.

    Examples: heft score mine.csv --benchmark results/benchmark
              heft score results/answers/*.csv --benchmark results/benchmark --json scores.json

    Args:
        answers: CSV files with the columns problem, group, mass_kg, error_kg, status; the last two are optional.
        benchmark: folder of the published benchmark.
        truth: truth of the test split; without it, only train and validation can be scored.
        split: split to score; default: the split of the answers.
        json: output file with all scores and one row per problem.
    """
    from json import dumps

    from scenarios.benchmark import score as scoring
    from scenarios.benchmark.answers import read_answers
    from scenarios.benchmark.dataset import Benchmark
    from scenarios.results.files import plain
    from testbed.files import write_text

    opened = Benchmark.open(benchmark)
    given = {path.stem: read_answers(path, opened.problems) for path in answers}
    if len(given.keys() - {EVEN}) < len(answers):
        allowed = f"files of different names, none of them {EVEN}, which is the reference's"
        raise InvalidValueError("ANSWERS.csv", [str(path) for path in answers], allowed)
    known = scoring.truths(opened, truth)
    chosen = split or _split_of(opened, given, known)
    rows = {name: scoring.score(opened, each, known, chosen) for name, each in given.items()}
    for name, each in rows.items():
        if missing := [row["problem"] for row in each if not row["answered"]]:
            count = f"{len(missing)} of {len(each)} problems"
            print(f"{name}: {count} have no answer and count as even masses: {', '.join(missing[:MOST_NAMED])}")
    for name, each in given.items():
        splits = [opened.problems[problem].split for problem in each]
        if left := sum(one != chosen for one in splits):
            print(f"{name}: {left} of {len(splits)} answers are of another split than {chosen} and not scored")
    rows[EVEN] = scoring.score(opened, {}, known, chosen)
    console = open_console()
    if len(given) == 1:
        (name, own), (_, even) = rows.items()
        lines = _cells(own) | {"all": scoring.figures(own), EVEN: scoring.figures(even)}
        console.print(_of_figures(f"{name}, {chosen}", "world, kind", lines))
    else:
        for table in _by_method(chosen, rows):
            console.print(table)
    console.print(NOTES)
    if json is not None:
        content = {
            name: {"all": scoring.figures(each), "cells": _cells(each), "problems": each} for name, each in rows.items()
        }
        write_text(json, dumps(plain({"split": chosen, "answers": content}), indent=1) + "\n")


def _split_of(benchmark: Benchmark, given: Mapping[str, Mapping[str, Answer]], known: Mapping[str, Truth]) -> str:
    """Split of the answers; where they are of several, the last of which the truth is known."""
    of = {benchmark.problems[name].split for answers in given.values() for name in answers}
    scored = [each.split for each in benchmark.problems.values() if each.split in of and each.problem in known]
    return scored[-1] if scored else next(iter(of), "validation")


def _cells(rows: Sequence[Mapping[str, Any]]) -> dict[str, dict[str, float]]:
    """Figures by world and kind."""
    from scenarios.benchmark.score import figures

    names = dict.fromkeys((row["world"], row["kind"]) for row in rows)
    return {
        f"{world}, {kind}": figures([row for row in rows if (row["world"], row["kind"]) == (world, kind)])
        for world, kind in names
    }


def _table(title: str, first: str, headings: Iterable[str], lines: Mapping[str, Sequence[str]]) -> Table:
    """Table of cells, a row per line; `first` heads their names."""
    from rich import box

    from scenarios.cli.terminal import open_table

    table = open_table(first, *headings, left=(first,), title=title, title_justify="left", box=box.SIMPLE)
    table.columns[0].no_wrap = True
    for name, cells in lines.items():
        table.add_row(name, *cells)
    return table


def _of_figures(title: str, first: str, lines: Mapping[str, Mapping[str, float]]) -> Table:
    """Table with a column a figure."""
    cells = {
        name: [_number(factor * found[key], form) for key, (_, factor, form) in COLUMNS.items()]
        for name, found in lines.items()
    }
    return _table(title, first, [heading for heading, _, _ in COLUMNS.values()], cells)


def _number(value: float, form: str) -> str:
    return "-" if value != value else format(value, form)  # noqa: PLR0124  NaN


def _by_method(split: str, rows: Mapping[str, Sequence[Mapping[str, Any]]]) -> list[Table]:
    """Tables of several methods: all figures, and the mean NAD of each world and of each kind."""
    from scenarios.benchmark.score import figures

    first = next(iter(rows.values()))
    parts = [(field, value) for field in ("world", "kind") for value in dict.fromkeys(row[field] for row in first)]

    def nads(each: Sequence[Mapping[str, Any]]) -> list[str]:
        found = [figures([row for row in each if row[field] == value])["nad"] for field, value in parts]
        return [_number(100 * value, ".3g") for value in found]

    return [
        _of_figures(f"all problems, {split}", "answers", {name: figures(each) for name, each in rows.items()}),
        _table(
            f"mean NAD by world, then by kind, %, {split}",
            "answers",
            [value for _, value in parts],
            {name: nads(each) for name, each in rows.items()},
        ),
    ]
