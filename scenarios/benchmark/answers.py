"""Answers to the benchmark as a CSV file, a row per mass group of a problem."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

from estimators.base import EstimateStatus
from scenarios.benchmark.dataset import Problem
from testbed.errors import InvalidValueError, nearest
from testbed.files import MOST_BYTES, read_file, write_whole

COLUMNS = ("problem", "group", "mass_kg", "error_kg", "status")
"""Columns of the file; `error_kg` and `status` may be left out."""
STATUSES = (*get_args(EstimateStatus), "failed")
"""Statuses of an answer: those of an estimate, and failed."""
Cell = float | None
MOST_KG = 1e6
"""Largest mass of a group [kg]: a search without the weight may diverge, and its answer counts."""


@dataclass(frozen=True)
class Answer:
    """Answer to one problem."""

    mass_kg: tuple[float, ...] | None
    """Mass of each group [kg]; None without an answer."""
    error_kg: tuple[float, ...] | None
    """Standard error of each mass [kg], infinite where it is not known; None where the answer claims none."""
    status: str = "ok"


def write_answers(path: Path, answers: Mapping[str, Answer], problems: Iterable[Problem]) -> None:
    """Write answers as a CSV file, whole or not at all."""

    def write(part: Path) -> None:
        with open(part, "w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file, lineterminator="\n")
            rows.writerow(COLUMNS)
            for problem in problems:
                answer = answers[problem.problem]
                empty = [""] * len(problem.groups)
                masses, errors = answer.mass_kg or empty, answer.error_kg or empty
                for group, mass, error in zip(problem.groups, masses, errors, strict=True):
                    rows.writerow([problem.problem, group, mass, error, answer.status])

    write_whole(path, write)


def read_answers(path: Path, problems: Mapping[str, Problem]) -> dict[str, Answer]:
    """Answers of a CSV file by problem.

    Args:
        path: the file.
        problems: problems of the benchmark.

    Raises:
        InvalidValueError: no CSV with these columns, each once; or a row, named by its line, with an unknown problem,
            group or status, a group twice, a number that is none, negative or infinite; or an answer without a group.
        OSError: the file cannot be read.
    """
    try:
        text = read_file(path, MOST_BYTES).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise InvalidValueError("ANSWERS.csv", str(path), "a text file in UTF-8") from None
    reader = csv.DictReader(text.splitlines())
    try:
        found = _rows(reader, problems, path)
    except csv.Error as error:
        raise InvalidValueError(f"line {reader.reader.line_num}", str(error), "rows of a CSV file", file=path) from None
    return {name: _joined(problems[name], groups, path) for name, groups in found.items()}


def _rows(
    reader: csv.DictReader[str], problems: Mapping[str, Problem], path: Path
) -> dict[str, dict[str, tuple[Cell, Cell, str]]]:
    """Mass, error and status by problem and group."""
    header = [name.strip() for name in reader.fieldnames or ()]
    reader.fieldnames = header
    if unknown := [name for name in header if name not in COLUMNS]:
        allowed = f"columns {', '.join(COLUMNS)}{nearest(unknown[0], COLUMNS)}"
        raise InvalidValueError("line 1", unknown[0], allowed, file=path)
    if missing := [name for name in COLUMNS[:3] if name not in header]:
        raise InvalidValueError("line 1", ",".join(header), f"a column {missing[0]}", file=path)
    if twice := [name for name in COLUMNS if header.count(name) > 1]:
        raise InvalidValueError("line 1", ",".join(header), f"a column {twice[0]} once", file=path)
    found: dict[str, dict[str, tuple[Cell, Cell, str]]] = {}
    for row in reader:
        where = f"line {reader.line_num}"
        try:
            problem, group, values = _parsed(row, problems)
            if group in found.setdefault(problem, {}):
                raise InvalidValueError("group", f"{problem}, {group}", "each group of a problem once")
        except InvalidValueError as error:
            raise InvalidValueError(f"{where}, {error.field}", error.given, error.allowed, file=path) from None
        found[problem][group] = values
    return found


def _parsed(
    row: Mapping[str | None, str | None], problems: Mapping[str, Problem]
) -> tuple[str, str, tuple[Cell, Cell, str]]:
    """Problem, group, and mass, error and status of a row."""
    if None in row:
        raise InvalidValueError("row", row[None], f"at most {len(row) - 1} fields, as the first line has")
    text = {name: (row.get(name) or "").strip() for name in COLUMNS}
    problem, group, status = text["problem"], text["group"], text["status"] or "ok"
    if problem not in problems:
        raise InvalidValueError("problem", problem, f"a problem of the benchmark{nearest(problem, problems)}")
    groups = problems[problem].groups
    if group not in groups:
        raise InvalidValueError("group", group, f"one of {', '.join(groups)} of {problem}{nearest(group, groups)}")
    if status not in STATUSES:
        raise InvalidValueError("status", status, f"one of {', '.join(STATUSES)}{nearest(status, STATUSES)}")
    mass, error = _number("mass_kg", text["mass_kg"]), _number("error_kg", text["error_kg"], math.inf)
    if mass is None and (status == "ok" or error is not None):
        raise InvalidValueError("mass_kg", "", "a mass, or no error and a status other than ok")
    return problem, group, (mass, error, status)


def _number(field: str, text: str, most: float = MOST_KG) -> Cell:
    """Number of a field; None where it is empty."""
    if not text:
        return None
    try:
        value = math.nan if "_" in text else float(text)
    except ValueError:
        value = math.nan
    if not 0 <= value <= most:
        upper = "; inf where it is not known" if math.isinf(most) else f" to {most:g}"
        raise InvalidValueError(field, text, f"kilograms from 0{upper}; or nothing")
    return value


def _joined(problem: Problem, rows: Mapping[str, tuple[Cell, Cell, str]], path: Path) -> Answer:
    """Answer of the rows of one problem."""
    if lacking := [group for group in problem.groups if group not in rows]:
        raise InvalidValueError(problem.problem, f"no row of {', '.join(lacking)}", "a row of every group", file=path)
    masses, errors, statuses = zip(*(rows[group] for group in problem.groups), strict=True)
    for field, values in (("mass_kg", masses), ("error_kg", errors)):
        if len({value is None for value in values}) > 1:
            given = f"empty in {values.count(None)} of {len(values)} rows"
            raise InvalidValueError(
                f"{problem.problem}, {field}", given, "empty in all rows of a problem or in none", file=path
            )
    if len(set(statuses)) > 1:
        raise InvalidValueError(f"{problem.problem}, status", sorted(set(statuses)), "one for all rows", file=path)
    return Answer(None if None in masses else masses, None if None in errors else errors, statuses[0])
