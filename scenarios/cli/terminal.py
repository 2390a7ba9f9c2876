"""Terminal: consoles and tables, parsing of typed numbers, and cleanup on signals."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Collection, Iterator
from contextlib import contextmanager
from typing import Any

from rich.console import Console
from rich.table import Column, Table

from testbed.errors import InvalidValueError

WIDE = 120
"""Width without a terminal: in a pipe, a file, a log [columns]."""


def open_console() -> Console:
    """Console as wide as the terminal or COLUMNS; WIDE where there is neither."""
    known = sys.stdout.isatty() or os.environ.get("COLUMNS")
    # An error, a path or a name may hold [brackets]; rich would take them for its markup
    return Console(width=None if known else WIDE, markup=False, highlight=False)


def open_table(*columns: str, left: Collection[str] = (), no_wrap: bool = False, **look: Any) -> Table:
    """Empty table, aligned right except for the columns in `left`; `look` are arguments of rich's `Table`."""
    heads = [Column(name, justify="left" if name in left else "right", no_wrap=no_wrap) for name in columns]
    return Table(*heads, **look)


def default_hint(default: str) -> str:
    """Text of a default in an option's help; empty for None, False and empty tuples."""
    return "" if default in ("None", "False", "") else f"(default: {default})"


@contextmanager
def orderly_end() -> Iterator[None]:
    """Let SIGTERM and SIGHUP raise SystemExit in the block, so that it closes its files and processes."""

    def end(number: int, _: object) -> None:
        for name in earlier:
            signal.signal(name, signal.SIG_IGN)  # once is enough
        sys.exit(128 + number)

    default = [name for name in (signal.SIGTERM, signal.SIGHUP) if signal.getsignal(name) is signal.SIG_DFL]
    earlier = {name: signal.signal(name, end) for name in default}  # nohup's SIGHUP stays ignored
    try:
        yield
    finally:
        for name, handler in earlier.items():
            signal.signal(name, handler)


def percent(text: str | None, name: str) -> float | None:
    """ "5%" as a fraction; None stays None.

    Raises:
        InvalidValueError: no percent sign, or not between 0 and 100 %.
    """
    if text is None:
        return None
    if not text.strip().endswith("%"):
        raise InvalidValueError(name, text, "a percentage such as 5%, with its sign")
    value = _number(text.strip().removesuffix("%"), name, text, "a percentage such as 5%") / 100
    if not 0 < value < 1:
        raise InvalidValueError(name, text, "a percentage above 0% and below 100%, such as 5%")
    return value


def seconds(text: str | None, name: str) -> float | None:
    """ "60s", "60" or "2min" in seconds; None stays None.

    Raises:
        InvalidValueError: not a time above 0.
    """
    if text is None:
        return None
    bare, unit = text.strip().removesuffix("s"), 1.0
    if bare.endswith("min"):
        bare, unit = bare.removesuffix("min"), 60.0
    value = unit * _number(bare, name, text, "a time such as 60s or 2min")
    if not 0 < value < float("inf"):
        raise InvalidValueError(name, text, "a time above 0, such as 60s or 2min")
    return value


def _number(bare: str, name: str, text: str, allowed: str) -> float:
    try:
        return float(bare)
    except ValueError:
        raise InvalidValueError(name, text, allowed) from None
