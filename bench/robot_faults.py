"""Outcomes of every fault of the real robot: python bench/robot_faults.py [runs of each kind].

Each kind strikes a trial on the fake robot at random moments, in simulated time. After a stop, or after the arm's last
feedback, nothing may drive the arm for longer than 150 ms; no record that is wrong may be marked ok. The judge is the
truth of the fake robot: its sensor before the fault, and the object's true place in the hand.
"""

from __future__ import annotations

import sys
from collections import Counter
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.fakes.faults import BOUND, FAULTS, Outcome, struck_by  # pyright: ignore[reportMissingImports]


def row(outcomes: list[Outcome]) -> tuple[str, ...]:
    """A kind's line of the table."""
    ended = Counter(outcome.ended for outcome in outcomes)
    loss = [outcome.after_loss for outcome in outcomes if outcome.after_loss]
    return (
        outcomes[0].fault,
        ", ".join(f"{count} {name}" for name, count in ended.most_common()),
        f"{1e3 * max(outcome.after_stop for outcome in outcomes):.0f}",
        f"{1e3 * max(loss):.0f}" if loss else "",
        f"{1e3 * max(outcome.rolled for outcome in outcomes):.0f}",
        str(sum(bool(outcome.wrong) for outcome in outcomes)),
    )


def main() -> None:
    """Print the table; exit with 1 where a bound was passed."""
    each = int(sys.argv[1]) if len(sys.argv) > 1 else 7
    table = Table(title=f"{len(FAULTS)} kinds of fault, {each} runs each", title_justify="left", box=box.SIMPLE_HEAD)
    for column in ("fault", "ended", "driven after stop, ms", "after loss, ms", "rolled, ms", "wrong ok"):
        table.add_column(column, justify="left" if column in ("fault", "ended") else "right")
    everything: list[Outcome] = []
    for fault in FAULTS:
        outcomes = [struck_by(fault, seed) for seed in range(each)]
        everything += outcomes
        table.add_row(*row(outcomes))
        for outcome in outcomes:
            if outcome.wrong:
                print(f"{outcome.fault}, seed {outcome.seed}, at {outcome.struck:.2f} s: {outcome.wrong}", flush=True)
    Console(width=130).print(table)
    late = [o for o in everything if o.after_stop > BOUND or o.after_loss > BOUND]
    print(f"{len(everything)} runs: {len(late)} driven too long, {sum(bool(o.wrong) for o in everything)} wrongly ok")
    sys.exit(bool(late or any(o.wrong for o in everything)))


if __name__ == "__main__":
    main()
