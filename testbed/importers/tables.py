"""Tables of numbers as logs: text, Parquet and HDF5."""

from __future__ import annotations

import json
import re
from codecs import BOM_UTF16_BE, BOM_UTF16_LE
from collections.abc import Callable, Sequence
from functools import partial
from io import StringIO
from pathlib import Path

import numpy as np
import pandas as pd
from pandas.api.types import is_datetime64_dtype, is_integer_dtype, is_string_dtype

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

ARRAYS = (".parquet", ".h5", ".hdf5")
"""Suffixes of files of arrays; other tables are of text."""
MOST_LETTERS = 2**17
"""Longest line of a table that is read."""
SEPARATORS = ("\t", ";", ",")
"""Characters that separate columns in most tables."""
_RAGGED = re.compile(r"Expected (\d+) fields in line (\d+), saw (\d+)")
"""Message of pandas on a row longer than those before, with its line, counted from 1."""
_GZIP = b"\x1f\x8b"
_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")
_UNIT = re.compile(r"[\[(]?(k?N|kgf|lbf|m?N[ *.]?m{1,2}|[mcu]?m|[mun]?s|rad|deg|°)( ?/ ?s)?[\])]?")
EPISODE = "episode_index"
"""Column of the episode of each row in data of LeRobot."""


class TableLog:
    """Columns by name, each with the number of its rows. A row may leave a group of columns blank.

    Text has a header line, and may join several rates. In Parquet and HDF5 items of lists and columns of arrays have a
    name with a dot and a number, as `pose.0`.
    """

    def __init__(self, path: Path, mapping: Columns):
        self.path, self.epoch_s = path, 0
        """Whole second since 1970 from which dates count; 0 for numbers, which count from a zero of the log's own."""
        self._where, self._decimal = mapping.where, mapping.decimal
        self.numbered = mapping.rows == "poses"
        """True if rows have no times: each is a pose, and their numbers take the place of times."""
        if path.suffix.lower() in ARRAYS:
            self._row, self._names, self._columns = "row", *_arrays(path)
        else:
            self._row, self._names, self._columns = "line", *_text_columns(path, mapping)

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
        if self.numbered:
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
            place = self._column(field, sought[0]).index[there[row]]
            raise LogError(f"{self.path}: {self._row} {place}: {name} is blank or not finite")
        try:
            return ordered(self.path, field, stamps, values, names)
        except LogError as error:
            if EPISODE in self._names and EPISODE not in self._where:
                allowed = f"one episode, as where = {{ {EPISODE} = 0 }} in the mapping, or in a [[logs]] table of each"
                raise LogError(f"{error}; it has episodes: allowed: {allowed}") from None
            raise

    def _column(self, field: str, name: str) -> pd.Series:
        """Cells of a column, texts with decimal points, by the numbers of their lines or rows.

        Raises:
            InvalidValueError: no such column; the message names the nearest.
            LogError: several have this name, or none holds numbers.
        """
        if not self._names:
            raise LogError(f"{self.path}: no column holds numbers; allowed: columns of numbers and times, not of text")
        if name not in self._names:
            raise unknown(field, name, self._names, self.path)
        if (count := self._names.count(name)) > 1:
            raise LogError(f"{self.path}: {field}: {name}: {count} columns have this name; allowed: one")
        cells = self._columns(self._names.index(name))
        if is_string_dtype(cells.dtype) and self._decimal != ".":
            return cells.str.replace(self._decimal, ".", regex=False)
        return cells

    def _since_epoch(self, stamps: np.ndarray) -> np.ndarray:
        """Seconds of dates from the whole second of the first one, exact to the nanosecond; NaN for a blank."""
        there, nanoseconds = ~np.isnat(stamps), stamps.astype(np.int64)
        if self.epoch_s == 0 and there.any():
            self.epoch_s = int(nanoseconds[there][0]) // SECOND
        return np.where(there, (nanoseconds - self.epoch_s * SECOND) / SECOND, np.nan)

    def _numbers(self, field: str, name: str) -> np.ndarray:
        """Numbers of a column, NaN where it is blank."""
        cells = self._column(field, name)
        if is_datetime64_dtype(cells.dtype):
            raise LogError(f"{self.path}: {field}: {name} holds times; allowed: numbers")
        numbers = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
        self._check(name, cells, numbers, "a number")
        return numbers

    def _stamps(self, field: str, name: str, unit: str) -> np.ndarray:
        """Times [s] of a column, NaN where it is blank."""
        cells = self._column(field, name)
        if is_datetime64_dtype(cells.dtype):
            return self._since_epoch(cells.to_numpy())
        is_text = is_string_dtype(cells.dtype)
        if unit == ISO and not is_text:
            raise InvalidValueError("time.unit", unit, f"a unit of time: {name} holds numbers", file=self.path)
        if unit == ISO:  # without a time zone they are UTC
            dates = pd.DatetimeIndex(pd.to_datetime(cells, errors="coerce", format="ISO8601", utc=True)).as_unit("ns")
            seconds = self._since_epoch(dates.asi8.view("datetime64[ns]"))
            self._check(name, cells, seconds, "a date by ISO 8601, as 2026-01-31T12:00:00.125")
            return seconds
        if unit == "ns" and is_integer_dtype(cells.dtype):  # more digits than a float has
            return self._since_epoch(cells.to_numpy().astype("datetime64[ns]"))
        return self._numbers(field, name) * factor("time", unit)

    def _check(self, name: str, cells: pd.Series, values: np.ndarray, allowed: str) -> None:
        wrong = np.flatnonzero(np.isnan(values) & cells.notna())
        if len(wrong):
            at = int(wrong[0])
            got = f"{self.path}: {self._row} {cells.index[at]}: {name}: got {short(cells.iloc[at])}"
            hint = ""
            cell = str(cells.iloc[at]).strip()
            if self._decimal != "," and _COMMA.fullmatch(cell):
                hint = '; of decimal commas, decimal = "," in the mapping'
            elif at == 0 and _UNIT.fullmatch(cell):
                hint = "; a line of units below the names is no row: delete it"
            raise LogError(f"{got}; allowed: {allowed}, or blank{hint}")


def _text_columns(path: Path, mapping: Columns) -> tuple[list[str], Callable[[int], pd.Series]]:
    """Names of the columns of a table of text, and the cells of each, by the numbers of their lines."""
    try:
        lines = _decoded(path).split("\n")
    except (OSError, ValueError) as error:
        raise LogError(f"{path}: cannot be read as a table: {str(error).strip()}") from None
    _check_lines(path, lines)
    kept = [i for i, line in enumerate(lines) if not (mapping.comment and line.startswith(mapping.comment))]
    head, sought = lines[kept[0]] if kept else "", mapping.separator
    if len(sought) == 1 and sought not in head and (other := max(SEPARATORS, key=head.count)) in head:
        allowed = f"the table's own, as separator = {json.dumps(other)} in the mapping"
        raise LogError(f"{path}: its first line has no separator {json.dumps(sought)}; allowed: {allowed}")
    try:
        table = pd.read_csv(
            StringIO("\n".join(lines[i] for i in kept)),
            sep=sought,
            engine="c" if len(sought) == 1 else "python",  # which takes a pattern
            dtype=str,
            header=None,
            skipinitialspace=True,
            skip_blank_lines=False,
        )
    except re.error as error:
        raise InvalidValueError("separator", sought, f"a character, or a pattern ({error})", file=path) from None
    except ValueError as error:
        said = f"cannot be read as a table: {str(error).strip()}"
        if ragged := _RAGGED.search(str(error)):
            expected, at, found = map(int, ragged.groups())
            allowed = "rows of equal length; a line above the names of the columns is deleted, or begins with `comment`"
            said = f"line {kept[at - 1] + 1}: {found} columns, after {expected}; allowed: {allowed}"
        raise LogError(f"{path}: {said}") from None
    table.index = pd.Index(np.array(kept[: len(table)]) + 1)
    first = [str(name).strip() for name in table.iloc[0]]
    numbers = np.asarray(pd.to_numeric(table.iloc[0], errors="coerce"), dtype=float)
    if mapping.header and not np.isnan(numbers).any():
        allowed = "names of the columns, or header = false in the mapping, which names them 1, 2, ..."
        above = lines[kept[0] - 1] if kept[0] else ""
        if mapping.comment and len(sought) == 1 and above.count(sought) == head.count(sought):
            allowed += f"; line {kept[0]} has names, but begins with comment {json.dumps(mapping.comment)}: take it off"
        raise LogError(f"{path}: no header: line {kept[0] + 1} holds numbers alone; allowed: {allowed}")
    names = first if mapping.header else [str(column) for column in range(1, len(first) + 1)]
    return names, lambda column: table.iloc[int(mapping.header) :, column]


def _arrays(path: Path) -> tuple[list[str], Callable[[int], pd.Series]]:
    """Names of the columns of a Parquet or HDF5 file, and the values of each."""
    with parsed_log("testbed.parsing.tables", path, "an HDF5 file") as found, np.load(found) as arrays:
        names = [str(name) for name in arrays["names"]]
        columns = [arrays[f"column_{i}"] for i in range(len(names))]
    return names, lambda column: pd.Series(columns[column])


def _decoded(path: Path) -> str:
    """Text of a table: UTF-8, or UTF-16 with its mark, as Excel's "Unicode text"."""
    data = path.read_bytes()
    if data.startswith(_GZIP):
        raise LogError(f"{path}: is compressed by gzip; allowed: text: unpack it")
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
