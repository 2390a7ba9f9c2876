"""Table of an object's trials: each action in words, how far a push's contact slid, and how far each hinge turned."""

from __future__ import annotations

import math

from viz.report.tables import Entry, Table
from viz.trials import TrialsView


def trials_table(view: TrialsView) -> Table:
    """A row per trial: its number, its action, and what moved."""
    pushed = any(action.pushes for action in view.actions)
    hinges = range(0 if view.shape.chain is None else len(view.shape.chain.hinges))
    columns = ["contact slid, mm"] * pushed + [f"hinge {hinge}, deg" for hinge in hinges]
    rows = []
    for number, action in enumerate(view.actions, start=1):
        slid = ["-" if math.isnan(view.slid(number)) else f"{1e3 * view.slid(number):.1f}"] * pushed
        ranges = [_range(*view.joint_range(number, hinge)) for hinge in hinges]
        rows.append(((f"{number}: {action.describe(view.shape)}",), tuple(map(Entry, [*slid, *ranges]))))
    said = ["contact slid: from where a push meets the object to where it last touched it"] * pushed
    said += ["hinge: least and greatest joint angle"] * bool(hinges)
    return Table(view.title, tuple(columns), tuple(rows), ("trial",), "; ".join(said))


def _range(least: float, greatest: float) -> str:
    return "-" if math.isnan(least) else f"{round(least, 1) + 0.0:.1f} to {round(greatest, 1) + 0.0:.1f}"
