"""`heft run --dry-run`: what a run would do, and about how long it would take."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console

from scenarios.methods import kind_of
from scenarios.schema import Scenario

TRIAL_S = 2.8
"""Of one core: a trial of the default policy, on average over the library."""
ESTIMATE_S = {"explicit_state": 1.0, "diff_lcp": 5.0}
"""Of one core: an estimate and its prediction of the held-out turns."""
QUICK_S = 0.4
"""Of any other method."""


def show_plan(console: Console, scenario: Scenario, folder: Path, workers: int) -> None:
    """Say how many trials and estimates there are, and how long they take; nothing is run or written."""
    points = scenario.points()
    objects = len(scenario.objects) + sum(family.count for family in scenario.random)
    cells = trials = estimates = 0
    seconds = 0.0
    for _, point in points:
        here = objects * len(point.support)
        draws = sum(1 if sensing == "ideal" else point.seeds for sensing in point.sensing)
        cells += here
        trials += here * point.policy.expected_trials
        estimates += here * draws * len(point.methods)
        of_methods = [ESTIMATE_S.get(kind_of(label, settings), QUICK_S) for label, settings in point.methods.items()]
        seconds += here * (point.policy.expected_trials * TRIAL_S + draws * sum(of_methods))
    swept = f" at {len(points)} points of the sweep" if len(points) > 1 else ""
    console.print(
        f"{objects} object(s){swept}, {cells} cells: about {trials} trials and {estimates} estimates by "
        f"{len(scenario.methods)} method(s); trials that points share are made once",
        highlight=False,
    )
    on = max(workers, 1)
    console.print(
        f"about {seconds / on / 60:.0f} min on {on} worker(s), {seconds / 60:.0f} min of computing; into {folder}/, "
        "where what is done already is not done again",
        highlight=False,
    )
