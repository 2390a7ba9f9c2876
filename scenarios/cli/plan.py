"""`heft plan`: which actions make the masses of an object known in the least robot time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from rich.console import Console
    from rich.table import Table

    from estimators.action_selection.candidates import ActionFamily
    from estimators.action_selection.design import Belief, Guess
    from estimators.action_selection.plan import Goal, Plan
    from testbed.objects.model import ObjectModel, ObjectShape
    from viz.values import PlanView

MOST_REJECTED = 5
"""Refusals that are printed."""
MOST_NAMED = 3
"""Groups that a row of the table names."""


def plan(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    budget: Annotated[str | None, tyro.conf.arg(metavar="TIME")] = None,
    until: Annotated[str | None, tyro.conf.arg(metavar="PERCENT")] = None,
    policy: Literal["greedy", "batch", "random", "paper"] = "greedy",
    criterion: Literal["I", "A", "D"] = "I",
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    support: Literal["own_weight", "rigid", "either"] = "own_weight",
    lifts: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    friction: Annotated[float, tyro.conf.arg(metavar="MU")] = 0.5,
    most: Annotated[int, tyro.conf.arg(metavar="N")] = 8,
    candidates: Annotated[int, tyro.conf.arg(metavar="N")] = 4000,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    seed: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    figure: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
    record: Annotated[Path | None, tyro.conf.arg(metavar="FILE.rrd")] = None,
) -> None:
    """Plan actions: where to grasp and which way to turn, to know an object's masses in little robot time.

    Of the object the planner uses only its shape and its weight.
    Examples: heft plan L2 --budget 60s
              heft plan L2 --until 2% --policy batch --figure results/L2_plan
              heft plan L2 --support rigid --lifts

    Args:
        object_: name in the library, or path to a TOML file.
        budget: robot time, travel included, as 60s or 2min; no limit if left out.
        until: expected NAD to reach, as 5%.
        policy: greedy (the best of each moment), batch (the whole made better by exchange), random, or paper.
        criterion: quantity to minimize: I (the expected NAD), A (trace of the covariance) or D (its volume).
        sensing: preset of the sensor.
        support: what carries the weight; either serves both models, and tells them apart.
        lifts: consider lifts too, held still and rocked in the air; not with support own_weight.
        friction: assumed coefficient.
        most: greatest number of actions.
        candidates: number of actions to consider.
        grasps: allowed grasps, by name (see heft show); all if left out.
        seed: seed of the candidates.
        figure: the plan as a picture, written as FILE.pdf and FILE.png.
        record: the plan as a Rerun recording: `rerun FILE.rrd` opens it.
    """
    from rich.console import Console

    from estimators.action_selection.design import ASSUMED_SUPPORTS, Guess
    from estimators.action_selection.greedy import PlannedPolicy, rank_driven_plan
    from estimators.action_selection.plan import Goal
    from scenarios.runners import FeasibilityCheck
    from testbed.objects.files import load_object
    from testbed.sensing.presets import preset

    console, model = Console(), load_object(object_)
    guess = Guess(model.total_mass, preset(sensing), friction, ASSUMED_SUPPORTS[support])
    goal = Goal(percent(until, "--until"), seconds(budget, "--budget"), most)
    allowed = named_grasps(model, grasps)
    if policy == "paper":
        made = rank_driven_plan(model.shape, guess, goal, allowed, seed)
    else:
        check, family = FeasibilityCheck(model.shape, guess), action_family(support, lifts=lifts)
        made = PlannedPolicy(guess, policy, criterion, goal, family, candidates, allowed, seed, check).plan(model.shape)
    title = f"{model.name}, {support}, {sensing}: {policy}"
    console.print(f"[bold]{title}[/bold]; weighed {model.total_mass:.3f} kg", highlight=False)
    if made.steps:
        console.print(_table(model.shape, made))
    for line in _conclusion(model.shape, made, guess, goal):
        console.print(line, highlight=False)
    if figure is not None or record is not None:
        _draw(console, plan_view(model, made, title), figure, record)


def plan_view(model: ObjectModel, made: Plan, title: str) -> PlanView:
    """The plan with the errors expected after each step, for a figure or a recording."""
    import numpy as np

    from viz.values import PlanView

    errors = np.array([made.before.standard_error, *(step.belief.standard_error for step in made.steps)])
    words = tuple(action.describe(model.shape) for action in made.actions)
    return PlanView(model.shape, made.actions, errors, model.total_mass, title, words)


def action_family(support: str, *, lifts: bool) -> ActionFamily:
    """The candidates' family under an assumed support.

    Raises:
        InvalidValueError: lifts of what cannot be one rigid body.
    """
    from estimators.action_selection.candidates import ActionFamily
    from estimators.action_selection.design import ASSUMED_SUPPORTS

    if lifts and "rigid" not in ASSUMED_SUPPORTS[support]:
        allowed = "no lifts where every block rests on its own weight, and only what is gripped would come along"
        raise InvalidValueError("lifts", lifts, f"{allowed}; lift under support rigid or either")
    return ActionFamily(lifts=lifts)


def named_grasps(model: ObjectModel, names: tuple[str, ...] | None) -> tuple[int, ...]:
    """Indices of the named grasps, or of all.

    Raises:
        InvalidValueError: a grasp that the object does not have.
    """
    known = [grasp.name for grasp in model.shape.grasps]
    if names is None:
        return tuple(range(len(known)))
    if unknown := sorted(set(names) - set(known)):
        raise InvalidValueError("grasps", ", ".join(unknown), f"grasps of {model.name}: {', '.join(known)}")
    return tuple(known.index(name) for name in names)


def percent(text: str | None, name: str) -> float | None:
    """ "5%" or "0.05" as a part of 1; None stays None.

    Raises:
        InvalidValueError: not a part between 0 and 1.
    """
    if text is None:
        return None
    whole = text.strip().endswith("%")
    value = _number(text.strip().removesuffix("%"), name, text, "a percentage such as 5%") / (100 if whole else 1)
    if not 0 < value < 1:
        raise InvalidValueError(name, text, "a percentage above 0% and below 100%, such as 5%")
    return value


def seconds(text: str | None, name: str) -> float | None:
    """ "60s", "60" or "2min" in seconds; None stays None.

    Raises:
        InvalidValueError: not a time above 0.
    """
    if text is None:
        return None
    bare, unit = text.strip(), 1.0
    for suffix, size in (("min", 60.0), ("s", 1.0)):
        if bare.endswith(suffix):
            bare, unit = bare.removesuffix(suffix), size
            break
    value = unit * _number(bare, name, text, "a time such as 60s or 2min")
    if not 0 < value < float("inf"):
        raise InvalidValueError(name, text, "a time above 0, such as 60s or 2min")
    return value


def _number(bare: str, name: str, text: str, allowed: str) -> float:
    try:
        return float(bare)
    except ValueError:
        raise InvalidValueError(name, text, allowed) from None


def _draw(console: Console, view: PlanView, figure: Path | None, record: Path | None) -> None:
    from viz.figures.maps import save_figure
    from viz.figures.plan import plan_figure
    from viz.recordings.page import save
    from viz.recordings.plan import plan_page

    if figure is not None:
        for path in save_figure(plan_figure(view), figure):
            console.print(str(path), highlight=False, soft_wrap=True)
    if record is not None:
        save(plan_page(view), record)
        console.print(f"recording: {record}", highlight=False, soft_wrap=True)


def _table(shape: ObjectShape, made: Plan) -> Table:
    """A row an action: robot time, and the error expected after it."""
    from rich.table import Table

    table = Table()
    for column, justify in (
        *(("", "right"), ("action", "left"), ("grasp", "left"), ("about, mm", "right"), ("way", "left")),
        *(("robot, s", "right"), ("in all, s", "right"), ("NAD, %", "right"), ("teaches", "left")),
    ):
        table.add_column(column, justify=justify)  # pyright: ignore[reportArgumentType]
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
    import numpy as np

    old, new = before.standard_error, after.standard_error
    order = np.argsort(new / np.maximum(old, 1e-12), kind="stable")[:MOST_NAMED]
    named = [(shape.group_names[g], float(old[g]), float(new[g])) for g in order if new[g] < 0.95 * old[g]]
    parts = [f"{name} {_grams(was)} to {_grams(left)}" for name, was, left in named]
    return ", ".join(parts) + " g" if parts else "little of each"


def _grams(mass: float) -> str:
    return f"{1e3 * mass:.2g}" if mass < 0.1 else f"{1e3 * mass:.0f}"


def _conclusion(shape: ObjectShape, made: Plan, guess: Guess, goal: Goal) -> Iterator[str]:
    """Lines on how the plan ends, what it leaves open, and what is not feasible."""
    from estimators.identifiability.information import Assumptions, expected

    nad = f"{100 * made.after.expected_nad:.3g} %"
    yield (
        f"{made.why}: {len(made.steps)} action(s) in {made.seconds:.0f} s of the robot, expected NAD {nad} "
        f"({100 * made.before.expected_nad:.0f} % from the weighing alone)"
    )
    if goal.until is not None and made.after.expected_nad > goal.until:
        yield f"the target of {100 * goal.until:g} % is not reached; {nad} is the best that this can have"
    for support in guess.supports:
        actions = [a for a in made.actions if support == "rigid" or not a.in_air]
        report = expected(shape, guess.uniform(shape), actions, guess.sensing, Assumptions(support))
        yield f"{support}: {report.sentence}"
    reasons = dict.fromkeys(f"{action.words(shape).name}: {why}" for action, why in made.rejected)
    yield from (f"not feasible: {reason}" for reason in list(reasons)[:MOST_REJECTED])
    if len(made.rejected) > MOST_REJECTED:
        yield f"{len(made.rejected)} actions in all would have taught more and are not feasible"
