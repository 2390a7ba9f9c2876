"""Algorithm 1 beside the field's optimisers, on the known blocks that the conformance kit ships: no simulator.

    python bench/peers.py [DRAWS]      about two minutes of one core with five draws

Every method is given the same seven trials of each block on its own weight, felt by an FT-300S, and M. Here
`explicit_state` is the paper's baseline with M and errors by their covariance, `explicit_state_M_cov` of `blocks`.
"""

from __future__ import annotations

import sys
from statistics import mean, median

import torch
from rich import box
from rich.console import Console
from rich.table import Table

from estimators.cma_es import CmaEs
from estimators.explicit_state import ExplicitState
from estimators.hidden_states import HiddenStatesEstimator
from estimators.least_squares import LeastSquares
from estimators.metrics import normalized_absolute_difference
from estimators.nelder_mead import NelderMead
from estimators.protocol import Estimator
from estimators.testing.recorded import load_block

METHODS: dict[str, Estimator] = {
    "hidden_states": HiddenStatesEstimator(),
    "least_squares": LeastSquares(),
    "cma_es": CmaEs(),
    "nelder_mead": NelderMead(),
    "explicit_state": ExplicitState(use_weight=True, weighting="covariance"),
}
OBJECTS = ("I1", "I2", "L1", "L2", "F1", "F2", "T", "U", "drawn_a", "drawn_b", "drawn_d")


def main(draws: int) -> None:
    """Print a row a method: median NAD of every block, losses evaluated and seconds on average."""
    torch.set_num_threads(1)
    table = Table("NAD, %", box=box.SIMPLE_HEAD, padding=(0, 1, 0, 0))
    for column in (*OBJECTS, "losses", "s"):
        table.add_column(column, justify="right")
    for name, method in METHODS.items():
        cells, losses, seconds = [], [], []
        for known in OBJECTS:
            block, nads = load_block(f"{known}-own_weight"), []
            for seed in range(draws):
                shape = block.model.shape
                answer = method.estimate(shape, block.weighed("ft300s", seed), block.trials("ft300s", seed), seed)
                assert answer.distribution is not None, answer.message
                nads.append(100 * normalized_absolute_difference(shape, answer.distribution, block.model.truth))
                losses.append(sum(len(trace.loss) for trace in answer.traces))
                seconds.append(answer.seconds)
            cells.append(f"{median(nads):.1f}")
        table.add_row(name, *cells, f"{mean(losses):.0f}", f"{mean(seconds):.2g}")
    Console(width=120).print(table)


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 5)
