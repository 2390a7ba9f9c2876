"""Results as tables on a terminal."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
from rich import box
from rich.table import Table

PAPER_NAD = {"I1": 7.4, "I2": 9.2, "L1": 10.1, "L2": 7.3, "F1": 8.5, "F2": 14.2}
"""NAD of the paper's own approach on the real robot, percent (tab:nad)."""
SUPPORT_NAMES = {"own_weight": "own weight", "rigid": "rigid body"}


def nad_table(results: pd.DataFrame, objects: list[str]) -> Table:
    """NAD in percent, object by support, sensing and method: mean and spread over the draws."""
    rows = results.to_dict("records")
    table = _table("Normalized absolute difference of the mass distribution (NAD), %", objects)
    several = len({row["method"] for row in rows}) > 1
    support = None
    for kind in dict.fromkeys((row["support"], row["sensing"], row["method"]) for row in rows):
        if support not in (None, kind[0]):
            table.add_section()
        support = kind[0]
        label = f"{SUPPORT_NAMES.get(support, support)}, {kind[1]}" + (f", {kind[2]}" if several else "")
        of_kind = [row for row in rows if (row["support"], row["sensing"], row["method"]) == kind]
        table.add_row(label, *(_cell([row for row in of_kind if row["object"] == name]) for name in objects))
    if any(name in PAPER_NAD for name in objects):
        table.add_section()
        table.add_row("paper, real robot", *(str(PAPER_NAD.get(name, "")) for name in objects), style="dim")
    return table


def hidden_table(results: pd.DataFrame, objects: list[str]) -> Table:
    """Errors of the centre of mass and of I_cm where blocks rest on their own weight: mean size over the draws."""
    table = _table("Hidden states, own weight: mean error", objects)
    rows = [row for row in results.to_dict("records") if row["support"] == "own_weight" and row["status"] == "ok"]
    for column, scale, label in (("com_error_m", 1e3, "c, mm"), ("inertia_error", 100, "I_cm, %")):
        for sensing in dict.fromkeys(row["sensing"] for row in rows):
            cells = []
            for name in objects:
                found = [row for row in rows if row["object"] == name and row["sensing"] == sensing]
                values = [row[column] for row in found]
                seen = np.abs([value for value in values if value is not None and not np.isnan(value)]) * scale
                confounded = any("confounded" in row["unobserved"] for row in found)
                cells.append(f"{seen.mean():.2f}" if len(seen) else "confounded" if confounded else "not felt")
            table.add_row(f"{label}, {sensing}", *cells)
    return table


def _table(title: str, objects: list[str]) -> Table:
    table = Table(title=title, title_justify="left", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    table.add_column("", no_wrap=True)
    for name in objects:
        table.add_column(name, justify="right", no_wrap=True)
    return table


def _cell(rows: list[dict[Any, Any]]) -> str:
    """Mean and standard deviation over draws, or why there is no number; "-n" counts draws without an answer."""
    good = [100 * row["nad"] for row in rows if row["nad"] is not None and not np.isnan(row["nad"])]
    if not good:
        return rows[0]["status"] if rows else "-"
    missing = f" -{len(rows) - len(good)}" if len(good) < len(rows) else ""
    if len(good) == 1:
        return f"{good[0]:.2f}{missing}"
    return f"{np.mean(good):.1f}±{np.std(good, ddof=1):.1f}{missing}"
