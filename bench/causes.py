"""Faults three times as large as stated, and what the doctor says: python bench/causes.py [--objects N] [--seed S].

Objects and trials are those of `bench/honesty.py`, on three or four points a block. Every error is drawn with a root
mean square of exactly its stated size, that of one with three times. A row a fault: objects of which the diagnosis
ranks it first, or as likely as the first within a factor of ten; objects of which it is named, and of which another one
is named in its place; median odds of the fault; its true size, and the median of its size as found. Below, what the
first one was where it was not the fault; and objects in a lab as stated of which a fault is named.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from honesty import LAB, drawn, trials
from shared import head_table, parser_of, pooled, show

from estimators.posterior.diagnosis import DECISIVE, ENLARGED, Diagnosis, diagnose
from testbed.worlds.setup_errors import PARAMETERS

FAULTS = (
    "group_friction",
    "place_friction",
    "anisotropy",
    "speed_friction",
    "table_tilt",
    "particle_offset",
    "grasp_offset",
    "grasp_angle",
    "tcp_offset",
    "tcp_angle",
    "gain",
    "crosstalk",
    "mounting_angle",
)
NONE = "none"
"""Fault of a lab as stated."""


class OfSize(np.random.Generator):
    """Random numbers whose normal draws have a root mean square of exactly one."""

    def standard_normal(self, *args: Any, **more: Any) -> Any:
        """Draws of a standard normal distribution, scaled."""
        z = np.asarray(super().standard_normal(*args, **more))
        return z / np.sqrt(np.mean(z**2))

    def uniform(self, *args: Any, **more: Any) -> Any:
        """Draws between two numbers; their root mean square where none are given."""
        return super().uniform(*args, **more) if args else 3**-0.5


@dataclass(frozen=True)
class Found:
    """Diagnosis of one object with one fault."""

    fault: str
    first: str
    """Likeliest cause."""
    odds: float
    """Decimal logarithm of the odds of the fault."""
    behind: float
    """Decimal logarithm of the odds of the likeliest cause, less that of the fault."""
    size: float
    named: str
    """Cause that is named; empty if none is."""


def diagnosed(job: tuple[str, int], seed: int) -> Found:
    """Diagnosis of one object with one fault."""
    fault, index = job
    obj, setup = drawn(index, seed, "random"), LAB
    if fault != NONE:
        setup = replace(LAB, **{fault: ENLARGED * getattr(LAB, fault)})
    rng = OfSize(np.random.PCG64([seed, index, 1]))  # draws apart from those of the object
    made, weight = trials(obj, "random", setup, LAB, rng)
    found = diagnose(obj.shape, weight, made)
    assert found is not None
    return judged(fault, found)


def judged(fault: str, found: Diagnosis) -> Found:
    """A diagnosis held against the fault."""
    if not found.causes:
        return Found(fault, "", np.nan, np.inf, np.nan, "")
    first, *_ = found.causes
    own = next((cause for cause in found.causes if cause.name == fault), first)
    named = found.named[0].name if found.named else ""
    return Found(fault, first.name, own.odds, first.odds - own.odds, own.size, named)


def main() -> None:
    """Print the table."""
    args = parser_of(__doc__, objects=4, seed=1, workers=2).parse_args()
    jobs = [(fault, index) for fault in (*FAULTS, NONE) for index in range(args.objects)]
    rows = pooled(partial(diagnosed, seed=args.seed), jobs, args.workers)
    columns = ("fault", "first", "within 10", "named", "another named", "log10 odds", "true size", "size found")
    table = head_table(*columns, left=("fault",))
    for fault in FAULTS:
        part = [row for row in rows if row.fault == fault]
        counts = [
            sum(row.first == fault for row in part),
            sum(row.behind < 1 for row in part),
            sum(row.named == fault for row in part),
            sum(row.named not in ("", fault) for row in part),
        ]
        sizes = [ENLARGED * getattr(LAB, fault), float(np.nanmedian([row.size for row in part]))]
        shown = [PARAMETERS[fault].formatted(size) for size in sizes]
        table.add_row(fault, *map(str, counts), f"{np.nanmedian([row.odds for row in part]):.1f}", *shown)
    lines: list[Any] = [table]
    faulty = [row for row in rows if row.fault != NONE]
    first, near = sum(row.first == row.fault for row in faulty), sum(row.behind < 1 for row in faulty)
    lines.append(f"first {first}, within a factor of ten {near}, of {len(faulty)}; named: odds over 10^{DECISIVE:g}")
    for fault in FAULTS:
        others = Counter(row.first or "support or trial" for row in faulty if row.fault == fault != row.first)
        if others:
            lines.append(f"{fault}: " + ", ".join(f"{name} {count}" for name, count in others.most_common()))
    wrong = Counter(row.named for row in rows if row.fault == NONE and row.named)
    show(*lines, f"{NONE}: {dict(wrong) or 'none named'} of {args.objects}", width=140)


if __name__ == "__main__":
    main()
