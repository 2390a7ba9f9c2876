"""Columns of a log over its clock, and the errors of reading it."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.errors import HeftError, InvalidValueError, nearest

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


def in_order(path: Path, field: str, time: np.ndarray, values: np.ndarray) -> Series:
    """Series of a log, without the samples that have the time of the one before.

    Raises:
        LogError: times that go back or stand, or fewer than two of them.
    """
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


def unknown(field: str, name: str | None, known: list[str], path: Path) -> InvalidValueError:
    """Error for a name that a log does not have; it names the nearest."""
    listed = ", ".join(known[:_MOST_LISTED]) + (", ..." if len(known) > _MOST_LISTED else "")
    allowed = f"one of {listed or 'nothing: it is empty'}{nearest(str(name), known, 0.4)}"
    return InvalidValueError(field, name, allowed, file=path)
