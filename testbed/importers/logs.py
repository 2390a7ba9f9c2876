"""Logs as columns of numbers over time: CSV tables, and MCAP files with JSON messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float

from testbed.errors import HeftError, InvalidValueError, nearest
from testbed.importers.mapping import Mapping, TimeMap, factor

TABLES = (".csv", ".tsv", ".txt")
"""Suffixes of tables."""
_MOST_LISTED = 12
_MOST_SHARED = 0.05
"""Largest part of the samples that may have the time of another: a clock's resolution."""


class LogError(HeftError):
    """Log that cannot be read; the message names the file and what is allowed."""


def read_all(*reads: Callable[[], Any]) -> list[Any]:
    """Results of all reads.

    Raises:
        HeftError: the error, if one read failed.
        LogError: one line per error, if several failed.
    """
    results, errors = [], []
    for read in reads:
        try:
            results.append(read())
        except HeftError as error:
            errors.append(error)
    if len(errors) == 1:
        raise errors[0]
    if errors:
        raise LogError("\n".join(dict.fromkeys(line for error in errors for line in str(error).splitlines())))
    return results


class Series(NamedTuple):
    """Columns with a clock of their own."""

    time_s: Float[np.ndarray, "N"]
    """Time by the log's clock [s], strictly increasing."""
    values: Float[np.ndarray, "N K"]
    """Values in the log's units."""


class CsvLog:
    """Table with a header line. A row may leave a group of columns blank, if the table joins several rates."""

    def __init__(self, path: Path, mapping: Mapping):
        self._path, self._decimal = path, mapping.decimal
        try:
            lines = path.read_text(encoding="utf-8-sig").split("\n")
            kept = [i for i, line in enumerate(lines) if not (mapping.comment and line.startswith(mapping.comment))]
            text = StringIO("\n".join(lines[i] for i in kept))
            table = pd.read_csv(
                text, sep=mapping.separator, dtype=str, header=None, skipinitialspace=True, skip_blank_lines=False
            )
        except (OSError, ValueError) as error:
            raise LogError(f"{path}: cannot be read as a table: {str(error).strip()}") from None
        self._lines = np.array(kept[1 : len(table)]) + 1
        self._names = [str(name).strip() for name in table.iloc[0]]
        self._table = table[1:]

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
        if topic is not None:
            raise InvalidValueError(f"{field}.topic", topic, "none: a table has no topics", file=self._path)
        fields = [("time.column", time.column), *((field, name) for name in names)]
        rows = np.column_stack(read_all(*(partial(self._numbers, *pair) for pair in fields)))
        there = ~np.isnan(rows[:, 1:]).all(axis=1)
        rows, lines = rows[there], self._lines[there]
        if (bad := ~np.isfinite(rows)).any():
            row, column = np.argwhere(bad)[0]
            raise LogError(f"{self._path}: line {lines[row]}: {(time.column, *names)[column]} is blank or not finite")
        return _in_order(self._path, field, rows[:, 0] * factor("time", time.unit), rows[:, 1:])

    def _numbers(self, field: str, name: str) -> np.ndarray:
        if name not in self._names:
            raise _unknown(field, name, self._names, self._path)
        if (count := self._names.count(name)) > 1:
            raise LogError(f"{self._path}: {field}: {name}: {count} columns have this name; allowed: one")
        cells = pd.Series(self._table.iloc[:, self._names.index(name)])
        plain = cells if self._decimal == "." else cells.str.replace(self._decimal, ".", regex=False)
        numbers = np.asarray(pd.to_numeric(plain, errors="coerce"), dtype=float)
        wrong = np.flatnonzero(np.isnan(numbers) & cells.notna())
        if len(wrong):
            at = int(wrong[0])
            allowed = "a number, or blank"
            raise LogError(f"{self._path}: line {self._lines[at]}: {name}: got {cells.iloc[at]!r}; allowed: {allowed}")
        return numbers


class McapLog:
    """MCAP file with JSON messages."""

    def __init__(self, path: Path):
        self._path = path
        try:
            from mcap.reader import NonSeekingReader  # noqa: PLC0415  an extra, needed by such files alone
        except ImportError:
            raise LogError(
                f"{path}: reading MCAP needs mcap: not installed; pip install 'heft-testbed[robot]'"
            ) from None
        self._messages: dict[str, list[tuple[int, int, dict[str, Any]]]] = {}
        self._encodings: dict[str, str] = {}
        try:
            with path.open("rb") as file:
                # from front to back: only then is every checksum compared, the data section's too
                for _, channel, message in NonSeekingReader(file, validate_crcs=True).iter_messages():
                    self._encodings[channel.topic] = channel.message_encoding
                    if channel.message_encoding == "json":
                        fields = dict(_leaves(json.loads(message.data)))
                        stamped = (message.log_time, message.publish_time, fields)
                        self._messages.setdefault(channel.topic, []).append(stamped)
        except Exception as error:  # damaged bytes raise anything, from the decompressors too
            raise LogError(f"{path}: not a whole MCAP file: {str(error) or type(error).__name__}") from None

    def series(self, field: str, names: Sequence[str], topic: str | None, time: TimeMap) -> Series:
        """Fields by name, see `CsvLog.series`."""
        if topic is None or topic not in self._encodings:
            raise _unknown(f"{field}.topic", topic, sorted(self._encodings), self._path)
        if self._encodings[topic] != "json":
            raise LogError(
                f"{self._path}: topic {topic} is encoded as {self._encodings[topic]}; allowed: json; "
                "convert it, or export the columns as CSV"
            )
        messages = self._messages[topic]
        columns = read_all(*(partial(self._column, field, name, topic) for name in names))
        if time.column in ("log_time", "publish_time"):
            seconds = np.array([m[time.column == "publish_time"] for m in messages]) * 1e-9  # exact to 0.2 us
        else:
            seconds = self._column("time.column", time.column, topic) * factor("time", time.unit)
        return _in_order(self._path, field, seconds, np.column_stack(columns))

    def _column(self, field: str, name: str, topic: str) -> np.ndarray:
        values = np.empty(len(self._messages[topic]))
        for i, (_, _, fields) in enumerate(self._messages[topic]):
            if name not in fields:
                raise _unknown(field, name, sorted(fields), self._path)
            value = fields[name]
            if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
                raise LogError(f"{self._path}: topic {topic}, message {i}: {name}: got {value!r}; allowed: a number")
            values[i] = value
        return values


def open_log(path: Path, mapping: Mapping) -> CsvLog | McapLog:
    """Open a log by its suffix.

    Raises:
        InvalidValueError: a suffix that is none of a table's or .mcap, or no such file.
        LogError: a file that cannot be read.
    """
    if not path.is_file():
        raise InvalidValueError("log", str(path), "an existing .csv or .mcap file")
    if path.suffix in TABLES:
        return CsvLog(path, mapping)
    if path.suffix == ".mcap":
        return McapLog(path)
    raise InvalidValueError("log", str(path), f"a file that ends in {', '.join(TABLES)} or .mcap")


def _leaves(data: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    """Values within nested JSON by dotted path; list items by number."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else None
    if inner is None:
        yield path, data
        return
    for key, value in inner:
        yield from _leaves(value, f"{path}.{key}" if path else str(key))


def _in_order(path: Path, field: str, time: np.ndarray, values: np.ndarray) -> Series:
    steps = np.diff(time)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0)) + 1
        raise LogError(f"{path}: {field}: time goes back by {-steps[at - 1]:g} s at sample {at}")
    first = np.concatenate([[True], steps > 0])  # the first of samples with one stamp is the nearest to it
    shared = int((~first[1:] & (np.diff(values, axis=0) != 0).any(axis=1)).sum())
    if shared > _MOST_SHARED * len(time):
        raise LogError(
            f"{path}: {field}: {shared} of {len(time)} samples have the time of the one before and other values; "
            f"allowed: {100 * _MOST_SHARED:g} %: use a finer clock"
        )
    if first.sum() < 2:
        raise LogError(f"{path}: {field}: got {first.sum()} samples at different times; allowed: 2 or more")
    return Series(time[first], values[first])


def _unknown(field: str, name: str | None, known: list[str], path: Path) -> InvalidValueError:
    listed = ", ".join(known[:_MOST_LISTED]) + (", ..." if len(known) > _MOST_LISTED else "")
    allowed = f"one of {listed or 'nothing: it is empty'}{nearest(str(name), known, 0.4)}"
    return InvalidValueError(field, name, allowed, file=path)
