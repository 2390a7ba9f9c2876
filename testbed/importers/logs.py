"""Columns of a log over its clock, their units, and the errors of reading it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.errors import HeftError, InvalidValueError, listed, nearest
from testbed.parsing.process import ParserError, parsed

_GRAVITY = 9.80665  # of the kilogram-force and the pound-force, by definition
_POUND = 0.45359237
_DEGREE = math.pi / 180
FACTORS: dict[str, dict[str, float]] = {
    "time": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "length": {"m": 1.0, "cm": 1e-2, "mm": 1e-3},
    "angle": {"rad": 1.0, "deg": _DEGREE},
    "speed": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3},
    "turn rate": {"rad/s": 1.0, "deg/s": _DEGREE},
    "force": {"N": 1.0, "mN": 1e-3, "kN": 1e3, "kgf": _GRAVITY, "gf": _GRAVITY / 1e3, "lbf": _GRAVITY * _POUND},
    "torque": {
        "N m": 1.0,
        "mN m": 1e-3,
        "N mm": 1e-3,
        "N cm": 1e-2,
        "kgf m": _GRAVITY,
        "kgf cm": _GRAVITY / 1e2,
        "lbf in": _GRAVITY * _POUND * 0.0254,
    },
}
"""SI value of each unit, by quantity."""
MOST_LISTED = 12
"""Largest number of names or values of a log in an error."""
SECOND = 1_000_000_000
"""Nanoseconds of a second."""
_MOST_SHARED = 0.05
"""Largest fraction of the samples that may share a time, as by a clock of coarse resolution."""


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


@contextmanager
def parsed_log(module: str, path: Path, what: str, *words: str) -> Iterator[Path]:
    """Result of a parser of a log in a process of its own, a file that is deleted on exit.

    Args:
        module: parser.
        path: log.
        what: kind of log, in errors.
        words: further arguments of the parser.

    Raises:
        LogError: the parser refuses the file, or a package is not installed.
    """
    try:
        with parsed(module, path.absolute(), *words) as found:
            yield found
    except ImportError as error:
        allowed = f"{str(error).partition('.')[0]}: not installed; pip install 'heft-testbed[robot]'"
        raise LogError(f"{path}: reading {what} needs {allowed}") from None
    except ParserError as error:
        raise LogError(f"{path}: {error}") from None


def factor(quantity: str, unit: str) -> float:
    """SI value of a unit.

    Raises:
        InvalidValueError: no such unit of that quantity; the message names the known ones and the nearest.
    """
    known = FACTORS[quantity]
    if unit not in known:
        raise InvalidValueError("", unit, f"a unit of {quantity}: {', '.join(known)}{nearest(unit, known, 0.6)}")
    return known[unit]


class Series(NamedTuple):
    """Columns with a clock of their own."""

    time_s: Float[np.ndarray, "N"]
    """Time by the log's clock [s], strictly increasing."""
    values: Float[np.ndarray, "N K"]
    """Values in the log's units."""


def columns_of(field: str, names: Sequence[str | float], path: Path) -> list[str]:
    """Names of columns among names and constants.

    Raises:
        InvalidValueError: constants alone.
    """
    found = [name for name in names if isinstance(name, str)]
    if not found:
        raise InvalidValueError(field, list(names), "one column or more beside constants", file=path)
    return found


def ordered(path: Path, field: str, time: np.ndarray, columns: np.ndarray, names: Sequence[str | float]) -> Series:
    """Series of columns and constants in the order of `names`, sorted by time; see `in_order`."""
    series = in_order(path, field, time, columns)
    values = np.empty((len(series.time_s), len(names)))
    measured = np.array([isinstance(name, str) for name in names])
    values[:, measured], values[:, ~measured] = series.values, [n for n in names if not isinstance(n, str)]
    return Series(series.time_s, values)


def in_order(path: Path, field: str, time: np.ndarray, values: np.ndarray) -> Series:
    """Series of a log, without the samples that have the time of the one before.

    Few samples that come before their neighbor by less than the usual step are sorted.

    Raises:
        LogError: times that go back further or repeat, or fewer than two different ones.
    """
    steps = np.diff(time)
    if (steps < 0).any() and (steps < 0).mean() <= _MOST_SHARED and -steps.min() < np.median(steps):
        order = np.argsort(time, kind="stable")
        time, values = time[order], values[order]
        steps = np.diff(time)
    if (steps < 0).any():
        at = int(np.argmax(steps < 0)) + 1
        raise LogError(f"{path}: {field}: time goes back by {-steps[at - 1]:g} s at sample {at}")
    if len(time) > 2 and not steps.any():
        allowed = 'a clock that runs; of messages, [time] column = "log_time" is when each was recorded'
        raise LogError(f"{path}: {field}: all {len(time)} samples have the time {time[0]:g} s; allowed: {allowed}")
    first = np.concatenate([[True], steps > 0])[: len(time)]  # the first of samples with one stamp is the nearest to it
    shared = int((~first[1:] & (np.diff(values, axis=0) != 0).any(axis=1)).sum())
    if shared > _MOST_SHARED * len(time):
        raise LogError(
            f"{path}: {field}: {shared} of {len(time)} samples have the time of the one before and other values; "
            f"allowed: {100 * _MOST_SHARED:g} %: use a finer clock"
        )
    if first.sum() < 2:
        raise LogError(f"{path}: {field}: got {first.sum()} samples at different times; allowed: 2 or more")
    return Series(time[first], values[first])


def unknown(field: str, name: str | None, known: list[str], path: Path) -> InvalidValueError:
    """Error for a name that a log does not have; it names the nearest."""
    allowed = f"one of {listed(known, MOST_LISTED) or 'nothing: it is empty'}{nearest(str(name), known, 0.4)}"
    return InvalidValueError(field, name, allowed, file=path)
