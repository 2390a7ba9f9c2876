"""Tables of numbers as logs: text, Parquet and HDF5."""

from __future__ import annotations

import json
from abc import ABC, abstractmethod
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Sequence
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd

from testbed.errors import InvalidValueError, short
from testbed.importers.columns import ISO, Cell, Columns, TimeMap
from testbed.importers.logs import (
    MOST_LISTED,
    SECOND,
    LogError,
    Series,
    columns_of,
    factor,
    ordered,
    parsed_log,
    read_all,
    unknown,
)

MOST_LETTERS = 2**17
"""Longest line of a table that is read."""
SEPARATORS = ("\t", ";", ",")
"""Characters that separate columns in most tables."""
EPISODE = "episode_index"
"""Column of LeRobot's data that says which episode a row is of."""


class TableLog(ABC):
    """Columns by name, each with the number of its rows. A row may leave a group of columns blank."""

    path: Path
    epoch_s: int
    """Whole second since 1970 from which dates count; 0 of numbers, which count from where the log says."""
    _names: list[str]
    _where: dict[str, float]
    _numbered: bool
    """True for rows without times, which are numbered: poses of their own."""

    def __init__(self, path: Path, mapping: Columns):
        self.path, self.epoch_s = path, 0
        self._where, self._numbered = mapping.where, mapping.rows == "poses"

    def type_of(self, field: str, topic: str | None) -> str:
        """Empty: a table has no messages.

        Raises:
            InvalidValueError: a topic is given.
        """
        if topic is not None:
            raise InvalidValueError(f"{field}.topic", topic, "none: a table has no topics", file=self.path)
        return ""

    def series(self, field: str, names: Sequence[Cell], topic: str | None, time: TimeMap) -> Series:
        """Columns by name.

        Args:
            field: the mapping's name for them, in errors.
            names: columns of a table, or fields of a message; a number is a constant.
            topic: topic of the messages; None for a table.
            time: column and unit of the time.

        Raises:
            InvalidValueError: no such column, field or topic; the message names the nearest.
            LogError: cells that are not numbers, or times that go back.
        """
        self.type_of(field, topic)
        sought = columns_of(field, names, self.path)
        rules = [partial(self._numbers, "where", name) for name in self._where]
        numbers = [partial(self._numbers, field, name) for name in sought]
        if self._numbered:
            columns = read_all(*numbers, *rules)
            stamps = np.arange(len(columns[0]), dtype=float)
        else:
            stamps, *columns = read_all(
                partial(self._stamps, "time.column", str(time.column), time.unit), *numbers, *rules
            )
        named = dict(zip([str(time.column), *sought, *self._where], [stamps, *columns], strict=True))
        if len({len(values) for values in named.values()}) > 1:
            counts = ", ".join(f"{name} {len(values)}" for name, values in named.items())
            raise LogError(f"{self.path}: {field}: columns of unequal length ({counts}); allowed: one time for all")
        values, kept = np.column_stack(columns[: len(sought)]), np.full(len(stamps), True)
        for (name, wanted), column in zip(self._where.items(), columns[len(sought) :], strict=True):
            kept &= column == wanted
            if not kept.any():
                known = ", ".join(f"{value:g}" for value in np.unique(column[~np.isnan(column)])[:MOST_LISTED])
                raise InvalidValueError(f"where.{name}", wanted, f"one of {known or 'nothing'}", file=self.path)
        there = np.flatnonzero(kept & ~np.isnan(values).all(axis=1))
        stamps, values = stamps[there], values[there]
        rows = np.column_stack([stamps, values])
        if (bad := ~np.isfinite(rows)).any():
            row, column = np.argwhere(bad)[0]
            name = [str(time.column), *sought][column]
            raise LogError(f"{self.path}: {self._place(int(there[row]))}: {name} is blank or not finite")
        try:
            return ordered(self.path, field, stamps, values, names)
        except LogError as error:
            if EPISODE in self._names and EPISODE not in self._where:
                allowed = f"one episode, as where = {{ {EPISODE} = 0 }} in its [[logs]] table"
                raise LogError(f"{error}; it has episodes: allowed: {allowed}") from None
            raise

    def _column(self, field: str, name: str) -> int:
        """Index of a column.

        Raises:
            InvalidValueError: no such column; the message names the nearest.
            LogError: several have this name.
        """
        if name not in self._names:
            raise unknown(field, name, self._names, self.path)
        if (count := self._names.count(name)) > 1:
            raise LogError(f"{self.path}: {field}: {name}: {count} columns have this name; allowed: one")
        return self._names.index(name)

    def _since_epoch(self, stamps: np.ndarray) -> np.ndarray:
        """Seconds of dates from the second of the first one, exact to the nanosecond; NaN of none."""
        there, nanoseconds = ~np.isnat(stamps), stamps.astype(np.int64)
        if self.epoch_s == 0 and there.any():
            self.epoch_s = int(nanoseconds[there][0]) // SECOND
        return np.where(there, (nanoseconds - self.epoch_s * SECOND) / SECOND, np.nan)

    @abstractmethod
    def _place(self, row: int) -> str:
        """Name of a row, in errors."""

    @abstractmethod
    def _numbers(self, field: str, name: str) -> np.ndarray:
        """Numbers of a column, NaN where it is blank."""

    @abstractmethod
    def _stamps(self, field: str, name: str, unit: str) -> np.ndarray:
        """Times [s] of a column, NaN where it is blank."""


class CsvLog(TableLog):
    """Table of text with a header line. A row may leave columns blank, if the table joins several rates."""

    def __init__(self, path: Path, mapping: Columns):
        super().__init__(path, mapping)
        self._decimal = mapping.decimal
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

    def _place(self, row: int) -> str:
        return f"line {self._lines[row]}"

    def _cells(self, field: str, name: str) -> pd.Series:
        """Cells of a column with decimal points."""
        cells = pd.Series(self._table.iloc[:, self._column(field, name)])
        return cells if self._decimal == "." else cells.str.replace(self._decimal, ".", regex=False)

    def _numbers(self, field: str, name: str) -> np.ndarray:
        cells = self._cells(field, name)
        numbers = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
        self._check(name, cells, numbers, "a number")
        return numbers

    def _stamps(self, field: str, name: str, unit: str) -> np.ndarray:
        if unit != ISO:
            return self._numbers(field, name) * factor("time", unit)
        cells = self._cells(field, name)  # without a time zone they are UTC
        dates = pd.DatetimeIndex(pd.to_datetime(cells, errors="coerce", format="ISO8601", utc=True)).as_unit("ns")
        seconds = self._since_epoch(dates.asi8.view("datetime64[ns]"))
        self._check(name, cells, seconds, "a date by ISO 8601, as 2026-01-31T12:00:00.125")
        return seconds

    def _check(self, name: str, cells: pd.Series, values: np.ndarray, allowed: str) -> None:
        wrong = np.flatnonzero(np.isnan(values) & cells.notna())
        if len(wrong):
            at = int(wrong[0])
            got = f"{self.path}: line {self._lines[at]}: {name}: got {short(cells.iloc[at])}"
            raise LogError(f"{got}; allowed: {allowed}, or blank")


class ArrayLog(TableLog):
    """Parquet or HDF5 file. Items of lists and columns of arrays have a name with a dot and a number, as `pose.0`."""

    def __init__(self, path: Path, mapping: Columns):
        super().__init__(path, mapping)
        with parsed_log("testbed.parsing.tables", path, "an HDF5 file", "h5py") as found, np.load(found) as arrays:
            self._names = [str(name) for name in arrays["names"]]
            self._arrays = [arrays[f"column_{i}"] for i in range(len(self._names))]

    def _place(self, row: int) -> str:
        return f"row {row}"

    def _numbers(self, field: str, name: str) -> np.ndarray:
        values = self._arrays[self._column(field, name)]
        if values.dtype.kind == "M":
            raise LogError(f"{self.path}: {field}: {name} holds times; allowed: numbers")
        return values.astype(float)

    def _stamps(self, field: str, name: str, unit: str) -> np.ndarray:
        values = self._arrays[self._column(field, name)]
        if values.dtype.kind == "M":
            return self._since_epoch(values)
        if unit == ISO:
            raise InvalidValueError("time.unit", unit, f"a unit of time: {name} holds numbers", file=self.path)
        if values.dtype.kind == "i" and unit == "ns":  # more digits than a float has
            return self._since_epoch(values.astype("datetime64[ns]"))
        return values * factor("time", unit)


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
