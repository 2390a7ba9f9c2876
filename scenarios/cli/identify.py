"""`heft identify`: what trials of an object would show of its masses, before any is made."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from estimators.action_selection.rank import RankDriven
from estimators.identifiability.information import Question, expected
from estimators.identifiability.report import Identifiability
from scenarios.cli.plan import named_grasps
from testbed.actions.base import Action, Lift, Slide, Weigh
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectModel
from testbed.sensing.presets import preset
from viz.figures.maps import error_figure, save_figure


@dataclass(frozen=True)
class Wish:
    """What would be done with the object, and how it would be felt."""

    sensing: str = "ft300s"
    support: str = "own_weight"
    pivots: int = 6
    accelerated: int = 6
    slides: int = 0
    lifts: int = 0
    duration: float = 18.0
    grasps: tuple[str, ...] | None = None
    out: Path | None = None


def identify(console: Console, name: str, wish: Wish) -> None:
    """Print the report, and draw it where a file is given.

    Raises:
        InvalidValueError: a grasp, sensor or support that is not there.
    """
    model = load_object(name)
    actions = planned_actions(model, wish)
    report = expected(model.shape, model.truth, actions, preset(wish.sensing), Question(wish.support))
    kinds = [type(action).__name__.lower() for action in actions]
    done = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    title = f"{model.name}, {wish.support}, {wish.sensing}"
    console.print(f"[bold]{title}[/bold]: {done}", highlight=False)
    console.print(_table(model, report))
    said = f"condition {report.condition:.0f}" if np.isfinite(report.condition) else "nothing is seen"
    console.print(f"{report.sentence}; {said}", highlight=False)
    if wish.out is not None:
        for path in save_figure(error_figure(model, report.standard_error, title), wish.out):
            console.print(str(path), highlight=False, soft_wrap=True)


def planned_actions(model: ObjectModel, wish: Wish) -> list[Action]:
    """A weighing, what the rank-driven policy would ask for, slides of spread directions, and lifts.

    Lifts are of the grasps nearest the middle, where the object hangs by its weight with the least moment.
    """
    shape = model.shape
    allowed = named_grasps(model, wish.grasps)
    if wish.slides < 0:
        raise InvalidValueError("slides", wish.slides, "an integer >= 0")
    most = 0 if wish.support != "rigid" else math.inf
    if not 0 <= wish.lifts <= most:
        raise InvalidValueError("lifts", wish.lifts, "an integer >= 0, and 0 unless the support is rigid")
    done: list[Action] = []
    if wish.pivots:
        done = RankDriven(wish.pivots, wish.duration, wish.accelerated, grasps=allowed).foreseen(shape)
    golden = math.pi * (3 - math.sqrt(5))
    slides = [Slide(allowed[i % len(allowed)], i * golden) for i in range(wish.slides)] if allowed else []
    inner = sorted(allowed, key=lambda grasp: float(np.linalg.norm(shape.grasps[grasp].position)))
    lifts = [Lift(inner[i % len(inner)]) for i in range(wish.lifts)] if inner else []
    return [Weigh(), *done, *slides, *lifts]


def _table(model: ObjectModel, report: Identifiability) -> Table:
    """Mass and expected standard error of every group, and of every friction."""
    table = Table()
    for column in ("group", "mass, kg", "standard error, g", "part of the mass, %"):
        table.add_column(column, justify="right")
    for label, mass, error in zip(report.group_names, model.group_mass, report.standard_error, strict=True):
        table.add_row(label, f"{mass:.3f}", _number(1e3 * error), _number(100 * error / mass if mass else np.inf))
    for k, (friction, error) in enumerate(zip(model.truth.friction, report.friction_error, strict=True)):
        name = "friction" if model.shape.n_mu == 1 else f"friction {k}"
        table.add_row(name, f"{friction:g}", "", _number(100 * error / friction if friction else np.inf))
    return table


def _number(value: float) -> str:
    return f"{value:.3g}" if np.isfinite(value) else "not seen"
