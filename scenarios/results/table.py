"""Table of results: rows kept by column as they come, and taken from the last run's table while files stay as read."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq

from estimators.evaluation.statistics import AXIS
from scenarios.results.marks import load_marks, mark_of, write_marks
from testbed.files import UNSEALED, load_sealed, read_table, unless_damaged, write_sealed

PIECE = 1000
"""Rows that are kept as dicts before they are put into columns, which take a tenth of the memory."""
_NO_FILES = ("failed", "infeasible")
"""Statuses of rows without an estimate's files."""


class ResultTable:
    """Table of a results folder, in the order of its rows' places."""

    def __init__(self, root: Path):
        self._root, self._file = root, root / "results.parquet"
        self._pieces: list[pa.Table] = []
        self._buffer: list[tuple[tuple[int, ...], Mapping[str, Any], dict[str, Any] | int]] = []
        self._places: list[tuple[int, ...]] = []
        self._labels: list[Mapping[str, Any]] = []
        self._last = pa.table({})
        self._row_of: dict[str, int] = {}
        self.marks = load_marks(root)
        """Marks of all trials and estimates that were read whole; those that are read from now on are added."""
        if self._file.is_file():
            last = unless_damaged(lambda: load_sealed(self._file, "table of results", read_table), "written again")
            if last is not None and {"key", "status"} <= {*last.column_names}:
                self._last = last
                both = zip(last["key"].to_pylist(), last["status"].to_pylist(), strict=True)
                self._row_of = {key: row for row, (key, status) in enumerate(both) if status not in _NO_FILES}

    def __len__(self) -> int:
        """Number of rows."""
        return len(self._places) + len(self._buffer)

    def add(self, place: tuple[int, ...], labels: Mapping[str, Any], row: dict[str, Any]) -> None:
        """Take a row; `labels` are its columns that place it in the scenario."""
        self._buffer.append((place, labels, {name: value for name, value in row.items() if name not in labels}))
        self._flush(PIECE)

    def recall(self, place: tuple[int, ...], labels: Mapping[str, Any], key: str) -> bool:
        """Take the row of an estimate from the last table; False where it has none, or a file may have changed."""
        row, marked = self._row_of.get(key), self.marks.get(f"estimates/{key}", "")
        folder = f"{self._root}/estimates/{key}"
        if row is None or not marked or marked != mark_of((f"{folder}/result.json", f"{folder}/estimate.npz")):
            return False
        self._buffer.append((place, labels, row))
        self._flush(PIECE)
        return True

    def _flush(self, least: int = 1) -> None:
        """Put the rows of the buffer into columns, where there are enough."""
        if len(self._buffer) < least:
            return
        new = [each for each in self._buffer if isinstance(each[2], dict)]
        old = [each for each in self._buffer if not isinstance(each[2], dict)]
        if new:
            self._pieces.append(pa.Table.from_pandas(pd.DataFrame([row for *_, row in new]), preserve_index=False))
        if old:
            names = [name for name in self._last.column_names if name not in old[0][1]]
            self._pieces.append(self._last.select(names).take([row for *_, row in old]))
        self._places += [place for place, *_ in new + old]
        self._labels += [labels for _, labels, _ in new + old]
        self._buffer.clear()

    def write(self) -> pd.DataFrame:
        """Write results.parquet; its content."""
        self._flush()
        order = sorted(range(len(self._places)), key=self._places.__getitem__)
        names = dict.fromkeys(name for labels in {id(each): each for each in self._labels}.values() for name in labels)
        columns: dict[str, Any] = {name: _of_one_kind([self._labels[row].get(name) for row in order]) for name in names}
        if self._pieces:
            pieces = [piece.replace_schema_metadata() for piece in self._pieces]
            self._pieces = [pa.concat_tables(pieces, promote_options="permissive").take(order)]
            self._places = [self._places[row] for row in order]
            self._labels = [self._labels[row] for row in order]
            columns |= _counts(self._pieces[0])
        write_marks(self._root, self.marks)
        table = pa.table(columns).replace_schema_metadata({b"checksum": UNSEALED.encode()})
        write_sealed(self._file, lambda part: pq.write_table(table, part, compression="zstd"))
        return table.to_pandas()


def write_rows(root: Path, rows: Iterable[dict[str, Any]]) -> pd.DataFrame:
    """Write rows as the results.parquet of a folder; its content."""
    table = ResultTable(root)
    for place, row in enumerate(rows):
        table.add((place,), {name: value for name, value in row.items() if name.startswith(AXIS)}, row)
    return table.write()


def _counts(table: pa.Table) -> dict[str, pa.ChunkedArray]:
    """Columns of a table; a number of trials is an integer, whatever an earlier row without one has made of it."""
    columns = dict(zip(table.column_names, table.columns, strict=True))
    if "trials" in columns and not columns["trials"].null_count:
        columns["trials"] = columns["trials"].cast(pa.int64())
    return columns


def _of_one_kind(column: list[Any]) -> list[Any]:
    """A column of words and numbers, as of a swept support, in words: Parquet has one type a column."""
    kept = [v[0] if isinstance(v, list) and len(v) == 1 else v for v in column]
    kinds = {str if isinstance(v, str) else float for v in kept if isinstance(v, (str, int, float)) and not missing(v)}
    return [v if missing(v) else str(v) for v in kept] if len(kinds) > 1 else column


def rows_of(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows of a results table; what is missing is None."""
    return [{str(k): None if missing(v) else v for k, v in row.items()} for row in frame.to_dict("records")]


def missing(value: Any) -> bool:
    """True of None and NaN."""
    return value is None or (isinstance(value, float) and np.isnan(value))
