"""The terminal: a console as wide as it is, which prints every text as it stands, and an orderly end."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from rich.console import Console

WIDE = 120
"""Columns where there is no terminal: in a pipe, a file, a log."""


def open_console() -> Console:
    """A console as wide as the terminal, or as COLUMNS says; WIDE where there is neither."""
    known = sys.stdout.isatty() or os.environ.get("COLUMNS")
    # An error, a path or a name may hold [brackets]; rich would take them for its markup
    return Console(width=None if known else WIDE, markup=False, highlight=False)


@contextmanager
def orderly_end() -> Iterator[None]:
    """Let SIGTERM and SIGHUP end the block as an exception does, so that what it has opened is closed."""

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
