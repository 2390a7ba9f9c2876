"""Errors that say what was wrong, what was given and what is allowed."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Self

_LONGEST = 120
"""Letters of a value in a message."""


class HeftError(Exception):
    """Base of every error that heft raises on purpose; the command line prints it on one line and exits with 2."""


class InvalidValueError(HeftError, ValueError):
    """A value outside what is allowed.

    Args:
        field: name of the offending field.
        given: the value as given.
        allowed: what would have been accepted.
        file: the file the value came from, if any.
    """

    def __init__(self, field: str, given: object, allowed: str, file: Path | str | None = None):
        self.field, self.given, self.allowed, self.file = field, given, allowed, file
        where = f"{file}: " if file is not None else ""
        shown = str(given) if isinstance(given, Path) else given
        super().__init__(f"{where}{short(field, str)}: got {short(shown)}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[Self], tuple[str, object, str, Path | str | None]]:
        """Arguments with which another process builds it again: an exception keeps its message alone."""
        return type(self), (self.field, self.given, self.allowed, self.file)


class InfeasibleTrialError(HeftError):
    """A trial that the robot cannot do, refused before anything moves. The message says why and what could be done."""


def nearest(name: str, names: Iterable[str], cutoff: float = 0.5) -> str:
    """Hint " (nearest: ...)" for a name that is nearly one of `names`, in any case; else empty."""
    folded = {known.casefold(): known for known in names}
    close = difflib.get_close_matches(name[:_LONGEST].casefold(), folded, n=1, cutoff=cutoff)
    return f" (nearest: {folded[close[0]]})" if close else ""


def one_line(words: str) -> str:
    """Words without line breaks."""
    return " ".join(line.strip() for line in words.splitlines())


def short(value: object, text: Callable[[object], str] = repr) -> str:
    """A value for a message, cut where it is long."""
    try:
        words = one_line(text(value))
    except ValueError:  # Python writes no integer of so many digits
        words = f"{type(value).__name__} with an integer of more than {sys.get_int_max_str_digits()} digits"
    return words if len(words) <= _LONGEST else words[: _LONGEST - 3] + "..."
