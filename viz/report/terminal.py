"""Tables on a terminal, drawn by rich."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from rich import box
from rich.console import Console, ConsoleOptions, ConsoleRenderable, RenderResult
from rich.table import Table as RichTable
from rich.text import Text

from viz.report.tables import BEYOND, PAPER, TRUTH, Entry, Table, short

DOUBT = "?: some of these answers have a status other than ok"


def rich_table(table: Table) -> ConsoleRenderable:
    """Table for rich's console; columns that do not fit continue in further tables below."""
    return _Fitted(table)


def fits(table: Table, console: Console) -> bool:
    """True if all columns of a table fit a console side by side."""
    return _has_room(console, _drawn(table), console.width)


def _has_room(console: Console, drawn: RichTable, width: int) -> bool:
    """True if a table fits a width [characters]."""
    return console.measure(drawn, options=console.options.update(width=10_000)).maximum <= width


@dataclass(frozen=True)
class _Fitted:
    """Table that is split by columns to fit the console."""

    table: Table

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Draw as many columns side by side as fit, and the others below."""
        table, start, title = self.table, 0, self.table.title
        while start < len(table.columns) or start == 0:
            end = len(table.columns)
            while True:
                rows = tuple((labels, cells[start:end]) for labels, cells in table.rows)
                part = _drawn(replace(table, title=title, columns=table.columns[start:end], rows=rows))
                if end <= start + 1 or _has_room(console, part, options.max_width):
                    break
                end -= 1
            yield part
            start, title = max(end, 1), f"{table.title}, continued"
        doubted = any(cell.doubted for _, cells in table.rows for cell in cells)
        if notes := "; ".join(filter(None, [DOUBT if doubted else "", table.note])):
            yield Text(f"{notes}\n", "dim")


def _drawn(table: Table) -> RichTable:
    """rich's table with unwrapped texts; the row of the true masses has a section of its own."""
    drawn = RichTable(
        title=Text(table.title, "table.title"), title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0)
    )
    single = len(table.labels) == 1
    for head in table.labels:
        drawn.add_column("" if single else Text(head), no_wrap=True, min_width=20 if single else None)
    for name in table.columns:
        drawn.add_column(Text(name), justify="right", no_wrap=True)
    for labels, cells in table.rows:
        if labels == (TRUTH,):
            drawn.add_section()
        no_method = labels in ((TRUTH,), (PAPER,))
        drawn.add_row(*map(Text, labels), *map(_text, cells), style="dim" if no_method else None)
    return drawn


def _text(cell: Entry) -> Text:
    """Mean and spread "0.6±0.3" over the interval "[0.4 0.9]"; "-n" counts draws without an answer.

    "*" marks the best method, "?" answers with a status other than ok.
    """
    text, summary = Text(cell.text), cell.summary
    if summary is None and cell.missing:
        text.append(f" ({cell.missing})", "dim")
    if summary is not None:
        missing = ("?" if cell.doubted else "") + (f" -{summary.missing}" if summary.missing else "")
        if summary.mean > BEYOND:
            return Text(f"{cell.words}{missing}")
        text = Text(f"{summary.mean:.2f}{missing}")
        if not np.isnan(summary.spread):
            star, style = ("*", "bold") if cell.best else ("", "")
            text = Text(f"{short(summary.mean)}±{short(summary.spread)}{star}{missing}", style)
            if cell.interval:
                text.append(f"\n[{short(summary.low)} {short(summary.high)}]", "dim not bold")
    return text
