"""Whole trials over the wires of fakes, in real time: a mass estimate beside the pure simulation's, and command jitter.

    python bench/robot_trial.py [OBJECT] [seconds of a turn each way]

A simulated bench runs in a process of its own. The FT-300S driver reads it over a pseudo terminal, the Kortex process
moves it over TCP, and the real runner does the trials. Four turns there and back take about two minutes, and are
made twice: with an FT-300S's noise, and with a tenth of it, which shows what the path itself costs.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path

import torch
from rich import box
from rich.console import Console
from rich.table import Table

sys.path.insert(0, str(Path(__file__).parents[1]))

from estimators.action_selection.rank import RankDriven
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from testbed.actions.rotate import Rotate
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import Sensing, preset
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.fakes.rig import (  # pyright: ignore[reportMissingImports]
    FT300S,  # pyright: ignore[reportMissingImports]
    QUIET,
    over_wires,
)

TURNS = 4
SHOWN = (
    ("command_late_p99_s", "ms", 1e3),
    ("sensor_gap_s", "ms", 1e3),
    ("feedback_gap_s", "ms", 1e3),
    ("off_path_m", "mm", 1e3),
    ("drift_N", "N", 1.0),
)


def simulated(model: ObjectModel, seconds: float) -> tuple[list[Trajectory], list[Trajectory]]:
    """The pure simulation's trials, with a perfect sensor and with an FT-300S's errors."""
    policy, runner = RankDriven(pivots=TURNS, duration=seconds, accelerated=0), SimulationRunner()
    ideal: list[Trajectory] = []
    felt: list[Trajectory] = []
    while (action := policy.next(model.shape, ideal)) is not None:
        clean = runner.run_clean(Trial(model, action))
        ideal.append(draw_sensing(clean, preset("ideal"), 0))
        felt.append(draw_sensing(clean, preset("ft300s"), len(felt)))
    return ideal, felt


def nad(model: ObjectModel, trajectories: list[Trajectory]) -> float:
    """NAD of hidden_states in percent."""
    answer = HiddenStates().estimate(model.shape, model.total_mass, trajectories, 0)
    assert answer.distribution is not None
    return 100 * normalized_absolute_difference(model.shape, answer.distribution, model.truth)


def reached(model: ObjectModel, ideal: list[Trajectory], noise: Sensing) -> list[Trajectory]:
    """Turns over the wires; ends the program if not all of them come to data."""
    actions = [t.action for t in ideal if isinstance(t.action, Rotate)]
    real = over_wires(model, actions, noise, lambda said: print(said, flush=True))
    if len(real) < len(ideal):
        sys.exit(f"{len(real)} of {len(ideal)} trials came to data: this machine is too busy for real time")
    return real


def main() -> None:
    """Print the table."""
    torch.set_num_threads(1)
    name = sys.argv[1] if len(sys.argv) > 1 else "L2"
    seconds = float(sys.argv[2]) if len(sys.argv) > 2 else 8.0
    model = load_object(name)
    ideal, felt = simulated(model, seconds)
    begin = time.perf_counter()
    quiet, real = (reached(model, ideal, noise) for noise in (QUIET, FT300S))
    took = time.perf_counter() - begin
    table = Table(
        title=f"{name}, {TURNS} turns of {seconds:g} s there and back", title_justify="left", box=box.SIMPLE_HEAD
    )
    for column in ("trials", "NAD, %"):
        table.add_column(column, justify="left" if column == "trials" else "right")
    table.add_row("pure simulation, perfect sensor", f"{nad(model, ideal):.2f}")
    table.add_row("pure simulation, ft300s", f"{nad(model, felt):.2f}")
    table.add_row("real path over fakes, a tenth of ft300s", f"{nad(model, quiet):.2f}")
    table.add_row("real path over fakes, ft300s", f"{nad(model, real):.2f}")
    console = Console(width=100)
    console.print(table)
    figures = {figure: max(t.figures[figure] for t in real) for figure, *_ in SHOWN}
    console.print(f"{took:.0f} s of robot time; largest over the trials:")
    for figure, unit, scale in SHOWN:
        console.print(f"  {figure} {figures[figure] * scale:.3g} {unit}")
    console.print(
        f"  frames {sum(len(t.time_s) for t in real)}, lost {sum(t.figures['lost_frames'] for t in real):.0f}"
    )


if __name__ == "__main__":
    main()
