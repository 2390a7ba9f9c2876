"""Faults of programs while the arm moves: python bench/faults.py [runs of each].

A program drives the fake Gen3 over its wire at 20 mm/s, by twists or to a pose, and is killed, stopped or signalled.
The fake does not stop by itself. Shown are the longest time to the first stop that it was told, the longest way of the
tool until it stood, and what the program said.
"""

from __future__ import annotations

import sys
from pathlib import Path

from rich import box
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))
from tests.fakes.gen3 import FakeGen3  # pyright: ignore[reportMissingImports]
from tests.fakes.robot import small_object  # pyright: ignore[reportMissingImports]
from tests.fakes.wire_faults import WIRE_FAULTS, Way, stopped_after  # pyright: ignore[reportMissingImports]
from tests.fakes.world import Gen3World  # pyright: ignore[reportMissingImports]

WAYS: tuple[Way, Way] = ("twists", "pose")


def main() -> None:
    """Print the table; exit with 1 where the arm was never told to stop."""
    each = int(sys.argv[1]) if len(sys.argv) > 1 else 3
    table = Table(title=f"{each} runs each", title_justify="left", box=box.SIMPLE_HEAD)
    for column in ("fault", "motion", "told to stop after, ms", "moved, mm", "said"):
        table.add_column(column, justify="right" if ", m" in column else "left")
    never = 0
    with FakeGen3(Gen3World(small_object())) as gen3:
        for name, fault in WIRE_FAULTS.items():
            for way in WAYS:
                runs = [stopped_after(gen3, fault, way) for _ in range(each)]
                stop, moved = max(run.stop_s for run in runs), max(run.moved_mm for run in runs)
                never += stop == float("inf")
                table.add_row(name, way, f"{1e3 * stop:.0f}", f"{moved:.1f}", runs[0].said)
    Console(width=150).print(table)
    sys.exit(bool(never))


if __name__ == "__main__":
    main()
