"""Errors whose message has the field, the given value and the allowed values."""

from __future__ import annotations

import difflib
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Self

_LONGEST = 120
"""Greatest number of characters of a value in a message."""


class HeftError(Exception):
    """Base of every error that heft raises on purpose; the command line prints it on one line and exits with 2."""


class InvalidValueError(HeftError, ValueError):
    """A value outside what is allowed.

    Args:
        field: name of the offending field.
        given: the value as given.
        allowed: description of the allowed values.
        file: the file of the value, if any.
    """

    def __init__(self, field: str, given: object, allowed: str, file: Path | str | None = None):
        self.field, self.given, self.allowed, self.file = field, given, allowed, file
        where = f"{file}: " if file is not None else ""
        shown = str(given) if isinstance(given, Path) else given
        super().__init__(f"{where}{short(field, str)}: got {short(shown)}; allowed: {allowed}")

    def __reduce__(self) -> tuple[type[Self], tuple[str, object, str, Path | str | None]]:
        """Arguments for unpickling: by default an exception is rebuilt from its message alone."""
        return type(self), (self.field, self.given, self.allowed, self.file)


class InfeasibleTrialError(HeftError):
    """A trial that the robot cannot do, refused before it moves. The message has the reason and a remedy."""


def nearest(name: str, names: Iterable[str], cutoff: float = 0.5) -> str:
    """Hint " (nearest: ...)" for a name that is similar to one of `names`, ignoring case; else empty."""
    folded = {known.casefold(): known for known in names}
    close = difflib.get_close_matches(name[:_LONGEST].casefold(), folded, n=1, cutoff=cutoff)
    return f" (nearest: {folded[close[0]]})" if close else ""


def listed(names: Sequence[str], most: int) -> str:
    """Text of the first `most` names, with "..." for the others."""
    return ", ".join(names[:most]) + ", ..." * (len(names) > most)


def one_line(text: str) -> str:
    """Text without line breaks."""
    return " ".join(line.strip() for line in text.splitlines())


def short(value: object, text: Callable[[object], str] = repr) -> str:
    """Text of a value for a message, truncated if it is long."""
    try:
        words = one_line(text(value))
    except ValueError:  # Python limits the digits of an integer's text
        words = f"{type(value).__name__} with an integer of more than {sys.get_int_max_str_digits()} digits"
    return words if len(words) <= _LONGEST else words[: _LONGEST - 3] + "..."
