"""Answers for drawn objects by what was done to them: heft run random --seeds 1, then python bench/drawn.py DIR.

Rows: objects that turns alone answer; those that were pushed after their turns had left rank(Q) open; and those that no
hand can turn. Columns: objects, those with status ok, median and 90 % quantile of NAD of these, the 90 % intervals of
masses that hold, and objects with status ok and a group off by over 3 claimed errors.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import pandas as pd
from rich import box
from rich.console import Console
from rich.table import Table

from scenarios import load_results
from scenarios.results.store import Store
from testbed import Push


def kind_of(store: Store, keys: list[str]) -> str:
    """Kind of an object's trials, as its row of the table."""
    actions = [store.trajectory(key).action for key in keys]
    pushed, turned = ([isinstance(a, Push) is push for a in actions if a.moves] for push in (True, False))
    return "turns, then pushes" if any(pushed) and any(turned) else "pushes" if any(pushed) else "turns"


def row(name: str, found: pd.DataFrame) -> tuple[str, ...]:
    """Row of the table for some answers."""
    known = found[found["status"] == "ok"]
    off = [
        np.abs(np.array(each.mass_kg) - each.true_mass_kg) / np.array(each.mass_error_kg) for each in known.itertuples()
    ]
    hold = np.mean(np.concatenate(off) <= 1.645) if off else np.nan
    nad = 100 * known["nad"].astype(float)
    silent = sum(each.max() > 3 for each in off)
    figures = (f"{nad.median():.2g}", f"{nad.quantile(0.9):.2g}", f"{100 * hold:.0f}", str(silent))
    return name, str(len(found)), str(len(known)), *figures


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    folder = parser.parse_args().folder
    rows, store = load_results(folder), Store(folder)
    rows = pd.DataFrame(rows[rows["method"] == "hidden_states"])
    kinds = rows["trial_keys"].map(lambda keys: kind_of(store, list(keys)))
    table = Table("trials", "objects", "ok", "NAD, %", "90 %", "90 % hold", "silent", box=box.SIMPLE)
    for kind in ("turns", "turns, then pushes", "pushes"):
        table.add_row(*row(kind, pd.DataFrame(rows[kinds == kind])))
    table.add_row(*row("all", rows))
    Console().print(table)


if __name__ == "__main__":
    main()
