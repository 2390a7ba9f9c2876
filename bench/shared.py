"""Options, tables and worker processes of the scripts."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Collection, Iterable
from multiprocessing import get_context
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table

from scenarios.cli.terminal import open_table


def parser_of(text: str | None, **defaults: Any) -> argparse.ArgumentParser:
    """Parser of a script's docstring, with an option per default, of its type; a list takes several values."""
    parser = argparse.ArgumentParser(description=text, formatter_class=argparse.RawDescriptionHelpFormatter)
    for name, default in defaults.items():
        several: dict[str, Any] = {"nargs": "+"} if isinstance(default, list) else {}
        kind = type(default[0] if several else default)
        parser.add_argument(f"--{name}", type=kind, default=default, **several)
    return parser


def head_table(*columns: str, left: Collection[str] = (), **look: Any) -> Table:
    """Empty table with a line below its head, its columns to the right but for those named in `left`."""
    look = {"box": box.SIMPLE_HEAD} | look
    return open_table(*columns, left=left, **look)


def show(*tables: Table | str, width: int | None = None) -> None:
    """Print tables and lines to a width."""
    console = Console(width=width)
    for each in tables:
        console.print(each)


def pooled(work: Callable[[Any], Any], jobs: Iterable[Any], workers: int) -> list[Any]:
    """Answers to jobs in their order, by worker processes of one thread each."""
    with get_context("spawn").Pool(workers, _one_thread) as pool:
        return list(pool.imap(work, jobs))


def _one_thread() -> None:
    import torch  # noqa: PLC0415  scripts that measure memory or a start import this module too

    torch.set_num_threads(1)
