"""`heft report`: a results folder as one HTML file."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd
from matplotlib.figure import Figure
from pyarrow import ArrowException
from rich.console import Console

from estimators.evaluation.statistics import AXIS, Row, axes_of, axis_values, select
from scenarios.config import Scenario, load_scenario
from scenarios.results.estimates import estimate_shown, fits_of
from scenarios.results.files import ResultFiles, TrialFile, trial_keys_of
from scenarios.results.load import load_results
from scenarios.results.store import read_json, rows_of
from scenarios.results.trials import object_of
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectShape
from viz.figures.loss import estimate_losses, loss_figure
from viz.figures.maps import absolute_difference, estimate_bars, estimate_maps, save_figure
from viz.figures.nad import nad_distribution, nad_sweep
from viz.figures.wrench import wrench_fit_figure
from viz.report.lists import names
from viz.report.report import Results, write_report
from viz.report.tables import MOST_OBJECTS
from viz.values import support_name


def report(folder: Path) -> Path:
    """Write report.html into a results folder, whole or not at all; returns its path.

    Raises:
        InvalidValueError: there are no results in the folder.
    """
    manifest = read_json(folder / "manifest.json") or {}
    scenario = manifest.get("scenario") or {}
    rows = _in_order(_rows(folder / "results.parquet"), scenario)
    files = ResultFiles(folder)
    keys, trials = files.estimate_keys(rows), files.trials()
    name = str(manifest.get("name") or folder.resolve().name)
    results = Results(
        name=name,
        facts=_facts(manifest, rows, folder / "results.parquet"),
        methods={label: _settings(scenario.get("methods", {}).get(label, {})) for label in _each(rows, "method")},
        command=str(manifest.get("command") or _command(name, scenario)),
        scenario_toml=to_toml(scenario),
        rows=rows,
        keys=keys,
        shape_of=lambda asked: _shape(asked, scenario, rows, folder),
        losses=files.losses(rows, keys),
        tracebacks=files.tracebacks(),
        trial_keys_of=lambda row: trial_keys_of(row, trials),
        recording_of=lambda key: name if (folder / (name := f"recordings/{key}.rrd")).is_file() else "",
        bad_trials=_bad(trials),
    )
    write_report(results, folder / "report.html")
    return folder / "report.html"


def _rows(path: Path) -> list[dict[str, Any]]:
    try:
        rows = rows_of(pd.read_parquet(path))
    except (OSError, ValueError, ArrowException):
        rows = []
    if not rows:
        raise InvalidValueError("DIR", str(path.parent), "a folder with a results.parquet; `heft run` makes one")
    return rows


def _in_order(rows: list[dict[str, Any]], scenario: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Objects as the scenario names them, then the others."""
    place = {Path(asked).stem: i for i, asked in enumerate(scenario.get("objects", ()))}
    return sorted(rows, key=lambda row: place.get(row["object"], len(place)))


def _facts(manifest: Mapping[str, Any], rows: Sequence[Row], table: Path) -> dict[str, str]:
    """What ran, when and with what, as far as it is known."""
    scenario = manifest.get("scenario") or {}
    packages = manifest.get("packages") or {}
    seconds = [row["seconds"] for row in rows if row.get("seconds") is not None]
    axes = {
        k.removeprefix(AXIS): _each(rows, k)
        for k in dict.fromkeys(k for row in rows for k in row)
        if k.startswith(AXIS)
    }
    wall = manifest.get("wall_s")
    facts = {
        "objects": names(_each(rows, "object")),
        "supports": names([support_name(name) for name in _each(rows, "support")]),
        "sensing": names(_each(rows, "sensing")),
        "seeds": f"{scenario['seeds']} draws of the sensor's errors" if "seeds" in scenario else "",
        "swept": "; ".join(f"{axis}: {names(values)}" for axis, values in axes.items()),
        "results written": datetime.fromtimestamp(table.stat().st_mtime, UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "wall time": _time(wall) if isinstance(wall, int | float) else "",
        "estimates took": f"{_time(sum(seconds))} of computing in all" if seconds else "",
        "robot time": _robot_time(rows),
        "versions": ", ".join([f"Python {manifest.get('python', '?')}", *(f"{k} {v}" for k, v in packages.items())]),
    }
    return {name: said for name, said in facts.items() if said}


def _robot_time(rows: Sequence[Row]) -> str:
    """The same trials serve every method and draw."""
    once = {
        (row["object"], row["support"], *(str(v) for k, v in row.items() if k.startswith(AXIS))): row["robot_s"]
        for row in rows
        if row.get("robot_s") is not None
    }
    if not once:
        return ""
    return f"{_time(sum(once.values()) / len(once))} of moving for an object under one support, on average"


def _time(seconds: float) -> str:
    if seconds < 120:
        return f"{seconds:.1f} s"
    return f"{seconds / 60:.0f} min" if seconds < 7200 else f"{seconds / 3600:.1f} h"


def _each(rows: Sequence[Row], column: str) -> list[str]:
    """Values of a column, in the order of the rows."""
    return list(dict.fromkeys(str(row[column]) for row in rows if row.get(column) not in (None, "")))


def _settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {json.dumps(value)}" for key, value in settings.items()) or "defaults"


def _command(name: str, scenario: Mapping[str, Any]) -> str:
    """`heft run`, with what differs from the library's scenario; or with a file to be made of the one shown."""
    try:
        ran, base = Scenario.model_validate(scenario), load_scenario(name)[1]
        if base.model_copy(update={"seeds": ran.seeds, "objects": ran.objects}) == ran:
            seeds = "" if ran.seeds == base.seeds else f" --seeds {ran.seeds}"
            objects = "" if ran.objects == base.objects else f" --objects {' '.join(ran.objects)}"
            return f"heft run {name}{seeds}{objects}"
    except ValueError:  # an older scenario, or no library name
        pass
    return f"heft run {name}.toml   # the scenario below, saved as {name}.toml"


def to_toml(table: Mapping[str, Any]) -> str:
    """A scenario as TOML: its own fields, then its tables; what is None is left out."""
    plain = {k: v for k, v in table.items() if not isinstance(v, dict) and v is not None}
    lines = [f"{_key(k)} = {_value(v)}" for k, v in plain.items()]
    for name, inner in table.items():
        if isinstance(inner, dict):
            nested = name == "methods"
            for label, settings in inner.items() if nested else ((None, inner),):
                lines += ["", f"[{_key(name)}{f'.{_key(label)}' if label is not None else ''}]"]
                lines += [f"{_key(k)} = {_value(v)}" for k, v in settings.items() if v is not None]
    return "\n".join(lines)


def _key(name: str) -> str:
    return name if name.replace("_", "").replace("-", "").isascii() and name.isidentifier() else json.dumps(name)


def _value(value: Any) -> str:
    if isinstance(value, dict):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items() if v is not None) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(_value(v) for v in value) + "]"
    return json.dumps(value, ensure_ascii=False)


def _shape(name: str, scenario: Mapping[str, Any], rows: Sequence[Row], folder: Path) -> ObjectShape | None:
    """Geometry of an object: from the folder, the scenario, the library or a trial; None if it is not the same now."""
    row = next((row for row in rows if row["object"] == name and row.get("group_names") is not None), None)
    drawn = [str(path) for path in sorted((folder / "objects").glob("*/*.toml")) if path.stem == name]
    files = [asked for asked in scenario.get("objects", ()) if Path(asked).stem == name]
    for asked in dict.fromkeys((*drawn, *files, name)):
        try:
            model = load_object(asked)
        except (HeftError, OSError):
            continue
        if model.name == name and (row is None or list(row["group_names"]) == list(model.shape.group_names)):
            return model.shape
    for path in sorted((folder / "trials").glob("*/trial.json")):
        said = read_json(path) or {}
        if (said.get("names") or {}).get("object") == name and "asked" in said:
            return object_of(said["asked"]["object"], said["names"]).shape
    return None


def _bad(trials: Sequence[TrialFile]) -> dict[tuple[str, str], list[str]]:
    found: dict[tuple[str, str], list[str]] = {}
    for trial in trials:
        if trial.status != "ok":
            found.setdefault((trial.status, trial.reason), []).append(trial.key)
    return found


TRIALS_A_FIGURE = 4
"""Wrench fits that fit side by side on a page."""


def figures(folder: Path, what: Row | None = None) -> list[Path]:
    """Write figures into folder/figures, each whole or not at all; their paths.

    Args:
        folder: results folder.
        what: one of its rows; None for what there is to say of all of them.

    Raises:
        InvalidValueError: no results, or an estimate that does not say what it is of.
        HeftError: a file that is damaged.
    """
    drawn = _of_all(folder) if what is None else _of_estimate(folder, what)
    return [path for name, figure in drawn for path in save_figure(figure, folder / "figures" / file_name(name))]


def show_figures(console: Console, folder: Path, beginning: str | None) -> None:
    """Write figures of a folder, or of its estimate whose key has this beginning, and say where they are.

    Raises:
        InvalidValueError: no such estimate, or more than one.
    """
    row = None
    if beginning is not None:
        found = [row for row in rows_of(load_results(folder)) if str(row.get("key") or "").startswith(beginning)]
        if len(found) != 1:
            allowed = f"the beginning of one estimate's key in {folder}/estimates; {len(found)} begin so"
            raise InvalidValueError("ESTIMATE", beginning, allowed)
        row = found[0]
    for path in figures(folder, row):
        console.print(f"figure: {path}", highlight=False, soft_wrap=True)


def file_name(said: str) -> str:
    """Letters, digits, dots, dashes and underscores, and nothing else."""
    return re.sub(r"[^A-Za-z0-9.-]+", "_", said.replace("/", " per ")).strip("_.")


def _of_all(folder: Path) -> Iterator[tuple[str, Figure]]:
    """NAD by method and against every swept setting, differences by object, and losses."""
    rows = [row for row in rows_of(load_results(folder)) if row["method"]]
    for first in {(row["support"], row["sensing"]): row for row in rows}.values():
        found = select(rows, support=first["support"], sensing=first["sensing"])
        under = f"{first['support']} {first['sensing']}"
        title = f"{support_name(first['support'])}, {first['sensing']}"
        yield f"nad {under}", nad_distribution(found)
        shapes = _shapes(folder, found)
        if shapes:
            yield f"absolute_difference {under}", absolute_difference(found, shapes, title)
    for axis in axes_of(rows):
        split = {(row["support"], row["sensing"]): row for row in rows}.values()
        groups = {
            f" {first['support']} {first['sensing']}": select(rows, support=first["support"], sensing=first["sensing"])
            for first in split
        }
        swept = {under: found for under, found in groups.items() if len(axis_values(found, axis)) > 1}
        for under, found in (swept or {"": rows}).items():
            yield f"nad_against {axis.removeprefix(AXIS)}{under}", nad_sweep(found, axis)
    files = ResultFiles(folder)
    for method, losses in files.losses(rows, files.estimate_keys(rows)).items():
        yield f"loss {method}", loss_figure(losses)


def _of_estimate(folder: Path, row: Row) -> Iterator[tuple[str, Figure]]:
    """Maps, bars, losses, and how the answer explains each of its trials."""
    shown = estimate_shown(folder, row)
    name = f"{row['object']} {row['method']} {str(row['key'])[:8]}"
    yield f"{name} maps", estimate_maps(shown)
    yield f"{name} bars", estimate_bars(shown)
    losses = estimate_losses(shown)
    if losses is not None:
        yield f"{name} loss", losses
    fits = [fit for _, _, fit in fits_of(folder, row, shown)]
    for page, begin in enumerate(range(0, len(fits), TRIALS_A_FIGURE)):
        yield f"{name} wrenches {page + 1}", wrench_fit_figure(fits[begin : begin + TRIALS_A_FIGURE])


def _shapes(folder: Path, rows: Sequence[Row]) -> dict[str, ObjectShape]:
    """Geometry of each object; none where something is swept, or there are too many for a picture each."""
    first = {row["object"]: row for row in reversed(rows) if row.get("key") and row["mass_kg"] is not None}
    if axes_of(rows) or len(first) > MOST_OBJECTS:
        return {}
    shapes = {}
    for name in dict.fromkeys(row["object"] for row in rows if row["object"] in first):
        try:
            shapes[name] = estimate_shown(folder, first[name]).shape
        except HeftError:  # written by a version that did not keep it
            continue
    return shapes
