"""Report of a run: one self-contained HTML file, to read, print, or send."""

from __future__ import annotations

import io
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import count
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup, escape
from matplotlib.figure import Figure

from estimators.evaluation.statistics import AXIS, FEWEST, Row, assumptions, axes_of, axis_values, select
from testbed.files import write_text
from testbed.objects.model import ObjectShape
from viz.figures.loss import loss_figure
from viz.figures.maps import (
    MeanAnswer,
    absolute_difference,
    as_pixels,
    compared_methods,
    lay_out,
    map_scales,
    mass_maps,
)
from viz.figures.nad import nad_distribution, nad_sweep
from viz.figures.trials import trials_figure
from viz.report.answer_maps import answer_maps
from viz.report.answers import Answer, answer_table
from viz.report.lists import failures, names, worst, worst_of
from viz.report.tables import (
    MOST_OBJECTS,
    Table,
    by_setting,
    claims_table,
    metric_table,
    metrics_of,
    over_objects,
    overview,
    points_of,
    sweep_table,
)
from viz.report.trials import trials_table
from viz.style import STYLE
from viz.trials import TrialsView
from viz.values import support_name

COLUMNS = (
    "nad", "mpd_m", "mpd_open_loop_m", "mpd_turn_m", "mpd_of_truth_m", "mpd_open_loop_of_truth_m",
    "mpd_turn_of_truth_m", "seconds", "robot_s",
    "mass_kg", "true_mass_kg", "group_names", "message", "key", "trial_keys",
)  # fmt: skip
"""Columns that a row may lack; missing ones are None."""
MOST_FAILURES = 50
"""Largest number of kinds of failure that are listed."""
PIXELS_PER_INCH = 80
"""Least scale of a figure with small print [pixels/inch]."""
WORST_OBJECTS, OTHER_OBJECTS = 10, 5
"""Numbers of objects with a mass map where there are too many for one each."""
MAPS_SHOW = "true mass, estimated mass and absolute difference, kg per group"
"""Caption of the figures of one object."""
_REFERENCE = re.compile(r"(?:url\(#|^#)([^)]+)")
_CONTROL = re.compile(rb"[\x00-\x08\x0b\x0c\x0e-\x1f]")
"""Characters that XML cannot hold."""


@dataclass(frozen=True, eq=False)
class Results:
    """All values of a report."""

    name: str
    facts: Mapping[str, str]
    """Facts of the run by name."""
    methods: Mapping[str, str]
    """Settings of each method, in words."""
    command: str
    """Command that reproduces the results."""
    scenario_toml: str
    """TOML text of the scenario as it ran."""
    rows: Sequence[Row]
    """Rows of results.parquet."""
    shape_of: Callable[[str], ObjectShape | None]
    """Geometry of an object by name, or None where it is no longer available."""
    losses: Mapping[str, Mapping[str, Sequence[np.ndarray]]] = field(default_factory=dict)
    """Losses of the estimates, (I,) each, by method and optimiser."""
    tracebacks: Mapping[str, str] = field(default_factory=dict)
    """Tracebacks of estimates that failed, by path."""
    recording_of: Callable[[str], str] = lambda _: ""
    """Path of an estimate's recording by its folder; empty without a recording."""
    bad_trials: Mapping[tuple[str, str], Sequence[str]] = field(default_factory=dict)
    """Folders of trials that are not ok, by status and reason."""
    answers: Sequence[Sequence[Answer]] = ()
    """Answers of every method, by object, from measured trials."""
    trials_of: Callable[[str], TrialsView | None] = lambda _: None
    """Trials of an object by name, or None where they are no longer available."""


@dataclass(frozen=True)
class Illustration:
    """A figure with its caption."""

    svg: Markup
    caption: str
    least: int | None = None
    """Width [px] below which the figure scrolls in its box; None for a figure that shrinks to any screen."""


Draw = Callable[..., Illustration]
"""Function of a figure, its caption, and `wide` for a figure that scrolls."""


def write_report(results: Results, path: Path) -> None:
    """Write the report, whole or not at all."""
    write_text(path, render(results))


@mpl.rc_context(STYLE)
def render(results: Results) -> str:
    """HTML of the report."""
    rows: list[dict[str, Any]] = [
        dict.fromkeys(COLUMNS) | {k: _plain(k, v) for k, v in row.items()} for row in results.rows
    ]
    estimates = [row for row in rows if row["method"]]  # other rows are objects without any estimate
    settings = by_setting(estimates).items()
    groups = {f"{support_name(support)}, {sensing}": found for (support, sensing), found in settings}
    worst_all, worst_own = (worst(found, results.recording_of) for found in worst_of(rows))
    numbers = count(1)

    def draw(figure: Figure, caption: str, *, wide: bool = False) -> Illustration:
        least = round(PIXELS_PER_INCH * figure.get_figwidth()) if wide else None
        return Illustration(inline_svg(figure, caption, f"f{next(numbers)}"), caption, least)

    objects = list(dict.fromkeys(row["object"] for row in estimates))
    mapped = mapped_objects(estimates, objects)
    shapes = {name: shape for name in mapped if (shape := results.shape_of(name)) is not None}
    good = sum(row["status"] == "ok" for row in estimates)
    losses = {}
    for method, traces in results.losses.items():
        most = max(map(len, traces.values()))
        losses[f"{method}: loss by iteration, {most} estimate{'s' if most != 1 else ''}"] = traces
    differences, maps = _maps(groups, shapes)
    best, known = overview(points_of(estimates)), any(row["nad"] is not None for row in estimates)
    judged = known or not results.answers
    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent), autoescape=True, undefined=StrictUndefined, trim_blocks=True,
        lstrip_blocks=True,
    )  # fmt: skip
    environment.filters["breakable"] = breakable
    return environment.get_template("report.html.j2").render(
        results=results,
        judged=judged,
        answers=[
            (
                answer_table(found),
                draw(answer_maps(found), f"{found[0].object}: masses, and half of each 90 % interval"),
            )
            for found in results.answers
            if any(answer.distribution is not None for answer in found)
        ],
        counts={"estimates": len(estimates), "objects": len(objects), "good": good},
        best=best,
        picture=_first_picture(groups, best, maps, draw) if judged else None,
        tables={label: _tables(found) for label, found in groups.items()},
        distributions=[
            draw(nad_distribution(found), f"NAD by method: {label}")
            for label, found in groups.items()
            if any(row["nad"] is not None for row in found)
        ],
        sweeps=_sweeps(estimates, groups, draw),
        losses=[draw(loss_figure(traces), caption) for caption, traces in losses.items()],
        differences=[
            draw(figure, f"Absolute difference of mass, every method and object: {group}", wide=True)
            for group, figure in differences.items()
        ],
        maps=[draw(figure, f"{name}: {MAPS_SHOW}", wide=True) for name, figure in maps.items()],
        without_geometry=names([name for name in mapped if name not in shapes]),
        left_out=len(objects) - len(mapped),
        trials=[
            (trials_table(view), draw(trials_figure(view), f"{view.title}: actions by trial", wide=True))
            for name in mapped
            if (view := results.trials_of(name)) is not None
        ],
        worst=worst_all,
        worst_own=worst_own,
        most_failures=MOST_FAILURES,
        fewest=FEWEST,
        assumed=assumptions(rows),
        failures=failures(rows, results.tracebacks),
    )


def _first_picture(
    groups: Mapping[str, Sequence[Row]], best: Table, maps: Mapping[str, Figure], draw: Draw
) -> Illustration | None:
    """Maps of the object with the median NAD under the first method; without a map, NAD by method."""
    if not groups or not best.rows:
        return None
    label, method = next(iter(groups)), best.rows[0][0][0]
    name = middle_object(groups[label], method, list(maps))
    if name is None:
        return draw(nad_distribution(groups[label]), f"NAD by method: {label}")
    place = f", the middle object by NAD of {method}" if len(maps) > 1 else ""
    return draw(maps[name], f"{name}{place}: {MAPS_SHOW}", wide=True)


def breakable(name: object) -> Markup:
    """Name that may break after its underscores in a narrow column."""
    return Markup("_<wbr>").join(escape(part) for part in str(name).split("_"))


def _plain(column: str, value: Any) -> Any:
    """Value that can be compared: swept settings other than numbers become text."""
    if column.startswith(AXIS) and not isinstance(value, int | float | str | None):
        return str(value)
    return value


def _tables(rows: Sequence[Row]) -> list[Table]:
    """One table per metric with values, by object or over many objects, and the claims; folded tables last."""
    many = len({row["object"] for row in rows}) > MOST_OBJECTS or axes_of(rows)
    tables = [(over_objects if many else metric_table)(rows, metric, metric.title) for metric in metrics_of(rows)]
    claims = claims_table(rows)
    return sorted([*tables, claims] if claims else tables, key=lambda table: bool(table.folded))


def _sweeps(
    rows: Sequence[Row], groups: Mapping[str, Sequence[Row]], draw: Draw
) -> dict[str, list[tuple[Illustration, Table]]]:
    """Figure and table of each swept setting, for every support and sensing under which it varies."""
    sweeps: dict[str, list[tuple[Illustration, Table]]] = {}
    for axis in axes_of(rows):
        split = {label: found for label, found in groups.items() if len(axis_values(found, axis)) > 1}
        name = axis.removeprefix(AXIS)
        for label, found in (split or {"all": rows}).items():
            picture = draw(nad_sweep(found, axis), f"NAD against {name}: {label}")
            table = sweep_table(found, axis, f"Median NAD over objects, %, by {name}: {label}")
            sweeps.setdefault(name, []).append((picture, table))
    return sweeps


def mapped_objects(rows: Sequence[Row], objects: Sequence[str]) -> list[str]:
    """All objects; of many, the ten with the largest mean NAD and a few spread evenly over the others.

    The NAD is that of the hidden states, where that method ran.
    """
    if len(objects) <= MOST_OBJECTS:
        return list(objects)
    own = [row for row in rows if row["kind"] == "hidden_states"] or rows
    found: dict[str, list[float]] = {name: [] for name in objects}
    for row in own:
        if row["nad"] is not None:
            found[row["object"]].append(row["nad"])
    ranked = sorted(objects, key=lambda name: -float(np.mean(found[name])) if found[name] else 0.0)
    others = ranked[WORST_OBJECTS:]
    spread = np.unique(np.linspace(0, len(others) - 1, min(OTHER_OBJECTS, len(others))).astype(int))
    return ranked[:WORST_OBJECTS] + [others[i] for i in spread]


def _maps(
    groups: Mapping[str, Sequence[Row]], shapes: Mapping[str, ObjectShape]
) -> tuple[dict[str, Figure], dict[str, Figure]]:
    """Differences by support and sensing, and maps by object, on one scale; objects with known truth only."""
    known = {label: [row for row in rows if row["true_mass_kg"] is not None] for label, rows in groups.items()}
    truths: dict[str, np.ndarray] = {}
    answers: dict[str, dict[str, list[MeanAnswer]]] = {}
    for name, shape in shapes.items():
        own = {label: found for label, rows in known.items() if (found := select(rows, object=name))}
        truth = np.array(next(iter(own.values()))[0]["true_mass_kg"] if own else [], dtype=float)
        if len(truth) != shape.n_m:
            continue
        truths[name] = truth
        answers[name] = {
            label: [a for m in compared_methods(found) if (a := MeanAnswer.of(found, m))]
            for label, found in own.items()
        }
    scales = map_scales(list(truths.values()), [a for by in answers.values() for found in by.values() for a in found])
    pictures = {name: as_pixels(mass_maps(shapes[name], truths[name], answers[name], scales)) for name in truths}
    overall = {}
    for label, rows in groups.items():
        present = {name: shapes[name] for name in truths if select(rows, object=name)}
        if present:
            overall[label] = as_pixels(absolute_difference(rows, present, ""))
    return overall, pictures


def middle_object(rows: Sequence[Row], method: str, names: Sequence[str]) -> str | None:
    """Object of `names` with the median of the method's mean NAD; None where the method has a NAD of none."""
    found = {name: [row["nad"] for row in select(rows, object=name, method=method)] for name in names}
    known = {name: float(np.mean(nads)) for name in names if (nads := [n for n in found[name] if n is not None])}
    ranked = sorted(known, key=known.__getitem__)
    return ranked[len(ranked) // 2] if ranked else None


def inline_svg(figure: Figure, title: str, prefix: str) -> Markup:
    """SVG element of a figure.

    Args:
        figure: matplotlib's figure.
        title: alternative text.
        prefix: of the identifiers, unique for each figure of a page.
    """
    file = io.BytesIO()
    with mpl.rc_context(STYLE), warnings.catch_warnings():
        warnings.filterwarnings("ignore", "Glyph .* missing")  # the browser's fonts draw the text
        lay_out(figure)
        figure.savefig(file, format="svg", dpi=130, transparent=True)
    root = ElementTree.fromstring(_CONTROL.sub(b"", file.getvalue()))
    _drop_namespaces(root)
    used = {name for e in root.iter() for value in e.attrib.values() for name in _REFERENCE.findall(value)}
    for element in root.iter():
        for key, value in list(element.attrib.items()):
            if key == "id":
                del element.attrib[key]
                if value in used:
                    element.set("id", f"{prefix}-{value}")
            elif _REFERENCE.search(value) and key in ("href", "clip-path", "style", "fill", "stroke"):
                element.set(key, _REFERENCE.sub(lambda m: m.group(0).replace("#", f"#{prefix}-"), value))
    for key in ("width", "height", "version"):
        root.attrib.pop(key, None)
    root.set("role", "img")
    root.set("aria-label", title)
    return Markup(ElementTree.tostring(root, encoding="unicode"))  # ElementTree has escaped every text


def _drop_namespaces(root: ElementTree.Element) -> None:
    """Remove namespaces, which HTML does not use, and the elements <metadata> and <style>."""
    for parent in list(root.iter()):
        for child in list(parent):
            if child.tag.split("}")[-1] in ("metadata", "style"):
                parent.remove(child)
    for element in root.iter():
        element.tag = element.tag.split("}")[-1]
        for key in list(element.attrib):
            if "}" in key:
                element.set(key.split("}")[-1], element.attrib.pop(key))
