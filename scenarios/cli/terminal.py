"""The terminal: a console as wide as it is, which prints every text as it stands."""

from __future__ import annotations

import os
import sys

from rich.console import Console

WIDE = 120
"""Columns where there is no terminal: in a pipe, a file, a log."""


def open_console() -> Console:
    """A console as wide as the terminal, or as COLUMNS says; WIDE where there is neither."""
    known = sys.stdout.isatty() or os.environ.get("COLUMNS")
    # An error, a path or a name may hold [brackets]; rich would take them for its markup
    return Console(width=None if known else WIDE, markup=False, highlight=False)
