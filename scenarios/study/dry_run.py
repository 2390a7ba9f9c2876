"""Size of a run before it is made: experiments, trials, estimates and seconds."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from estimators.registry import METHODS, check_installed, kind_of
from scenarios.config import Scenario
from scenarios.study.experiment import object_paths
from testbed.errors import InvalidValueError

TRIAL_S = 0.7
"""Time of a trial of the default policy on one core, on average over the library [s]."""
ESTIMATE_S = {"hidden_states_published": 1.0, "diff_lcp": 1.6}
"""Time of an estimate and its prediction of the held-out turns on one core [s]."""
QUICK_S = 0.2
"""Time of any other method's estimate [s]."""
DECISION_S = 1.0
"""Time in which an online policy chooses its next action from 4000 candidates on one core [s]."""


@dataclass(frozen=True)
class DryRun:
    """Size of a scenario's run, where nothing fails and nothing is shared."""

    objects: int
    points: int
    """Points of the sweep."""
    experiments: int
    trials: int
    estimates: int
    seconds: float
    """Computing time on one core [s]."""

    @staticmethod
    def of(scenario: Scenario) -> DryRun:
        """The size of a scenario's run, counted at each point of the sweep."""
        points = scenario.points()
        objects = len(scenario.objects) + sum(family.count for family in scenario.random)
        experiments = trials = estimates = 0
        seconds = 0.0
        for _, point in points:
            here = objects * len(point.support)
            draws = sum(point.draws(sensing) for sensing in point.sensing)
            each = [ESTIMATE_S.get(kind_of(label, settings), QUICK_S) for label, settings in point.methods.items()]
            in_order = here * len(point.own_draws())
            experiments += in_order
            trials += in_order * point.policy.expected_trials
            estimates += here * draws * len(point.methods)
            seconds += in_order * point.policy.expected_trials * TRIAL_S + here * draws * sum(each)
            if point.policy.kind == "online":
                seconds += in_order * point.policy.touches * DECISION_S
        return DryRun(objects, len(points), experiments, trials, estimates, seconds)


def check_code(scenario: Scenario, *, foreign: bool = True) -> None:
    """Check that every class which the scenario names, at any point of its sweep, can be used: import it, set it up.

    Args:
        scenario: what is to run.
        foreign: also those of other packages: methods, policy, runner.

    Raises:
        HeftError: no such class, a setting that it refuses, or a package that it lacks.
    """
    for _, point in scenario.points():
        for label, settings in point.methods.items():
            if foreign or kind_of(label, settings) in METHODS:
                check_installed(label, settings)
        tables = {"policy": point.policy, "simulation": point.simulation} if foreign else {}
        for name, table in tables.items():
            try:
                table.check_code()
            except InvalidValueError as error:
                raise InvalidValueError(f"{name}.{error.field}", error.given, error.allowed) from None


def show_dry_run(console: Console, scenario: Scenario, folder: Path, workers: int) -> None:
    """Print how many trials and estimates there are, and how long they take; nothing is run, imported or written.

    Raises:
        HeftError: an object that cannot be read, or a method that lacks a package.
    """
    check_code(scenario, foreign=False)
    for _, point in scenario.points():
        object_paths(point)
    size = DryRun.of(scenario)
    swept = f" at {size.points} points of the sweep" if size.points > 1 else ""
    console.print(
        f"{size.objects} object(s){swept}, {size.experiments} experiments: about {size.trials} trials and "
        f"{size.estimates} estimates by {len(scenario.methods)} method(s); trials that points share are made once",
    )
    on = max(workers, 1)
    console.print(
        f"about {size.seconds / on / 60:.0f} min on {on} worker(s), {size.seconds / 60:.0f} min of computing; into "
        f"{folder}/, where what is done already is not done again",
    )
