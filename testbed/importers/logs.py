"""Logs as columns of numbers over time: CSV tables, and MCAP files with JSON messages."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Sequence
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from jaxtyping import Float

from testbed.errors import HeftError, InvalidValueError, nearest
from testbed.importers.mapping import TimeMap, factor

_MOST_LISTED = 12


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
    """CSV table with a header line. A row may leave a group of columns blank, if the table joins several rates."""

    def __init__(self, path: Path, separator: str):
        self._path = path
        try:
            self._table = pd.read_csv(path, sep=separator, dtype=str, skipinitialspace=True, skip_blank_lines=False)
        except (OSError, ValueError, UnicodeDecodeError) as error:
            raise LogError(f"{path}: cannot be read as a table: {str(error).strip()}") from None
        self._table.columns = [str(name).strip() for name in self._table.columns]

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
        rows, lines = rows[there], np.flatnonzero(there) + 2
        if (bad := ~np.isfinite(rows)).any():
            row, column = np.argwhere(bad)[0]
            raise LogError(f"{self._path}: line {lines[row]}: {(time.column, *names)[column]} is blank or not finite")
        return _in_order(self._path, field, rows[:, 0] * factor("time", time.unit), rows[:, 1:])

    def _numbers(self, field: str, name: str) -> np.ndarray:
        if name not in self._table.columns:
            raise _unknown(field, name, list(self._table.columns), self._path)
        cells = self._table[name]
        numbers = np.asarray(pd.to_numeric(cells, errors="coerce"), dtype=float)
        wrong = np.flatnonzero(np.isnan(numbers) & cells.notna())
        if len(wrong):
            at = int(wrong[0])
            raise LogError(f"{self._path}: line {at + 2}: {name}: got {cells.iloc[at]!r}; allowed: a number, or blank")
        return numbers


class McapLog:
    """MCAP file with JSON messages."""

    def __init__(self, path: Path):
        self._path = path
        try:
            from mcap.exceptions import McapError  # noqa: PLC0415  an extra, needed by such files alone
            from mcap.reader import make_reader  # noqa: PLC0415
        except ImportError:
            raise LogError(
                f"{path}: reading MCAP needs mcap: not installed; pip install 'heft-testbed[robot]'"
            ) from None
        self._messages: dict[str, list[tuple[int, int, dict[str, Any]]]] = {}
        self._encodings: dict[str, str] = {}
        try:
            with path.open("rb") as file:
                for _, channel, message in make_reader(file).iter_messages():
                    self._encodings[channel.topic] = channel.message_encoding
                    if channel.message_encoding == "json":
                        fields = dict(_leaves(json.loads(message.data)))
                        stamped = (message.log_time, message.publish_time, fields)
                        self._messages.setdefault(channel.topic, []).append(stamped)
        except (OSError, ValueError, McapError) as error:
            raise LogError(f"{path}: not a whole MCAP file: {error}") from None

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


def open_log(path: Path, separator: str = ",") -> CsvLog | McapLog:
    """Open a log by its suffix.

    Raises:
        InvalidValueError: a suffix other than .csv and .mcap, or no such file.
        LogError: a file that cannot be read.
    """
    if not path.is_file():
        raise InvalidValueError("log", str(path), "an existing .csv or .mcap file")
    if path.suffix == ".csv":
        return CsvLog(path, separator)
    if path.suffix == ".mcap":
        return McapLog(path)
    raise InvalidValueError("log", str(path), "a file that ends in .csv or .mcap")


def _leaves(data: Any, path: str = "") -> Iterable[tuple[str, Any]]:
    """Values within nested JSON by dotted path; list items by number."""
    inner = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else None
    if inner is None:
        yield path, data
        return
    for key, value in inner:
        yield from _leaves(value, f"{path}.{key}" if path else str(key))


def _in_order(path: Path, field: str, time: np.ndarray, values: np.ndarray) -> Series:
    if len(time) < 2:
        raise LogError(f"{path}: {field}: got {len(time)} samples; allowed: 2 or more")
    steps = np.diff(time)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0)) + 1
        raise LogError(f"{path}: {field}: time goes back by {-steps[at - 1]:g} s at sample {at}")
    first = np.concatenate([[True], steps > 0])  # the first of samples with one stamp is the nearest to it
    return Series(time[first], values[first])


def _unknown(field: str, name: str | None, known: list[str], path: Path) -> InvalidValueError:
    listed = ", ".join(known[:_MOST_LISTED]) + (", ..." if len(known) > _MOST_LISTED else "")
    allowed = f"one of {listed or 'nothing: it is empty'}{nearest(str(name), known, 0.4)}"
    return InvalidValueError(field, name, allowed, file=path)
