"""Table of an object's trials: the action, the distance that a push's contact slid, and the range of each hinge."""

from __future__ import annotations

import math

from viz.report.tables import Entry, Table
from viz.trials import TrialsView


def trials_table(view: TrialsView) -> Table:
    """One row per trial: number and action, distance of the contact [mm], and ranges of the joint angles [deg]."""
    pushed = any(action.pushes for action in view.actions)
    hinges = range(0 if view.shape.chain is None else len(view.shape.chain.hinges))
    columns = ["contact slid, mm"] * pushed + [f"hinge {hinge}, deg" for hinge in hinges]
    rows = []
    for number, action in enumerate(view.actions, start=1):
        slid = ["-" if math.isnan(view.slid(number)) else f"{1e3 * view.slid(number):.1f}"] * pushed
        ranges = [_range(*view.joint_range(number, hinge)) for hinge in hinges]
        rows.append(((f"{number}: {action.describe(view.shape)}",), tuple(map(Entry, [*slid, *ranges]))))
    notes = ["contact slid: distance from the first to the last contact point of a push"] * pushed
    notes += ["hinge: least and greatest joint angle"] * bool(hinges)
    return Table(view.title, tuple(columns), tuple(rows), ("trial",), "; ".join(notes))


def _range(least: float, greatest: float) -> str:
    return "-" if math.isnan(least) else f"{round(least, 1) + 0.0:.1f} to {round(greatest, 1) + 0.0:.1f}"
