"""NAD in a lab against robot time, with and without a plan and pads: python bench/lab_time.py DIR [--figure FILE].

I1 to F2, or drawn objects, in MuJoCo's lab under an FT-300S, two labs each: turns about the grasps (as `heft run
lab_fixed`) and planned trials (`heft run lab`), on unknown points of contact and on four printed pads a block. Turns
are 2, 4 and 8 there and back with 1, 2 and 4 accelerated ones; plans end after 95, 190 and 380 s. DIR keeps trials and
estimates; a run that was interrupted goes on. Options: --seeds N, --objects NAMES, --drawn N, --family SEED, --planned,
--budgets S ..., --methods NAMES, --workers N, --secret TEXT.
"""

from __future__ import annotations

import argparse
import math
from pathlib import Path
from statistics import fmean

from matplotlib.figure import Figure
from shared import parser_of
from tables import PADS, claimed, markdown, nad_of, objects_of, seconds_of

from estimators.evaluation.statistics import AXIS, Row, methods_of, select, summarize
from scenarios import load_results, load_scenario, run_scenario
from scenarios.cli.run import show_progress
from scenarios.config import Scenario
from scenarios.results.table import rows_of
from testbed.objects.files import ObjectFile
from testbed.toml import load_toml

BUDGETS = [95.0, 190.0, 380.0]
TURNS = {"policy.pivots": [2, 4, 8], "policy.accelerated": [1, 2, 4]}
METHODS = ["bayes", "hidden_states", "least_squares"]
OBJECTS = ["I1", "I2", "L1", "L2", "F1", "F2"]
PADDED = load_scenario("lab_pads")[1].objects
"""Objects on pads."""
KINDS = {
    "turns": ("lab_fixed", False),
    "turns, on pads": ("lab_fixed", True),
    "planned": ("lab", False),
    "planned, on pads": ("lab", True),
}
"""Scenario of each kind of trials, and whether the blocks stand on pads."""


def scenario_of(kind: str, given: argparse.Namespace) -> Scenario:
    """Scenario of a kind of trials, at several robot times."""
    name, on_pads = KINDS[kind]
    found = load_scenario(name)[1].model_dump(exclude_unset=True)
    objects = [path for path in PADDED if Path(path).stem.removesuffix(PADS) in given.objects]
    if given.drawn:
        feet = load_toml(Path(PADDED[0]), ObjectFile).feet if on_pads else None
        family = {"name": "drawn", "count": given.drawn, "seed": given.family}
        found |= {"objects": [], "random": [family | ({} if feet is None else {"feet_m": feet.under_each_m})]}
    else:
        found["objects"] = objects if on_pads else given.objects
    turns = name == "lab_fixed"
    if not turns:
        found["policy"] |= {"touches": 60}  # the budget ends it
    sweep = {"axes": TURNS, "mode": "zip"} if turns else {"axes": {"policy.budget_s": given.budgets}}
    return Scenario.model_validate(
        found | {"seeds": given.seeds, "sweep": sweep, "methods": {m: {} for m in given.methods}}
    )


def sets_of(folder: Path) -> list[tuple[str, list[Row]]]:
    """Method and its answers at every robot time of a run."""
    rows = rows_of(load_results(folder))
    axis = next(name for name in rows[0] if name.startswith(AXIS))
    values = dict.fromkeys(row[axis] for row in rows)
    return [(method, select(rows, method=method, **{axis: value})) for method in methods_of(rows) for value in values]


def within(rows: list[Row]) -> str:
    """Mean NAD in percent of answers to drawn objects, with its interval, bootstrapped over the objects."""
    answered = [row for row in rows if row["nad"] is not None]
    own = [fmean(100 * row["nad"] for row in select(answered, object=name)) for name in objects_of(answered)]
    found = summarize(dict(enumerate(own)))
    return "" if found is None else f"{found.mean:.1f} [{found.low:.1f}, {found.high:.1f}]"


def drawn(sets: dict[str, list[tuple[str, list[Row]]]]) -> Figure:
    """Mean NAD of `bayes` against robot time, a curve for each kind of trials; gaps where a set has no answer."""
    figure = Figure(figsize=(6.4, 3.4), layout="constrained")
    axis = figure.subplots()
    for kind, found in sets.items():
        own = [rows for method, rows in found if method == "bayes"]
        time = [fmean(row["robot_s"] for row in rows) for rows in own]
        nad = [fmean(100 * (math.nan if row["nad"] is None else row["nad"]) for row in rows) for rows in own]
        axis.plot(time, nad, "o-" if "planned" in kind else "s--", label=kind)
    axis.set_ylim(bottom=0)
    axis.set_xlabel("robot time, s")
    axis.set_ylabel("mean NAD, %")
    axis.grid(alpha=0.3)
    axis.legend()
    return figure


def main() -> None:
    """Run what is missing, and print the table."""
    parser = parser_of(
        __doc__, seeds=2, objects=OBJECTS, drawn=0, family=0, budgets=BUDGETS, methods=METHODS, workers=2
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--figure", type=Path)
    parser.add_argument("--planned", action="store_true")
    parser.add_argument("--secret")
    given = parser.parse_args()
    sets = {}
    lines = [["trials", "method", "robot, s", "NAD, mean", "error / claimed", "90 % hold", "silent", "answers"]]
    padded = given.drawn or {*given.objects} & {Path(path).stem.removesuffix(PADS) for path in PADDED}
    for kind, (name, on_pads) in KINDS.items():
        if (given.planned and name != "lab") or (on_pads and not padded):
            continue
        folder = given.folder / kind.replace(", ", "_").replace(" ", "_")
        with show_progress() as progress:
            run_scenario(scenario_of(kind, given), folder, given.workers, progress, secret=given.secret)
        sets[kind] = sets_of(folder)
        for method, rows in sets[kind]:
            answers = f"{sum(row['nad'] is not None for row in rows)} of {len(rows)}"
            nad = within(rows) if given.drawn else nad_of(rows)
            lines.append([kind, f"`{method}`", seconds_of(rows), nad, *claimed(rows), answers])
    print(markdown(lines))
    if given.figure:
        drawn(sets).savefig(given.figure, dpi=150)


if __name__ == "__main__":
    main()
