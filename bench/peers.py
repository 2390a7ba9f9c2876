"""Algorithm 1 beside the paper's baselines and the field's tools.

    python bench/peers.py kit [DRAWS]    recorded blocks of the conformance kit: two minutes of one core with five draws
    python bench/peers.py nine [FOLDER]  all nine methods on the simulated bench: half an hour of one core
    python bench/peers.py rigid          the toolbox and `support_aware` where one rigid body hides the masses: minutes

In `kit` every method is given the same seven trials of a block on its own weight, felt by an FT-300S, and M;
`explicit_state` is the paper's baseline with M and errors by their covariance, `explicit_state_M_cov` of `blocks`.
`nine` is `heft run bench/peers.toml`, needs the extra sysid, and goes on where it was left.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from statistics import mean, median

import torch
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.base import Estimator
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.mujoco_sysid import MujocoSysid
from estimators.baselines.optimizers import CmaEs, LeastSquares, NelderMead
from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.hidden_states.estimator import HiddenStates
from estimators.support_models.estimator import SupportAware
from estimators.testing.recorded import load_block
from scenarios.cli.main import main as heft
from scenarios.results.estimates import load_results

METHODS: dict[str, Estimator] = {
    "hidden_states": HiddenStates(),
    "least_squares": LeastSquares(),
    "cma_es": CmaEs(),
    "nelder_mead": NelderMead(),
    "explicit_state": ExplicitState(use_weight=True, weighting="covariance"),
}
RIGID: dict[str, Estimator] = {"mujoco_sysid": MujocoSysid(support="rigid"), "support_aware": SupportAware()}
OBJECTS = ("I1", "I2", "L1", "L2", "F1", "F2", "T", "U", "drawn_a", "drawn_b", "drawn_d")


def kit(draws: int) -> None:
    """Print a row a method: median NAD of every block, guesses held against the data and seconds on average."""
    table = _table("NAD, %", (*OBJECTS, "rollouts", "s"))
    for name, method in METHODS.items():
        cells, rollouts, seconds = [], [], []
        for known in OBJECTS:
            block, nads = load_block(f"{known}-own_weight"), []
            for seed in range(draws):
                shape = block.model.shape
                answer = method.estimate(shape, block.weighed("ft300s", seed), block.trials("ft300s", seed), seed)
                assert answer.distribution is not None, answer.message
                nads.append(100 * normalized_absolute_difference(shape, answer.distribution, block.model.truth))
                rollouts.append(answer.diagnostics.get("rollouts", 0))
                seconds.append(answer.seconds)
            cells.append(f"{median(nads):.1f}")
        table.add_row(name, *cells, f"{mean(rollouts):.0f}", f"{mean(seconds):.2g}")
    Console(width=120).print(table)


def nine(folder: str) -> None:
    """Run the scenario and print, a sensor a table, a row a method: NAD of every object, the rest on average."""
    heft(["run", str(Path(__file__).with_suffix(".toml")), "--out", folder])
    results = load_results(folder)
    names = list(dict.fromkeys(results["object"]))
    for sensing, rows in results.groupby("sensing", sort=False):
        table = _table(f"{sensing}: NAD, %", (*names, "MPD, cm", "s", "rollouts", "robot s"))
        for method, own in rows.groupby("method", sort=False):
            nads = [f"{100 * own[own['object'] == name]['nad'].mean():.1f}" for name in names]
            rest = (100 * own["mpd_open_loop_m"].mean(), own["seconds"].mean())
            table.add_row(
                str(method),
                *nads,
                *(f"{v:.2g}" for v in rest),
                f"{own['rollouts'].fillna(0).mean():.0f}",
                f"{own['robot_s'].mean():.0f}",
            )
        best = 100 * rows["mpd_open_loop_of_truth_m"].mean()
        table.add_row("the true masses", *[""] * len(names), f"{best:.2g}", "", "", "")
        Console(width=120).print(table)


def rigid() -> None:
    """Print NAD, misfit, the widest standard error of a block and the status under one rigid body, a perfect sensor."""
    table = _table("one rigid body, ideal", ("block", "NAD, %", "misfit", "widest error, kg", "status", "s"))
    for known, (name, method) in product(("I2", "L2", "F2"), RIGID.items()):
        block = load_block(f"{known}-rigid")
        answer = method.estimate(block.model.shape, block.weighed("ideal", 0), block.trials("ideal", 0), 0)
        error = answer.group_error(block.model.shape)
        assert answer.distribution is not None and error is not None, answer.message
        nad = normalized_absolute_difference(block.model.shape, answer.distribution, block.model.truth)
        misfit = answer.diagnostics.get("misfit")
        row = (
            f"{100 * nad:.1f}",
            "" if misfit is None else f"{misfit:.2g}",
            f"{error.max():.2g}",
            answer.status,
            f"{answer.seconds:.2g}",
        )
        table.add_row(name, known, *row)
    Console(width=120).print(table)


def _table(title: str, columns: Sequence[str]) -> Table:
    table = Table(title, box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in columns:
        table.add_column(column, justify="right")
    return table


if __name__ == "__main__":
    torch.set_num_threads(1)
    part, *given = sys.argv[1:] or ["kit"]
    if part == "nine":
        nine(*given or ["results/peers"])
    elif part == "rigid":
        rigid()
    else:
        kit(int(given[0]) if given else 5)
