"""The learned posterior beside others, in its lab and beyond it: python bench/learned.py [--objects N] [--seed S].

Objects and trials of `bench/honesty.py` that no training drew. A row a condition and method; `even` is even masses. NAD
is the median over all answers in percent, with a 95 % interval by a bootstrap over objects, and its mean; then the root
mean square of error over claimed error, the 90 % intervals that hold the truth, the answers with status ok, those of
all with status ok and a group off by more than three times its claimed error, and CPU seconds. Conditions:

lab       three contact patterns that were learned
contacts  two that were not: eight points in a ring, six unlevel ones
rough     errors up to three times as large, stated
hidden    the same, while the lab's are stated
large     blocks of 80 mm, in bars of four and five
rigid     one rigid body on three of its points
"""

from __future__ import annotations

from functools import partial

import numpy as np
from honesty import LAB, ROUGH, Judged, answered, drawn, trials
from shared import head_table, parser_of, pooled, show

from estimators.evaluation.statistics import NINETY
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import ObjectModel

CONDITIONS = {
    "lab": (("random", "corners", "dense"), LAB, LAB),
    "contacts": (("ring", "pressed"), LAB, LAB),
    "rough": (("random", "corners", "dense"), ROUGH, ROUGH),
    "hidden": (("random", "corners", "dense"), ROUGH, LAB),
    "large": (("random", "corners", "dense"), LAB, LAB),
    "rigid": (("three_feet",), LAB, LAB),
}
"""Contact patterns, errors of the setup as drawn, and as stated."""
METHODS = ("learned", "bayes", "hidden_states", "least_squares")


def bar(index: int, seed: int) -> ObjectModel:
    """Bar of four or five large blocks."""
    rng = np.random.default_rng([seed, index])
    count = int(rng.integers(4, 6))
    mass = np.exp(rng.uniform(np.log(0.05), np.log(0.8), count)).tolist()
    shared, cells = [0] * count, parse_layout(["1" * count])
    mu = [float(rng.uniform(0.15, 0.9))]
    of = {"mass": mass, "friction": mu, "friction_group": shared}
    return block_object("bar", cells, size=0.08, height=0.03, grid=3, **of)


def rows_of(job: tuple[str, int], seed: int, methods: tuple[str, ...]) -> list[Judged]:
    """Answers on one object under one condition."""
    name, index = job
    patterns, setup, stated = CONDITIONS[name]
    pattern = patterns[index % len(patterns)]
    obj = bar(index, seed) if name == "large" else drawn(index, seed, pattern)
    made, weight = trials(obj, pattern, setup, stated, np.random.default_rng(seed * 1000 + index))
    found = [answered(method, obj, made, weight, (index, name, pattern)) for method in methods]
    off = obj.total_mass / obj.shape.n_m - obj.group_mass
    even = float(np.abs(off).sum() / obj.total_mass)
    return [*found, Judged(index, name, pattern, "even", "", even, (), np.nan, 0.0, np.nan, (), ())]


def cells(part: list[Judged]) -> list[str]:
    """Cells of the answers of one method under one condition."""
    nad = 100 * np.array([row.nad for row in part if not np.isnan(row.nad)])
    if len(nad) == 0:
        return [part[0].status, "", "", "", "0", "0", ""]
    again = np.random.default_rng(0).choice(nad, (2000, len(nad)))
    low, high = np.quantile(np.median(again, axis=1), [0.025, 0.975])
    found = [f"{np.median(nad):.1f} [{low:.1f}, {high:.1f}]", f"{np.mean(nad):.1f}"]
    if not (claimed := [np.array(row.off) for row in part if len(row.off)]):
        return [*found, "", "", "", "", ""]
    held = np.array([[(np.abs(off) < NINETY).sum(), len(off)] for off in claimed])
    pick = np.random.default_rng(0).integers(len(held), size=(2000, len(held)))
    share = 100 * held[pick].sum(1)[:, 0] / held[pick].sum(1)[:, 1]
    least, most = np.quantile(share, [0.025, 0.975])
    ok = [row for row in part if row.status == "ok"]
    silent = sum(any(abs(z) > 3 for z in row.off) for row in ok)
    every = np.concatenate(claimed)
    return [
        *found,
        f"{np.sqrt(np.mean(every**2)):.2f}",
        f"{100 * held[:, 0].sum() / held[:, 1].sum():.0f} [{least:.0f}, {most:.0f}]",
        f"{100 * len(ok) / len(part):.0f}",
        f"{100 * silent / len(part):.0f}",
        f"{np.mean([row.seconds for row in part]):.2f}",
    ]


def main() -> None:
    """Print the table."""
    parser = parser_of(__doc__, objects=24, seed=1001, methods=list(METHODS), workers=2)
    parser.add_argument("--conditions", nargs="+", choices=CONDITIONS, default=list(CONDITIONS))
    args = parser.parse_args()
    jobs = [(name, index) for name in args.conditions for index in range(args.objects)]
    work = partial(rows_of, seed=args.seed, methods=tuple(args.methods))
    rows = [row for found in pooled(work, jobs, args.workers) for row in found]
    names = ("condition", "method", "NAD", "mean NAD", "error / claimed", "90 % hold", "ok, %", "silent, %", "s")
    table = head_table(*names, left=names)
    for name in args.conditions:
        for method in (*args.methods, "even"):
            table.add_row(name, method, *cells([r for r in rows if (r.world, r.method) == (name, method)]))
    show(table, width=140)


if __name__ == "__main__":
    main()
