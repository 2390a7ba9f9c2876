"""Growth of an estimate's time and memory with particles, blocks and draws: python bench/growth.py [METHOD ...].

On trials from the exact Coulomb world of the tests. Each case is a process of its own, whose peak memory is a worker's.
"""

from __future__ import annotations

import math
import resource
import subprocess
import sys
import time
from typing import Any

import torch
from shared import head_table, show

from estimators.baselines.diff_lcp import DiffLcp
from estimators.baselines.explicit_state import ExplicitState
from estimators.baselines.sampling import RandomSearch, WeightedSampling
from estimators.hidden_states.estimator import HiddenStates
from estimators.posterior.estimator import Bayes
from estimators.testing.analytic_world import accelerated, turns
from scenarios.study.estimates import MOST_PARTICLES
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel

METHODS: dict[str, Any] = {
    "bayes": Bayes(),
    "hidden_states": HiddenStates(),
    "random_search": RandomSearch(),
    "weighted_sampling": WeightedSampling(),
    "explicit_state": ExplicitState(),
    "diff_lcp": DiffLcp(iterations=50),
}
SIZES = {"particles": (54, 486, 10_086), "blocks": (6, 12, 30), "draws": (2, 20, 200)}
"""Particles of six blocks; blocks of nine particles, with turns about each; draws of six blocks of nine particles."""


def model_of(axis: str, size: int) -> ObjectModel:
    """The L of six blocks, or a comb of blocks."""
    if axis == "blocks":
        layout = parse_layout(["1" * (2 * size // 3), "10" * (size // 3)])
        return block_object("comb", layout, size=0.05, height=0.03, mass=[0.1 + 0.01 * i for i in range(size)],
                            friction=[0.5], friction_group=[0] * size, grid=3)  # fmt: skip
    return load_object("L2", math.isqrt(size // 6) if axis == "particles" else 3)


def measure(name: str, axis: str, size: int) -> tuple[float, float]:
    """CPU time of the estimates, s, and peak memory of this process, MiB; batches are as large as in a run."""
    torch.set_num_threads(1)
    method, obj = METHODS[name], model_of(axis, size)
    count = size if axis == "draws" else 1
    levels = [0.02 * (1 + 0.01 * k) for k in range(count)]  # N: no two draws alike
    draws = [turns(obj, noise=level) + accelerated(obj, [0, 1, 2, 3], noise=level) for level in levels]
    weights, most = [obj.total_mass] * count, max(MOST_PARTICLES // len(obj.shape.particles), 1)
    begin = time.process_time()
    if hasattr(method, "estimate_many"):
        for k in range(0, count, most):
            part = slice(k, k + most)
            method.estimate_many(obj.shape, weights[part], draws[part], range(count)[part])
    else:
        for k in range(count):
            method.estimate(obj.shape, weights[k], draws[k], k)
    return time.process_time() - begin, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def main() -> None:
    """Print one table; with the name of a case, its two numbers."""
    if len(sys.argv) == 4 and sys.argv[2] in SIZES:
        print(*measure(sys.argv[1], sys.argv[2], int(sys.argv[3])))
        return
    columns = ("method", "axis", "sizes", "CPU s", "exponent", "peak MiB")
    table = head_table(*columns, left=columns)
    for name in sys.argv[1:] or METHODS:
        for axis, sizes in SIZES.items():
            cases = []
            for size in sizes:
                command = [sys.executable, __file__, name, axis, str(size)]
                words = subprocess.run(command, check=True, capture_output=True, text=True).stdout.split()
                cases.append((float(words[0]), float(words[1])))
            grown = math.log(cases[-1][0] / cases[0][0]) / math.log(sizes[-1] / sizes[0])
            seconds, memory = (" / ".join(f"{x:.3g}" for x in column) for column in zip(*cases, strict=True))
            table.add_row(name, axis, " / ".join(map(str, sizes)), seconds, f"{grown:.2f}", memory)
    show(table, width=120)


if __name__ == "__main__":
    main()
