"""`heft run --dry-run`: what a run would do, and about how long it would take."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from estimators.registry import kind_of
from scenarios.config import Scenario

TRIAL_S = 2.8
"""Of one core: a trial of the default policy, on average over the library."""
ESTIMATE_S = {"explicit_state": 1.0, "diff_lcp": 5.0}
"""Of one core: an estimate and its prediction of the held-out turns."""
QUICK_S = 0.4
"""Of any other method."""
DECISION_S = 1.0
"""Of one core: the next touch of an online policy, over 4000 candidates."""


@dataclass(frozen=True)
class Plan:
    """How much a scenario asks for, where nothing goes wrong and nothing is shared."""

    objects: int
    points: int
    """Of the sweep."""
    cells: int
    trials: int
    estimates: int
    seconds: float
    """Of one core."""

    @staticmethod
    def of(scenario: Scenario) -> Plan:
        """Counted point by point of the sweep."""
        points = scenario.points()
        objects = len(scenario.objects) + sum(family.count for family in scenario.random)
        cells = trials = estimates = 0
        seconds = 0.0
        for _, point in points:
            here = objects * len(point.support)
            draws = sum(point.draws(sensing) for sensing in point.sensing)
            each = [ESTIMATE_S.get(kind_of(label, settings), QUICK_S) for label, settings in point.methods.items()]
            in_order = here * len(point.own_draws())
            cells += in_order
            trials += in_order * point.policy.expected_trials
            estimates += here * draws * len(point.methods)
            seconds += in_order * point.policy.expected_trials * TRIAL_S + here * draws * sum(each)
            if point.policy.own_draw:
                seconds += in_order * point.policy.touches * DECISION_S
        return Plan(objects, len(points), cells, trials, estimates, seconds)


def show_plan(console: Console, scenario: Scenario, folder: Path, workers: int) -> None:
    """Say how many trials and estimates there are, and how long they take; nothing is run or written."""
    plan = Plan.of(scenario)
    swept = f" at {plan.points} points of the sweep" if plan.points > 1 else ""
    console.print(
        f"{plan.objects} object(s){swept}, {plan.cells} cells: about {plan.trials} trials and {plan.estimates} "
        f"estimates by {len(scenario.methods)} method(s); trials that points share are made once",
        highlight=False,
    )
    on = max(workers, 1)
    console.print(
        f"about {plan.seconds / on / 60:.0f} min on {on} worker(s), {plan.seconds / 60:.0f} min of computing; into "
        f"{folder}/, where what is done already is not done again",
        highlight=False,
    )
