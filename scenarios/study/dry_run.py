"""Size of a run before it is made: experiments, trials, estimates and seconds."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from rich.console import Console

from estimators.registry import METHODS, check_installed, kind_of
from scenarios.config import Scenario
from scenarios.study.experiment import link_refusal, object_paths
from testbed.errors import InfeasibleTrialError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectShape

TRIAL_S = 0.7
"""Time of a trial of the default policy on one core, on average over the library [s]."""
ESTIMATE_S = {
    "hidden_states": (0.2, 1.0),
    "hidden_states_published": (0.6, 2.5),
    "bayes": (0.3, 1.5),
    "support_aware": (1.5, 7.0),
    "explicit_state": (0.2, 0.7),
    "least_squares": (0.3, 1.5),
    "random_search": (0.35, 1.0),
    "weighted_sampling": (0.35, 1.0),
    "diff_lcp": (1.4, 4.0),
    "mujoco_sysid": (100.0, 300.0),
    "learned": (0.3, 0.4),
}
"""Time of an estimate on one core [s]: in the ideal world, and where the world states errors of a setup."""
OTHER_S = 0.4, 1.2
"""Times of any other estimate by a method of heft's [s]."""
JUDGED_S = 0.4
"""Time to predict the held-out turns by an estimate, and to draw it [s]."""
LINKED = 4.0
"""Factor of the times of an estimate and its prediction for an object with hinges."""
DECISION_S = 1.0
"""Time in which an online policy chooses its next action from 4000 candidates on one core [s]."""


@dataclass(frozen=True)
class DryRun:
    """Size of a scenario's run, where nothing fails."""

    objects: int
    points: int
    """Points of the sweep."""
    experiments: int
    trials: int
    """Trials to be made: once for all points that share them."""
    estimates: int
    seconds: float
    """Computing time on one core [s], without that of methods of unknown cost."""
    unknown: tuple[str, ...] = ()
    """Methods of other packages, whose cost is not known."""

    @staticmethod
    def of(scenario: Scenario) -> DryRun:
        """The size of a scenario's run, counted at each point of the sweep."""
        points = scenario.points()
        shape_of = lru_cache(maxsize=None)(lambda path: load_object(path).shape)
        objects = {name for _, point in points for name in point.all_objects()}
        experiments = trials = estimates = 0
        seconds, unknown, counted = 0.0, dict[str, None](), set[tuple[str, str]]()
        for _, point in points:
            pairs = len(point.all_objects()) * len(point.support)
            linked = sum(shape_of(path).chain is not None for path in point.objects)
            draws = sum(point.draws(sensing) for sensing in point.sensing)
            kinds = {label: kind_of(label, settings) for label, settings in point.methods.items()}
            unknown |= {label: None for label, kind in kinds.items() if kind not in METHODS}
            stated = not point.world.build().none
            draw_s = sum(JUDGED_S + ESTIMATE_S.get(kind, OTHER_S)[stated] for kind in kinds.values() if kind in METHODS)
            experiments += pairs * len(point.own_draws())
            estimates += pairs * draws * len(point.methods)
            seconds += (pairs + (LINKED - 1) * linked * len(point.support)) * draws * draw_s
            fields, runs = _fields_of_trials(point), len(point.support) * len(point.own_draws())
            shapes: dict[str, ObjectShape | None] = {path: shape_of(path) for path in point.objects}
            shapes |= {f"{each!r} {name}": None for each in point.random for name in each.names()}
            new = {(fields, name) for name in shapes} - counted
            counted |= new
            made = runs * sum(point.policy.expected_trials(shapes[name]) for _, name in new)
            trials += made
            seconds += made * TRIAL_S
            if point.policy.kind == "online":
                seconds += runs * len(new) * point.policy.touches * DECISION_S
        return DryRun(len(objects), len(points), experiments, trials, estimates, seconds, tuple(unknown))


def _fields_of_trials(point: Scenario) -> str:
    """Fields of a scenario that determine an object's trials, as text; points of the same text share its trials."""
    fields = point.model_dump(mode="json", exclude={"methods", "sweep", "objects", "random"})
    if not point.truth.friction_spread:
        fields["truth"].pop("seed")
    if point.world.build().none:
        fields.pop("world")
        if not point.policy.own_draw:
            fields.pop("sensing")
            fields.pop("seeds")
    return json.dumps(fields, sort_keys=True)


def check_code(scenario: Scenario, *, foreign: bool = True) -> None:
    """Import and configure every class that a scenario names at any point of its sweep.

    Args:
        scenario: scenario to check.
        foreign: include the classes of other packages: methods, policy, runner.

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


def duration(seconds: float) -> str:
    """Duration in seconds, or from two minutes on in minutes."""
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min"


def show_dry_run(console: Console, scenario: Scenario, folder: Path, workers: int) -> None:
    """Print the number of trials and estimates and the time that they take; nothing is run, imported or written.

    Raises:
        HeftError: an object that cannot be read or has links that the policy cannot handle, or a method that lacks a
            package.
    """
    check_code(scenario, foreign=False)
    refusals = [
        link_refusal(point, load_object(path))
        for _, point in scenario.points()
        for path in object_paths(point).values()
    ]
    left_out = dict.fromkeys(filter(None, refusals))
    if left_out and all(refusals) and not scenario.random:
        raise InfeasibleTrialError("\n".join(left_out))
    for reason in left_out:
        console.print(f"left out: {reason}")
    size = DryRun.of(scenario)
    swept = f" at {size.points} points of the sweep" if size.points > 1 else ""
    console.print(
        f"{size.objects} object(s){swept}, {size.experiments} experiments: about {size.trials} trials and "
        f"{size.estimates} estimates by {len(scenario.methods)} method(s)",
    )
    on = max(workers, 1)
    console.print(
        f"about {duration(size.seconds / on)} on {on} worker(s), {duration(size.seconds)} of computing; into "
        f"{folder}/, where finished trials and estimates are kept",
    )
    if size.unknown:
        console.print(f"without the estimates by {', '.join(size.unknown)}, whose time is not known")
