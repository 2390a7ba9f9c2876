"""`heft identify`: what trials of an object would show of its masses, before any is made."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

if TYPE_CHECKING:
    from rich.table import Table

    from estimators.identifiability.report import Identifiability
    from testbed.actions.base import Action
    from testbed.objects.model import ObjectModel


def identify(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    sensing: Annotated[str, tyro.conf.arg(metavar="PRESET")] = "ft300s",
    support: Literal["own_weight", "rigid"] = "own_weight",
    pivots: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    accelerated: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
    slides: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    lifts: Annotated[int, tyro.conf.arg(metavar="N")] = 0,
    duration: Annotated[float, tyro.conf.arg(metavar="S")] = 18.0,
    grasps: Annotated[tuple[str, ...] | None, tyro.conf.arg(metavar="NAME ...")] = None,
    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None,
) -> None:
    """Predict what trials of an object would show of its masses: errors to expect, and what stays open.

    Examples: heft identify L2
              heft identify F2 --support rigid --sensing ideal
              heft identify L2 --support rigid --lifts 1
              heft identify L2 --pivots 0 --slides 6 --out results/L2_slides

    Args:
        object_: name in the library, or path to a TOML file.
        sensing: preset of the sensor.
        support: what carries the weight.
        pivots: turns there and back, as the rank-driven policy draws them; 0 for none, accelerated ones neither.
        accelerated: accelerated turns.
        slides: slides, in directions spread over the circle.
        lifts: lifts, held still and rocked in the air, of the grasps nearest the middle; under rigid support alone.
        duration: time of a turn each way, s.
        grasps: allowed grasps, by name (see heft show); all if left out, whether the arm reaches them or not.
        out: heatmap of the expected errors, written as FILE.pdf and FILE.png.
    """
    from rich.console import Console

    from estimators.identifiability.information import Assumptions, expected
    from testbed.objects.files import load_object
    from testbed.sensing.presets import preset
    from viz.figures.maps import error_figure, save_figure

    console, model = Console(), load_object(object_)
    actions = actions_of(model, support, pivots, accelerated, slides, lifts, duration, grasps)
    report = expected(model.shape, model.truth, actions, preset(sensing), Assumptions(support))
    kinds = [action.kind for action in actions]
    counts = ", ".join(f"{kinds.count(kind)} {kind}" for kind in dict.fromkeys(kinds))
    title = f"{model.name}, {support}, {sensing}"
    console.print(f"[bold]{title}[/bold]: {counts}", highlight=False)
    console.print(_table(model, report))
    condition = f"condition {report.condition:.0f}" if math.isfinite(report.condition) else "nothing is seen"
    console.print(f"{report.sentence}; {condition}", highlight=False)
    if out is not None:
        for path in save_figure(error_figure(model, report.standard_error, title), out):
            console.print(str(path), highlight=False, soft_wrap=True)


def actions_of(
    model: ObjectModel,
    support: str = "own_weight",
    pivots: int = 6,
    accelerated: int = 6,
    slides: int = 0,
    lifts: int = 0,
    duration: float = 18.0,
    grasps: tuple[str, ...] | None = None,
) -> list[Action]:
    """A weighing, the rank-driven policy's actions, slides in spread directions, and lifts; arguments as `identify`.

    Lifts are of the grasps nearest the middle, where the object hangs by its weight with the least moment.

    Raises:
        InvalidValueError: a grasp that the object does not have, or a count that is not allowed.
    """
    import numpy as np

    from estimators.action_selection.rank import RankDriven
    from scenarios.cli.plan import named_grasps
    from testbed.actions.lift import Lift
    from testbed.actions.slide import Slide
    from testbed.actions.weigh import Weigh
    from testbed.errors import InvalidValueError

    shape, allowed = model.shape, named_grasps(model, grasps)
    if slides < 0:
        raise InvalidValueError("slides", slides, "an integer >= 0")
    most = 0 if support != "rigid" else math.inf
    if not 0 <= lifts <= most:
        raise InvalidValueError("lifts", lifts, "an integer >= 0, and 0 unless the support is rigid")
    turns = RankDriven(pivots, duration, accelerated, grasps=allowed).predicted_actions(shape) if pivots else []
    golden = math.pi * (3 - math.sqrt(5))
    slid = [Slide(allowed[i % len(allowed)], i * golden) for i in range(slides)] if allowed else []
    inner = sorted(allowed, key=lambda grasp: float(np.linalg.norm(shape.grasps[grasp].position)))
    lifted = [Lift(inner[i % len(inner)]) for i in range(lifts)] if inner else []
    return [Weigh(), *turns, *slid, *lifted]


def _table(model: ObjectModel, report: Identifiability) -> Table:
    """Mass and expected standard error of every group, and of every friction."""
    from rich.table import Table

    table = Table()
    for column in ("group", "mass, kg", "standard error, g", "part of the mass, %"):
        table.add_column(column, justify="right")
    for label, mass, error in zip(report.group_names, model.group_mass, report.standard_error, strict=True):
        table.add_row(label, f"{mass:.3f}", _number(1e3 * error), _number(100 * error / mass if mass else math.inf))
    for k, (friction, error) in enumerate(zip(model.truth.friction, report.friction_error, strict=True)):
        name = "friction" if model.shape.n_mu == 1 else f"friction {k}"
        table.add_row(name, f"{friction:g}", "", _number(100 * error / friction if friction else math.inf))
    return table


def _number(value: float) -> str:
    return f"{value:.3g}" if math.isfinite(value) else "not seen"
