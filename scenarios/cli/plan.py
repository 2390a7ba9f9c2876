"""heft identify and heft plan: expected errors of masses by given trials, and plans of informative trials."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro
from rich.table import Table
from rich.text import Text

from scenarios.cli.terminal import default_hint, open_console, open_table, percent, seconds
from testbed.errors import InvalidValueError
from testbed.validation import Range, check_integer

if TYPE_CHECKING:
    from collections.abc import Iterator

    from estimators.action_selection.candidates import ActionFamily
    from estimators.action_selection.design import Belief, Guess
    from estimators.action_selection.plan import Goal, Plan
    from estimators.identifiability.report import Identifiability
    from testbed.actions.base import Action
    from testbed.objects.model import ObjectModel, ObjectShape
    from viz.values import PlanView

MOST_REJECTED = 5
"""Number of refusals that are printed."""
MOST_NAMED = 3
"""Number of groups that a row of the table names."""


def identify(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    world: Annotated[str, tyro.conf.arg(metavar="WORLD")] = "ideal",
    assumed_support: Literal["own_weight", "rigid"] | None = None,
    pivots: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    accelerated: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    slides: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    lifts: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    pushes: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 18.0,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Predict how well trials of an object determine its masses: expected errors, and what stays unidentifiable.

    Examples: heft identify L2
              heft identify F2 --assumed-support rigid --sensing ideal
              heft identify L2 --assumed-support rigid --lifts 1
              heft identify L2 --world lab --pivots 12
              heft identify L2 --pivots 0 --pushes 12
              heft identify L2 --pivots 0 --slides 6 --out results/L2_slides

    Args:
        object_: name in the library, or path to a TOML file.
        sensing: preset of the sensor, and of the camera for pushes.
        world: world whose setup errors are assumed: ideal, lab or rough.
        assumed_support: default: rigid for an object with contact points, otherwise own_weight.
        pivots: number of turns there and back, drawn by the rank-driven policy; 0 also drops the accelerated turns. An
            object with hinges gets random one-way turns and no accelerated ones.
        accelerated: number of accelerated turns.
        slides: number of slides, in directions spread over the circle; random for an object with hinges.
        lifts: number of lifts, held still and rocked in the air, at the grasps nearest the middle; rigid support only.
        pushes: number of pushes at random faces, points and directions; an object without grasps can only be pushed.
        duration: duration of a turn each way, s.
        grasps: allowed grasps, by name (see heft show); default: all, reachable or not.
        out: heatmap of the standard errors in g, written as FILE.pdf and FILE.png.
    """
    from estimators.identifiability.information import Assumptions, expected
    from estimators.identifiability.report import hardly_known
    from testbed.objects.files import load_object
    from testbed.sensing.presets import preset
    from testbed.worlds.presets import world as world_of
    from viz.figures.maps import error_figure, save_figure

    console, model = open_console(), load_object(object_)
    carrier = carrier_of(model, assumed_support)
    actions = actions_of(model, carrier, pivots, accelerated, slides, lifts, pushes, duration, grasps)
    assumed = Assumptions(carrier, setup=world_of(world).stated, hinge_friction=model.hinge_friction or None)
    report = expected(model.shape, model.truth, actions, preset(sensing), assumed)
    kinds = [action.kind for action in actions]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    title = f"{model.name}, {carrier}, {sensing}" + ("" if world == "ideal" else f", {world}")
    console.print(Text.assemble((title, "bold"), f": {counts}"))
    console.print(_errors_table(model, report))
    condition = f"condition {report.condition:.0f}" if math.isfinite(report.condition) else "nothing is observed"
    console.print(f"{report.sentence}; {condition}")
    if not model.shape.grasps and not pushes:
        console.print("no grasp fits the hand, so nothing turns: --pushes 12 has pushes")
    count = model.shape.particles_per_group
    loose = hardly_known(model.shape, model.truth.mass, report.covariance / np.outer(count, count))
    if loose and report.rank == report.unknowns:
        console.print(loose)
    if out is not None:
        for path in save_figure(error_figure(model, report.standard_error, title), out):
            print(path)


def actions_of(
    model: ObjectModel,
    support: str = "own_weight",
    pivots: int = 6,
    accelerated: int = 6,
    slides: int = 0,
    lifts: int = 0,
    pushes: int = 0,
    duration: float = 18.0,
    grasps: tuple[str, ...] | None = None,
) -> list[Action]:
    """Weighing, actions of the rank-driven policy, slides in spread directions, lifts and random pushes.

    An object with hinges gets random one-way turns and slides at constant speed. Lifts use the grasps nearest the
    middle, where the weight of the object has the least moment. Arguments are those of `identify`.

    Raises:
        InvalidValueError: a grasp that the object does not have, or a count that is not allowed.
    """
    from estimators.action_selection.random import random_drags, random_pushes
    from estimators.action_selection.rank import RankDriven
    from testbed.actions.lift import Lift
    from testbed.actions.slide import Slide
    from testbed.actions.weigh import Weigh

    shape, allowed = model.shape, named_grasps(model, grasps)
    counts = {"pivots": pivots, "accelerated": accelerated, "slides": slides, "lifts": lifts, "pushes": pushes}
    for name, count in counts.items():
        check_integer(f"--{name}", count, least=0)
    if pushes and shape.chain is not None:
        raise InvalidValueError("--pushes", pushes, "0: an object with hinges is not pushed")
    if lifts and support != "rigid":
        raise InvalidValueError("--lifts", lifts, "0 unless the support is rigid: one block alone would come along")
    Range(1.5, 60, "s").check("--duration", duration)
    if shape.chain is not None:
        drags = random_drags(shape, allowed, 2 * max(pivots, slides), 0)  # every other one is a turn
        return [Weigh(), *drags[1::2][:pivots], *drags[::2][:slides]]
    turns = RankDriven(pivots, duration, accelerated, grasps=allowed).predicted_actions(shape) if pivots else []
    golden = math.pi * (3 - math.sqrt(5))
    slid = [Slide(allowed[i % len(allowed)], i * golden) for i in range(slides)] if allowed else []
    inner = sorted(allowed, key=lambda grasp: float(np.linalg.norm(shape.grasps[grasp].position)))
    lifted = [Lift(inner[i % len(inner)]) for i in range(lifts)] if inner else []
    return [Weigh(), *turns, *slid, *lifted, *random_pushes(shape, pushes, 0)]


def _errors_table(model: ObjectModel, report: Identifiability) -> Table:
    """Mass and expected standard error of every group, and of every friction."""
    table = open_table("group", "mass, kg", "standard error, g", "% of its own value")
    for label, mass, error in zip(report.group_names, model.group_mass, report.standard_error, strict=True):
        part = _three_digits(100 * error / mass) if mass else "-"
        table.add_row(label, f"{mass:.3f}", _three_digits(1e3 * error), part)
    frictions = zip(model.shape.friction_names, model.truth.friction, report.friction_error, strict=True)
    for name, friction, error in frictions:
        table.add_row(name, f"{friction:g}", "", _three_digits(100 * error / friction) if friction else "-")
    return table


def _three_digits(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "not observed"


@dataclass(frozen=True)
class Search:
    """Options of a search for actions."""

    until: Annotated[str | None, tyro.conf.arg(metavar="PERCENT", help_behavior_hint=default_hint)] = None
    """expected NAD to reach (sum of the mass errors over the total mass), such as 5%."""
    budget: Annotated[str | None, tyro.conf.arg(metavar="TIME", help_behavior_hint=default_hint)] = None
    """robot time including travel, such as 60s or 2min; default: no limit."""
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 8
    """maximum number of actions."""
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s"
    """preset of the sensor, and of the camera for pushes."""
    assumed_support: Annotated[
        Literal["own_weight", "rigid", "either"] | None,
        tyro.conf.arg(metavar="{own_weight,rigid,either}", help_behavior_hint=default_hint),
    ] = None
    """assumed support; either: plan for both models and for deciding between them. Default of heft plan: rigid for an
    object with contact points, otherwise own_weight."""
    lifts: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint=default_hint)] = False
    """also consider lifts, held still and rocked in the air; not with own_weight."""
    pushes: Annotated[bool, tyro.conf.FlagCreatePairsOff, tyro.conf.arg(help_behavior_hint=default_hint)] = False
    """also consider pushes; an object without grasps is always pushed."""
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...", help_behavior_hint=default_hint)] = None
    """allowed grasps, by name (see heft show); default: all."""
    candidates: Annotated[int, tyro.conf.arg(metavar="N")] = 4000
    """number of candidate actions."""
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0
    """seed of the candidates and of the sensor errors."""

    @property
    def goal(self) -> Goal:
        """Condition on which the search ends.

        Raises:
            InvalidValueError: no percentage, no time, or a number that is not allowed.
        """
        from estimators.action_selection.plan import Goal

        for name, least in (("most", 1), ("candidates", 1), ("seed", 0)):
            check_integer(f"--{name}", getattr(self, name), least=least)
        return Goal(percent(self.until, "--until"), seconds(self.budget, "--budget"), self.most)

    def family(self, support: str) -> ActionFamily:
        """Candidates under an assumed support.

        Raises:
            InvalidValueError: lifts where every group rests on its own weight.
        """
        from estimators.action_selection.candidates import ActionFamily
        from estimators.action_selection.design import ASSUMED_SUPPORTS

        if self.lifts and "rigid" not in ASSUMED_SUPPORTS[support]:
            allowed = "rigid or either with --lifts: of own_weight only the gripped block would come along"
            raise InvalidValueError("--assumed-support", support, allowed)
        return ActionFamily(lifts=self.lifts, pushes=self.pushes)


PLANNED = Search()
"""Default options of a plan."""


def plan(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    search: Annotated[Search, tyro.conf.OmitArgPrefixes] = PLANNED,
    policy: Literal["greedy", "batch", "random", "published", "reversed_pairs"] = "greedy",
    criterion: Literal["I", "A", "D"] = "I",
    world: Annotated[str, tyro.conf.arg(metavar="WORLD")] = "ideal",
    friction: Annotated[float, tyro.conf.arg(metavar="MU")] = 0.5,
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    record: Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd")] = None,
) -> None:
    """Plan actions that determine an object's masses in little robot time: grasps or pushes, and their directions.

    The planner uses only the shape and the weight of the object, so --weight makes a file without masses sufficient.
    Exit code: 1 without any action.

    Examples: heft plan L2 --budget 60s
              heft plan L2 --until 2% --policy batch --figure results/L2_plan
              heft plan L2 --world lab --most 12
              heft plan L2 --assumed-support rigid --lifts

    Args:
        object_: name in the library, or path to a TOML file.
        search: shared with heft touch.
        policy: greedy (best next action), batch (greedy, improved by exchange), random, published, or reversed_pairs.
        criterion: quantity to minimize: I (the expected NAD), A (trace of the covariance) or D (its volume).
        world: world whose setup errors are assumed: ideal, lab or rough.
        friction: assumed friction coefficient.
        weight: weight of the object, kg; default: the sum of its masses.
        figure: figure of the plan, written as FILE.pdf and FILE.png.
        record: Rerun recording of the plan; open it with `rerun FILE.rrd`.
    """
    from estimators.action_selection.design import ASSUMED_SUPPORTS, Guess
    from estimators.action_selection.greedy import PlannedPolicy, rank_driven_plan
    from scenarios.runners import FeasibilityCheck
    from testbed.objects.files import load_object
    from testbed.sensing.noise import read_scale
    from testbed.sensing.presets import preset
    from testbed.validation import check_kilograms
    from testbed.worlds.presets import world as world_of

    if weight is not None:
        check_kilograms("--weight", weight)
    Range(0.01, 2.0, "").check("--friction", friction)
    if record is not None and record.suffix != ".rrd":
        raise InvalidValueError("--record", record, "a file that ends in .rrd")
    console, model, sensor = open_console(), load_object(object_, measured=weight is not None), preset(search.sensing)
    carrier, goal = carrier_of(model, search.assumed_support), search.goal
    if criterion != "I" and policy not in ("greedy", "batch"):
        raise InvalidValueError("--policy", policy, "greedy or batch with --criterion: it minimizes none")
    weighed, setup = weight or read_scale(model.total_mass, sensor, search.seed), world_of(world).stated
    guess = Guess(weighed, sensor.stated, friction, ASSUMED_SUPPORTS[carrier], setup)
    allowed = named_grasps(model, search.grasps)
    if policy in ("published", "reversed_pairs"):
        if search.lifts or search.pushes:
            raise InvalidValueError(
                "--policy", policy, "greedy, batch or random with --lifts or --pushes: it only turns"
            )
        if search.candidates != PLANNED.candidates:
            raise InvalidValueError("--policy", policy, "greedy, batch or random with --candidates: it draws none")
        made = rank_driven_plan(model.shape, guess, goal, policy, allowed, search.seed)
    else:
        check, family = FeasibilityCheck(model.shape, guess), search.family(carrier)
        planned = PlannedPolicy(guess, policy, criterion, goal, family, search.candidates, allowed, search.seed, check)
        made = planned.plan(model.shape)
    title = f"{model.name}, {carrier}, {search.sensing}" + ("" if world == "ideal" else f", {world}") + f": {policy}"
    console.print(Text.assemble((title, "bold"), f"; weighed {guess.weight:.3f} kg"))
    if made.steps:
        console.print(_table(model.shape, made))
    console.print(*_conclusion(model.shape, made, guess, goal), sep="\n")
    if figure is not None or record is not None:
        _draw(plan_view(model, made, f"Plan of {len(made.steps)} actions: {title}"), figure, record)
    if not made.steps and not goal.met(made.before.expected_nad):
        sys.exit(1)


def carrier_of(model: ObjectModel, assumed_support: str | None) -> str:
    """Name of the assumed support, by default the object's.

    Raises:
        InvalidValueError: another support than own weight for an object with hinges.
    """
    from testbed.trial import support_of

    support = assumed_support or support_of(model.shape).name
    if model.shape.chain is not None and support != "own_weight":
        raise InvalidValueError("--assumed-support", support, "own_weight: links rest on their own weight")
    return support


def plan_view(model: ObjectModel, made: Plan, title: str) -> PlanView:
    """The plan with the errors expected after each step, for a figure or a recording."""
    from viz.values import PlanView

    errors = np.array([made.before.standard_error, *(step.belief.standard_error for step in made.steps)])
    words = tuple(action.describe(model.shape) for action in made.actions)
    return PlanView(model.shape, made.actions, errors, title, words)


def named_grasps(model: ObjectModel, names: tuple[str, ...] | None) -> tuple[int, ...]:
    """Indices of the named grasps, or of all.

    Raises:
        InvalidValueError: a grasp that the object does not have.
    """
    known = [grasp.name for grasp in model.shape.grasps]
    names = tuple(known) if names is None else names
    if unknown := sorted(set(names) - set(known)):
        raise InvalidValueError("--grasps", ", ".join(unknown), f"grasps of {model.name}: {', '.join(known)}")
    return tuple(known.index(name) for name in names)


def _draw(view: PlanView, figure: Path | None, record: Path | None) -> None:
    from viz.figures.maps import save_figure
    from viz.figures.plan import plan_figure
    from viz.recordings.page import save
    from viz.recordings.plan import plan_page

    if figure is not None:
        for path in save_figure(plan_figure(view), figure):
            print(path)
    if record is not None:
        save(plan_page(view), record)
        print(f"recording: {record}")


def _table(shape: ObjectShape, made: Plan) -> Table:
    """A row per action: robot time, and the error expected after it."""
    columns = ("", "action", "grasp", "about, mm", "way", "robot, s", "in all, s", "NAD, %", "teaches")
    table = open_table(*columns, left=("action", "grasp", "way", "teaches"))
    belief, spent = made.before, 0.0
    for number, step in enumerate(made.steps, start=1):
        spent += step.seconds
        name, about, manner = step.action.words(shape)
        grasp = "" if step.action.grasp is None else shape.grasps[step.action.grasp].name
        nad = f"{100 * step.belief.expected_nad:.3g}"
        table.add_row(
            str(number), name, grasp, about, manner, f"{step.seconds:.1f}", f"{spent:.0f}", nad,
            _largest_gains(shape, belief, step.belief),
        )  # fmt: skip
        belief = step.belief
    return table


def _largest_gains(shape: ObjectShape, before: Belief, after: Belief) -> str:
    """Groups whose expected error falls most, g before and after."""
    old, new = before.standard_error, after.standard_error
    order = np.argsort(new / np.maximum(old, 1e-12), kind="stable")[:MOST_NAMED]
    named = [(shape.group_names[g], float(old[g]), float(new[g])) for g in order if new[g] < 0.95 * old[g]]
    parts = [f"{name} {_grams(was)} to {_grams(left)}" for name, was, left in named]
    return ", ".join(parts) + " g" if parts else "little of each"


def _grams(mass: float) -> str:
    return f"{1e3 * mass:.2g}" if mass < 0.1 else f"{1e3 * mass:.0f}"


def _conclusion(shape: ObjectShape, made: Plan, guess: Guess, goal: Goal) -> Iterator[str]:
    """Lines on the end of the plan, what it leaves open, and what is not feasible."""
    from estimators.identifiability.information import expected

    nad = f"{100 * made.after.expected_nad:.3g} %"
    yield (
        f"{made.why}: {len(made.steps)} action(s) in {made.seconds:.0f} s of the robot, expected NAD {nad} "
        f"({100 * made.before.expected_nad:.0f} % from the weighing alone)"
    )
    if goal.until is not None and made.after.expected_nad > goal.until:
        yield f"the target of {100 * goal.until:g} % is not reached; {nad} is the best that this plan achieves"
    for assumptions in guess.assumptions():
        actions = [a for a in made.actions if assumptions.support == "rigid" or not a.in_air]
        report = expected(shape, guess.uniform(shape), actions, guess.sensing, assumptions)
        yield f"{assumptions.support}: {report.sentence}"
    reasons = dict.fromkeys(f"{action.words(shape).name}: {why}" for action, why in made.rejected)
    yield from (f"not feasible: {reason}" for reason in list(reasons)[:MOST_REJECTED])
    if len(made.rejected) > MOST_REJECTED:
        yield f"{len(made.rejected)} actions in total would be more informative but are not feasible"
