"""Tables of metrics on a terminal."""

from __future__ import annotations

import numpy as np
from rich import box
from rich.table import Table as RichTable
from rich.text import Text

from viz.report.tables import TRUTH, Entry, Table, short


def rich_table(table: Table) -> RichTable:
    """A table for rich's console; the row of the true masses stands apart."""
    drawn = RichTable(title=table.title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    single = len(table.labels) == 1
    for head in table.labels:
        drawn.add_column("" if single else head, no_wrap=True, min_width=20 if single else None)
    for name in table.columns:
        drawn.add_column(name, justify="right", no_wrap=True)
    for labels, cells in table.rows:
        truth = labels == (TRUTH,)
        if truth:
            drawn.add_section()
        drawn.add_row(*labels, *map(_text, cells), style="dim" if truth else None)
    return drawn


def _text(cell: Entry) -> Text:
    """Mean and spread "0.6±0.3" over the interval "[0.4 0.9]"; "-n" counts draws without an answer, "*" the best."""
    text, summary = Text(cell.text), cell.summary
    if summary is not None:
        missing = f" -{summary.missing}" if summary.missing else ""
        text = Text(f"{summary.mean:.2f}{missing}")
        if not np.isnan(summary.spread):
            star, style = ("*", "bold") if cell.best else ("", "")
            mean = f"{short(summary.mean)}±{short(summary.spread)}{star}{missing}"
            text = Text.assemble((mean, style), (f"\n[{short(summary.low)} {short(summary.high)}]", "dim"))
    if cell.paper is not None:
        text.append(f"\npaper {cell.paper}", style="dim not bold")
    return text
