"""Amounts as they are typed: "5%" and "60s"."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from estimators.action_selection.candidates import ActionFamily
from estimators.action_selection.design import THOUGHT, Belief, Design, Guess, before_trials
from estimators.action_selection.greedy import Asked, Goal, Plan, PlannedTouches, as_plan
from estimators.action_selection.rank import RankDriven
from estimators.identifiability.information import Question, expected
from scenarios.study.benches import BenchCheck
from testbed.actions.base import Accelerate, Action, Lift, Rotate, Slide, Weigh
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel, ObjectShape
from testbed.sensing.presets import preset
from viz.figures.maps import save_figure
from viz.figures.plan import PlanShown, plan_figure
from viz.recordings.page import save
from viz.recordings.plan import plan_page


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


MOST_REJECTED = 5
"""Reasons that are printed."""
MOST_NAMED = 3
"""Groups that a step names."""


@dataclass(frozen=True)
class Wish:
    """What the plan is for."""

    budget: str | None = None
    until: str | None = None
    policy: str = "greedy"
    criterion: str = "I"
    sensing: str = "ft300s"
    support: str = "own_weight"
    friction: float = 0.5
    most: int = 8
    candidates: int = 4000
    grasps: tuple[str, ...] | None = None
    seed: int = 0
    figure: Path | None = None
    record: Path | None = None
    lifts: bool = False


def plan(console: Console, name: str, wish: Wish) -> None:
    """Print the plan, and draw it where a file is given.

    Raises:
        InvalidValueError: a grasp, sensor, support, policy or amount that is not there.
    """
    model = load_object(name)
    made = planned(model, wish)
    title = f"{model.name}, {wish.support}, {wish.sensing}: {wish.policy}"
    console.print(f"[bold]{title}[/bold]; weighed {model.total_mass:.3f} kg", highlight=False)
    if made.steps:
        console.print(plan_table(model.shape, made))
    for line in said(model, made, wish):
        console.print(line, highlight=False)
    if wish.figure is not None or wish.record is not None:
        shown = shown_of(model, made, title)
        if wish.figure is not None:
            for path in save_figure(plan_figure(shown), wish.figure):
                console.print(str(path), highlight=False, soft_wrap=True)
        if wish.record is not None:
            save(plan_page(shown), wish.record)
            console.print(f"recording: {wish.record}", highlight=False, soft_wrap=True)


def shown_of(model: ObjectModel, made: Plan, title: str) -> PlanShown:
    """What is drawn of a plan."""
    errors = np.array([made.before.standard_error, *(step.belief.standard_error for step in made.steps)])
    words = tuple(sentence(model.shape, action) for action in made.actions)
    return PlanShown(model.shape, made.actions, errors, model.total_mass, title, words)


def planned(model: ObjectModel, wish: Wish) -> Plan:
    """The plan; of the object, only shape and weight are looked at."""
    shape = model.shape
    if wish.support not in THOUGHT:
        raise InvalidValueError("support", wish.support, f"one of {', '.join(THOUGHT)}")
    guess = Guess(model.total_mass, preset(wish.sensing), wish.friction, THOUGHT[wish.support])
    goal = Goal(percent(wish.until, "--until"), seconds(wish.budget, "--budget"), wish.most)
    grasps = named_grasps(model, wish.grasps)
    if wish.policy == "paper":
        return _paper(shape, guess, goal, grasps, wish.seed)
    policy = PlannedTouches(
        guess,
        wish.policy,  # pyright: ignore[reportArgumentType]
        wish.criterion,  # pyright: ignore[reportArgumentType]
        goal,
        family_of(wish.support, lifts=wish.lifts),
        wish.candidates,
        grasps,
        wish.seed,
        BenchCheck(shape, guess),
    )
    return policy.plan(shape)


def family_of(support: str, *, lifts: bool) -> ActionFamily:
    """Which actions are thought of.

    Raises:
        InvalidValueError: lifts of what cannot be one rigid body.
    """
    if lifts and "rigid" not in THOUGHT[support]:
        allowed = "no lifts where every block rests on its own weight, and only what is gripped would come along"
        raise InvalidValueError("lifts", lifts, f"{allowed}; lift under support rigid or either")
    return ActionFamily(lifts=lifts)


def named_grasps(model: ObjectModel, chosen: tuple[str, ...] | None) -> tuple[int, ...]:
    """Indices of the grasps named; of all where none is.

    Raises:
        InvalidValueError: a grasp that is not there.
    """
    names = [grasp.name for grasp in model.shape.grasps]
    if chosen is None:
        return tuple(range(len(names)))
    if unknown := sorted(set(chosen) - set(names)):
        raise InvalidValueError("grasps", ", ".join(unknown), f"grasps of {model.name}: {', '.join(names)}")
    return tuple(names.index(grasp) for grasp in chosen)


def _paper(shape: ObjectShape, guess: Guess, goal: Goal, grasps: tuple[int, ...], seed: int) -> Plan:
    """What the rank-driven policy would do, as far as the goal goes."""
    done = RankDriven(grasps=grasps, seed=seed).foreseen(shape)
    design, before = Design.of(shape, done, guess), before_trials(shape, guess)
    whole = as_plan(design, before, range(len(done)), "the policy is content", Asked())
    kept, spent = 0, 0.0
    for step in whole.steps:
        last = whole.steps[kept - 1].belief if kept else before
        if kept == goal.most or goal.met(last.expected_nad) or step.seconds > goal.left(spent):
            return Plan(before, whole.steps[:kept], "the goal's trials or time are used, or its target is met", ())
        kept, spent = kept + 1, spent + step.seconds
    return whole if done else Plan(before, (), "there is nothing to grip", ())


def plan_table(shape: ObjectShape, made: Plan) -> Table:
    """A row a touch: what is done, how long it takes, what is expected to be known after it."""
    table = Table()
    for column, justify in (
        *(("", "right"), ("touch", "left"), ("grasp", "left"), ("about, mm", "right"), ("way", "left")),
        *(("robot, s", "right"), ("in all, s", "right"), ("NAD, %", "right"), ("teaches", "left")),
    ):
        table.add_column(column, justify=justify)  # pyright: ignore[reportArgumentType]
    belief, spent = made.before, 0.0
    for number, step in enumerate(made.steps, start=1):
        spent += step.seconds
        kind, about, way = in_words(shape, step.action)
        grasp = "" if isinstance(step.action, Weigh) else shape.grasps[step.action.grasp].name
        nad = f"{100 * step.belief.expected_nad:.3g}"
        table.add_row(
            str(number), kind, grasp, about, way, f"{step.seconds:.1f}", f"{spent:.0f}", nad,
            taught(shape, belief, step.belief),
        )  # fmt: skip
        belief = step.belief
    return table


def in_words(shape: ObjectShape, action: Action) -> tuple[str, str, str]:
    """Kind, centre and direction of an action."""
    if isinstance(action, Rotate):
        x, y = shape.grasps[action.grasp].position if action.pivot is None else action.pivot
        way = "left" if action.speed > 0 else "right"
        both = f"{way} and back" if action.back else way
        return "turn", f"({1e3 * x:.0f}, {1e3 * y:.0f})", f"{both}, {math.degrees(abs(action.speed)):.0f} deg/s"
    if isinstance(action, Accelerate):
        return "accelerate", "the grasp", "left" if action.start_speed > 0 else "right"
    if isinstance(action, Slide):
        return "slide", "", f"towards {math.degrees(action.direction):.0f} deg"
    if isinstance(action, Lift):
        return "lift", "", f"{action.swings} swings, held {action.hold:g} s"
    return type(action).__name__.lower(), "", ""


def sentence(shape: ObjectShape, action: Action) -> str:
    """All of an action in one line."""
    kind, about, way = in_words(shape, action)
    at = "" if isinstance(action, Weigh) else f" at {shape.grasps[action.grasp].name}"
    unit = " mm" if isinstance(action, Rotate) else ""
    return f"{kind}{at} about {about}{unit}, {way}" if about else f"{kind}{at}, {way}"


def taught(shape: ObjectShape, before: Belief, after: Belief) -> str:
    """The groups whose expected error falls most, grams before and after."""
    old, new = before.standard_error, after.standard_error
    order = np.argsort(new / np.maximum(old, 1e-12), kind="stable")[:MOST_NAMED]
    named = [(shape.group_names[g], float(old[g]), float(new[g])) for g in order if new[g] < 0.95 * old[g]]
    parts = [f"{name} {_grams(was)} to {_grams(left)}" for name, was, left in named]
    return ", ".join(parts) + " g" if parts else "little of each"


def _grams(mass: float) -> str:
    return f"{1e3 * mass:.2g}" if mass < 0.1 else f"{1e3 * mass:.0f}"


def said(model: ObjectModel, made: Plan, wish: Wish) -> list[str]:
    """How it ends, what it leaves open, and what the bench could not do."""
    nad = f"{100 * made.after.expected_nad:.3g} %"
    lines = [
        f"{made.why}: {len(made.steps)} touch(es) in {made.seconds:.0f} s of the robot, expected NAD {nad} "
        f"({100 * made.before.expected_nad:.0f} % from the weighing alone)"
    ]
    until = percent(wish.until, "--until")
    if until is not None and made.after.expected_nad > until:
        lines.append(f"the target of {100 * until:g} % is not reached; {nad} is the best that this can have")
    guess = Guess(model.total_mass, preset(wish.sensing), wish.friction)
    for support in THOUGHT[wish.support]:
        actions = [a for a in made.actions if support == "rigid" or not isinstance(a, Lift)]
        report = expected(model.shape, guess.uniform(model.shape), actions, preset(wish.sensing), Question(support))
        lines.append(f"{support}: {report.sentence}")
    reasons = dict.fromkeys(f"{in_words(model.shape, action)[0]}: {why}" for action, why in made.rejected)
    lines += [f"not feasible: {reason}" for reason in list(reasons)[:MOST_REJECTED]]
    if len(made.rejected) > MOST_REJECTED:
        lines.append(f"{len(made.rejected)} touches in all would have taught more and are not feasible")
    return lines
