"""The report of a run: one HTML file with everything in it, to read, print, or send."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from estimators.evaluation.statistics import AXIS, Row, axes_of, select
from testbed.objects.model import ObjectShape
from testbed.trajectory import write_whole
from viz.figures.loss import loss_figure
from viz.figures.maps import absolute_difference, answer_of, as_pixels, mass_bars, mass_maps, shown_methods
from viz.figures.nad import nad_distribution, nad_sweep
from viz.report import lists as report_lists
from viz.report.svg import inline_svg
from viz.report.tables import (
    MOST_OBJECTS,
    Table,
    axis_values,
    metric_table,
    overview,
    sweep_table,
)
from viz.report.terminal import METRICS
from viz.style import STYLE

COLUMNS = (
    "nad", "mpd_open_loop_m", "mpd_turn_m", "mpd_open_loop_of_truth_m", "mpd_turn_of_truth_m", "seconds", "robot_s",
    "mass_kg", "true_mass_kg", "group_names", "message",
)  # fmt: skip
"""Columns that a row may lack; they are then None."""
MOST_FAILURES = 50
"""Kinds of failure that are listed."""
PIXELS_PER_INCH = 80
"""Least scale of a figure with small print."""
WORST_OBJECTS, OTHER_OBJECTS = 10, 5
"""Pictured where there are too many for a picture each."""


@dataclass(frozen=True, eq=False)
class Results:
    """All that a report is made of."""

    name: str
    facts: Mapping[str, str]
    """What ran, when and with what, in words."""
    methods: Mapping[str, str]
    """Settings of each method, in words."""
    command: str
    """Makes the same results again."""
    scenario_toml: str
    """The scenario as it ran, as a file."""
    rows: Sequence[Row]
    keys: Sequence[str | None]
    """Folder of each row's estimate."""
    shape_of: Callable[[str], ObjectShape | None]
    """Geometry of an object by name, or None where it is not known any more."""
    losses: Mapping[str, Mapping[str, Sequence[np.ndarray]]] = field(default_factory=dict)
    """Losses of the estimates, (I,) each, by method and optimiser."""
    tracebacks: Mapping[str, str] = field(default_factory=dict)
    """Of estimates that failed, by folder."""
    trial_keys_of: Callable[[Row], Sequence[str]] = lambda _: ()
    """Folders of the trials behind an estimate."""
    recording_of: Callable[[str], str] = lambda _: ""
    """Path of an estimate's recording by its folder; empty where there is none."""
    bad_trials: Mapping[tuple[str, str], Sequence[str]] = field(default_factory=dict)
    """Folders of trials that are no good, by status and reason."""


@dataclass(frozen=True)
class Picture:
    """A figure in words and lines."""

    svg: Markup
    caption: str
    least: int | None = None
    """Width, px, below which it scrolls in a box of its own; None where it may shrink to any screen."""


def write_report(results: Results, path: Path) -> None:
    """Write the report, whole or not at all."""
    page = render(results)
    write_whole(path, lambda part: part.write_text(page, encoding="utf-8"))


def render(results: Results) -> str:
    """The report as HTML."""
    with mpl.rc_context(STYLE):
        return _render(results)


def _render(results: Results) -> str:
    rows: list[dict[str, Any]] = [
        dict.fromkeys(COLUMNS) | {k: _plain(k, v) for k, v in row.items()} for row in results.rows
    ]
    asked = [row for row in rows if row["method"]]  # the others are objects that no method was asked about
    groups = {
        f"{report_lists.support_name(first)}, {first['sensing']}": select(
            asked, support=first["support"], sensing=first["sensing"]
        )
        for first in {(row["support"], row["sensing"]): row for row in asked}.values()
    }
    folder_of = {id(row): key for row, key in zip(rows, results.keys, strict=True)}
    worst, worst_own = (
        report_lists.worst(found, lambda row: folder_of[id(row)], results.trial_keys_of, results.recording_of)
        for found in report_lists.worst_of(rows)
    )
    draw = _Drawer()
    objects = list(dict.fromkeys(row["object"] for row in asked))
    pictured = pictured_objects(asked, objects)
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["breakable"] = breakable
    return environment.get_template("report.html.j2").render(
        results=results,
        counts={"estimates": len(asked), "objects": len(objects), "good": sum(row["status"] == "ok" for row in asked)},
        overview=overview(groups),
        tables={label: _tables(found) for label, found in groups.items()},
        distributions=[draw(nad_distribution(found), f"NAD by method: {label}") for label, found in groups.items()],
        sweeps=_sweeps(asked, groups, draw),
        losses=[draw(loss_figure(traces), _loss_caption(m, traces)) for m, traces in results.losses.items()],
        maps=_maps(groups, pictured, results.shape_of, draw),
        left_out=len(objects) - len(pictured),
        worst=worst,
        worst_own=worst_own,
        most_failures=MOST_FAILURES,
        failures=report_lists.failures(rows, results.tracebacks),
    )  # fmt: skip


def breakable(name: object) -> Markup:
    """A name that a narrow column may break after its underscores."""
    return Markup("_<wbr>").join(escape(part) for part in str(name).split("_"))


class _Drawer:
    """Turns figures into pictures, each with identifiers of its own."""

    def __init__(self) -> None:
        self._count = 0

    def __call__(self, figure: Figure, caption: str, *, wide: bool = False) -> Picture:
        least = round(PIXELS_PER_INCH * figure.get_figwidth()) if wide else None
        self._count += 1
        return Picture(inline_svg(figure, caption, f"f{self._count}"), caption, least)


def _plain(column: str, value: Any) -> Any:
    """Values of swept settings can be compared; text is text."""
    if column.startswith(AXIS) and not isinstance(value, int | float | str | None):
        return str(value)
    return value


def _tables(rows: Sequence[Row]) -> list[Table]:
    tables = (metric_table(rows, metric, metric.title) for metric in METRICS)
    return [table for table in tables if table is not None]


def _sweeps(
    rows: Sequence[Row], groups: Mapping[str, Sequence[Row]], draw: _Drawer
) -> dict[str, list[tuple[Picture, Table]]]:
    """Of each swept setting: a picture and a table for every support and sensing under which it changes."""
    sweeps = {}
    for axis in axes_of(rows):
        split = {label: found for label, found in groups.items() if len(axis_values(found, axis)) > 1}
        name, shown = axis.removeprefix(AXIS), []
        for label, found in (split or {"all": rows}).items():
            caption = f"NAD against {name}: {label}"
            shown.append(
                (draw(nad_sweep(found, axis), caption), sweep_table(found, axis, f"Median NAD, %, by {name}: {label}"))
            )
        sweeps[name] = shown
    return sweeps


def pictured_objects(rows: Sequence[Row], objects: Sequence[str]) -> list[str]:
    """All objects; of many, the ten with the worst NAD and a few spread evenly over the rest.

    The worst are those of the hidden states, where that method ran.
    """
    if len(objects) <= MOST_OBJECTS:
        return list(objects)
    own = [row for row in rows if row["kind"] == "hidden_states"] or rows
    found: dict[str, list[float]] = {name: [] for name in objects}
    for row in own:
        if row["nad"] is not None:
            found[row["object"]].append(row["nad"])
    ranked = sorted(objects, key=lambda name: -float(np.mean(found[name])) if found[name] else 0.0)
    rest = ranked[WORST_OBJECTS:]
    others = np.unique(np.linspace(0, len(rest) - 1, min(OTHER_OBJECTS, len(rest))).astype(int))
    return ranked[:WORST_OBJECTS] + [rest[i] for i in others]


def _maps(
    groups: Mapping[str, Sequence[Row]],
    pictured: Sequence[str],
    shape_of: Callable[[str], ObjectShape | None],
    draw: _Drawer,
) -> list[Picture]:
    rows = [row for found in groups.values() for row in found]
    shapes, pictures = {}, []
    for name in pictured:
        known = [row for row in select(rows, object=name) if row["true_mass_kg"] is not None]
        if not known:
            continue
        truth = np.array(known[0]["true_mass_kg"], dtype=float)
        of = {label: select(known, object=name, support=found[0]["support"], sensing=found[0]["sensing"])
              for label, found in groups.items()}  # fmt: skip
        of = {label: found for label, found in of.items() if found}
        answers = {
            label: [a for m in shown_methods(found) if (a := answer_of(found, m))] for label, found in of.items()
        }
        shape = shape_of(name)
        if shape is not None and shape.n_m == len(truth):
            shapes[name] = shape
            figure, wide = as_pixels(mass_maps(shape, truth, answers)), True
            caption = f"{name}: true mass, estimated mass and absolute difference, kg a group"
        else:
            said = known[0]["group_names"]
            names = [f"m{i}" for i in range(len(truth))] if said is None else said
            figure, wide = mass_bars([str(each) for each in names], truth, answers), False
            caption = f"{name}: true and estimated mass, kg a group (its geometry is not known any more)"
        pictures.append(draw(figure, caption, wide=wide))
    overall = []
    for label, found in groups.items():
        seen = {name: shape for name, shape in shapes.items() if select(found, object=name)}
        if seen:
            figure = as_pixels(absolute_difference(found, seen, ""))
            caption = f"Absolute difference of mass, every method and object: {label}"
            overall.append(draw(figure, caption, wide=True))
    return overall + pictures


def _loss_caption(method: str, traces: Mapping[str, Sequence[np.ndarray]]) -> str:
    count = max(len(losses) for losses in traces.values())
    return f"{method}: loss by iteration, {count} estimate{'s' if count != 1 else ''}"
