"""Tables of numbers as logs."""

from __future__ import annotations

import json
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from testbed.errors import InvalidValueError, short
from testbed.importers.columns import ISO, Columns, TimeMap
from testbed.importers.logs import LogError, Series, factor, in_order, read_all, unknown

MOST_LETTERS = 2**17
"""Longest line of a table that is read."""
SEPARATORS = ("\t", ";", ",")
"""Characters that separate columns in most tables."""
_SECOND = 1_000_000_000


class CsvLog:
    """Table with a header line. A row may leave a group of columns blank, if the table joins several rates."""

    def __init__(self, path: Path, mapping: Columns):
        self.path, self._decimal = path, mapping.decimal
        self.epoch_s = 0  # dates count from the second of the first; numbers from where the log says
        try:
            lines = _decoded(path).split("\n")
            _check_lines(path, lines)
            kept = [i for i, line in enumerate(lines) if not (mapping.comment and line.startswith(mapping.comment))]
            head, sought = lines[kept[0]] if kept else "", mapping.separator
            if len(sought) == 1 and sought not in head and (other := max(SEPARATORS, key=head.count)) in head:
                allowed = f"the table's own, as separator = {json.dumps(other)} in the mapping"
                raise LogError(f"{path}: its first line has no separator {json.dumps(sought)}; allowed: {allowed}")
            text = StringIO("\n".join(lines[i] for i in kept))
            table = pd.read_csv(
                text, sep=mapping.separator, dtype=str, header=None, skipinitialspace=True, skip_blank_lines=False
            )
        except (OSError, ValueError) as error:
            raise LogError(f"{path}: cannot be read as a table: {str(error).strip()}") from None
        first = [str(name).strip() for name in table.iloc[0]]
        numbers = np.asarray(pd.to_numeric(table.iloc[0], errors="coerce"), dtype=float)
        if mapping.header and not np.isnan(numbers).any():
            allowed = "names of the columns, or header = false in the mapping, which names them 1, 2, ..."
            raise LogError(f"{path}: no header: line {kept[0] + 1} holds numbers alone; allowed: {allowed}")
        self._names = first if mapping.header else [str(column) for column in range(1, len(first) + 1)]
        self._lines = np.array(kept[mapping.header : len(table)]) + 1
        self._table = table[int(mapping.header) :]

    def type_of(self, field: str, topic: str | None) -> str:
        """Empty: a table has no messages.

        Raises:
            InvalidValueError: a topic is given.
        """
        if topic is not None:
            raise InvalidValueError(f"{field}.topic", topic, "none: a table has no topics", file=self.path)
        return ""

    def series(self, field: str, names: Sequence[str], topic: str | None, time: TimeMap) -> Series:
        """Columns by name.

        Args:
            field: the mapping's name for them, in errors.
            names: columns of a table, or fields of a message.
            topic: topic of the messages; None for a table.
            time: column and unit of the time.

        Raises:
            InvalidValueError: no such column, field or topic; the message names the nearest.
            LogError: cells that are not numbers, or times that go back.
        """
        self.type_of(field, topic)
        fields = [("time.column", str(time.column)), *((field, name) for name in names)]
        stamps = partial(self._dates if time.unit == ISO else self._numbers, *fields[0])
        rows = np.column_stack(read_all(stamps, *(partial(self._numbers, *pair) for pair in fields[1:])))
        there = ~np.isnan(rows[:, 1:]).all(axis=1)
        rows, lines = rows[there], self._lines[there]
        if (bad := ~np.isfinite(rows)).any():
            row, column = np.argwhere(bad)[0]
            raise LogError(f"{self.path}: line {lines[row]}: {fields[column][1]} is blank or not finite")
        scale = 1.0 if time.unit == ISO else factor("time", time.unit)
        return in_order(self.path, field, rows[:, 0] * scale, rows[:, 1:])

    def _cells(self, field: str, name: str) -> pd.Series:
        """Cells of a column with decimal points."""
        if name not in self._names:
            raise unknown(field, name, self._names, self.path)
        if (count := self._names.count(name)) > 1:
            raise LogError(f"{self.path}: {field}: {name}: {count} columns have this name; allowed: one")
        cells = pd.Series(self._table.iloc[:, self._names.index(name)])
        return cells if self._decimal == "." else cells.str.replace(self._decimal, ".", regex=False)

    def _numbers(self, field: str, name: str) -> np.ndarray:
        cells = self._cells(field, name)
        numbers = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
        self._check(name, cells, numbers, "a number")
        return numbers

    def _dates(self, field: str, name: str) -> np.ndarray:
        """Seconds from the log's epoch, exact to the nanosecond; without a time zone they are UTC."""
        cells = self._cells(field, name)
        dates = pd.DatetimeIndex(pd.to_datetime(cells, errors="coerce", format="ISO8601", utc=True)).as_unit("ns")
        stamps = dates.asi8
        if self.epoch_s == 0 and dates.notna().any():
            self.epoch_s = int(stamps[dates.notna()][0]) // _SECOND
        seconds = np.where(dates.isna(), np.nan, (stamps - self.epoch_s * _SECOND) / _SECOND)
        self._check(name, cells, seconds, "a date by ISO 8601, as 2026-01-31T12:00:00.125")
        return seconds

    def _check(self, name: str, cells: pd.Series, values: np.ndarray, allowed: str) -> None:
        wrong = np.flatnonzero(np.isnan(values) & cells.notna())
        if len(wrong):
            at = int(wrong[0])
            got = f"{self.path}: line {self._lines[at]}: {name}: got {short(cells.iloc[at])}"
            raise LogError(f"{got}; allowed: {allowed}, or blank")


def _decoded(path: Path) -> str:
    """Text of a table: UTF-8, or UTF-16 with its mark, as Excel's "Unicode text"."""
    data = path.read_bytes()
    coding = "UTF-16" if data[:2] in (BOM_UTF16_LE, BOM_UTF16_BE) else "UTF-8"
    try:
        return StringIO(data.decode(coding).removeprefix("\ufeff"), newline=None).getvalue()
    except UnicodeDecodeError as error:
        line = data[: error.start].count(b"\n") + 1
        raise LogError(
            f"{path}: line {line}: byte 0x{data[error.start]:02x} is not {coding}; save the table as UTF-8 "
            '(in Excel: "CSV UTF-8")'
        ) from None


def _check_lines(path: Path, lines: Sequence[str]) -> None:
    """Raise LogError for lines that are no rows of a table."""
    for number, line in enumerate(lines, 1):
        if len(line) > MOST_LETTERS:
            raise LogError(f"{path}: line {number}: {len(line)} letters; allowed: at most {MOST_LETTERS} in a row")
        if "\0" in line:
            raise LogError(f"{path}: line {number}: a zero byte; allowed: text")
