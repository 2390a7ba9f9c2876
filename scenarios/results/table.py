"""Table of results: new rows, and rows of the last table whose files are unchanged, kept by column."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa

from estimators.evaluation.statistics import AXIS
from scenarios.results.marks import ESTIMATE, load_marks, mark_of, write_marks
from testbed.files import load_sealed, read_table, unless_damaged, write_table

TABLE = "results.parquet"
PIECE = 1000
"""Number of rows kept as dicts before they are moved into columns, which need a tenth of the memory."""
_NO_FILES = ("failed", "infeasible")
"""Statuses of rows without an estimate's files."""


def has_files(row: Mapping[str, Any]) -> bool:
    """True if the estimate of a row has files: its method has finished."""
    return bool(row.get("key")) and row.get("status") not in _NO_FILES


class ResultTable:
    """Table of a results folder; `write` sorts its rows by their places."""

    def __init__(self, root: Path):
        self._root = root
        self._rows: list[dict[str, Any]] = []
        self._pieces: list[pa.Table] = []
        self._added: list[tuple[tuple[int, ...], Mapping[str, Any]]] = []
        self._recalled: list[tuple[tuple[int, ...], Mapping[str, Any], int]] = []
        self._last = pa.table({})
        self._row_of: dict[str, int] = {}
        self.marks = load_marks(root)
        """Marks of all trials and estimates that were read whole; later reads add theirs."""
        file = root / TABLE
        if file.is_file():
            last = unless_damaged(lambda: load_sealed(file, "table of results", read_table), "written again")
            if last is not None and {"key", "status"} <= {*last.column_names}:
                self._last = last
                both = zip(last["key"].to_pylist(), last["status"].to_pylist(), strict=True)
                self._row_of = {key: row for row, (key, status) in enumerate(both) if status not in _NO_FILES}

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._added) + len(self._recalled)

    def add(self, place: tuple[int, ...], labels: Mapping[str, Any], row: dict[str, Any]) -> None:
        """Add a row; `labels` are its columns that place it in the scenario."""
        self._added.append((place, labels))
        self._rows.append({name: value for name, value in row.items() if name not in labels})
        if len(self._rows) == PIECE:
            self._put_into_columns()

    def recall(self, place: tuple[int, ...], labels: Mapping[str, Any], key: str) -> bool:
        """Add the row of an estimate from the last table; False where it has none, or a file may have changed."""
        row, name = self._row_of.get(key), f"estimates/{key}"
        if row is None or self.marks.get(name) != mark_of(f"{self._root}/{name}", ESTIMATE):
            return False
        self._recalled.append((place, labels, row))
        return True

    def _put_into_columns(self) -> None:
        self._pieces.append(pa.Table.from_pandas(pd.DataFrame(self._rows), preserve_index=False))
        self._rows.clear()

    def write(self) -> pd.DataFrame:
        """Write results.parquet, and return its content."""
        if self._rows:
            self._put_into_columns()
        pieces = list(self._pieces)
        if self._recalled:
            placed = self._recalled[0][1]
            own = [name for name in self._last.column_names if name not in placed and not name.startswith(AXIS)]
            pieces.append(self._last.select(own).take([row for *_, row in self._recalled]))
        rows = [*self._added, *((place, labels) for place, labels, _ in self._recalled)]
        order = sorted(range(len(rows)), key=lambda row: rows[row][0])
        labels = [rows[row][1] for row in order]
        columns: dict[str, Any] = {
            name: _of_one_kind([each.get(name) for each in labels])
            for name in dict.fromkeys(name for each in labels for name in each)
        }
        if pieces:
            pieces = [piece.replace_schema_metadata() for piece in pieces]
            columns |= _counts(pa.concat_tables(pieces, promote_options="permissive").take(order))
        table = pa.table(columns)
        write_marks(self._root, self.marks)
        write_table(self._root / TABLE, table)
        return table.to_pandas()


def write_rows(root: Path, rows: Iterable[dict[str, Any]]) -> pd.DataFrame:
    """Write rows as the results.parquet of a folder, and return its content."""
    table = ResultTable(root)
    for place, row in enumerate(rows):
        table.add((place,), {name: value for name, value in row.items() if name.startswith(AXIS)}, row)
    return table.write()


def _counts(table: pa.Table) -> dict[str, pa.ChunkedArray]:
    """Columns of a table, with `trials` as integers where no row lacks it."""
    columns = dict(zip(table.column_names, table.columns, strict=True))
    if "trials" in columns and not columns["trials"].null_count:
        columns["trials"] = columns["trials"].cast(pa.int64())
    return columns


def _of_one_kind(column: list[Any]) -> list[Any]:
    """Column of one type, as Parquet needs it: words and numbers, as of a swept support, become words."""
    kinds = {isinstance(v, str) for v in column if not _missing(v)}
    return [v if _missing(v) else str(v) for v in column] if len(kinds) > 1 else column


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """Rows of a results table; missing values are None."""
    return [{str(k): None if _missing(v) else v for k, v in row.items()} for row in frame.to_dict("records")]


def _missing(value: Any) -> bool:
    return value is None or (isinstance(value, float) and np.isnan(value))
