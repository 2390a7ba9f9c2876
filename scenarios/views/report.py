"""The report of a results folder: one HTML file."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from estimators.evaluation.statistics import AXIS, Row, axes_of, select
from scenarios.catalog import scenario_names
from scenarios.config import Scenario, load_scenario
from scenarios.results.estimates import load_losses, load_rows, load_tracebacks
from scenarios.results.files import inside, read_manifest, stored
from scenarios.results.trials import OTHER_FORMAT, object_of
from scenarios.study.run import SENSING
from scenarios.views.answers import answers_of
from scenarios.views.values import trials_view
from testbed.errors import HeftError, InvalidValueError
from testbed.files import unless_damaged
from testbed.objects.files import load_object
from testbed.objects.model import ObjectShape
from testbed.toml import toml_text
from viz.report.lists import names
from viz.report.report import Results, write_report
from viz.values import support_name


def report(folder: Path) -> Path:
    """Write report.html into a results folder, whole or not at all; returns its path.

    Raises:
        InvalidValueError: a folder without results.
        HeftError: results that are damaged, or of another version of heft.
    """
    manifest = unless_damaged(lambda: read_manifest(folder), "left out") or {}
    table = folder / "results.parquet"
    scenario = manifest.get("scenario") or {}
    place = {Path(path).stem: i for i, path in enumerate(scenario.get("objects", ()))}  # other objects follow
    rows = sorted(load_rows(folder) if table.is_file() else [], key=lambda row: place.get(row["object"], len(place)))
    measured = select(rows, sensing=SENSING)  # simulated trials have errors, which say more than answers
    if not rows:
        raise InvalidValueError("DIR", str(folder), "a folder with a results.parquet; `heft run` makes one")
    name = str(manifest.get("name") or folder.resolve().name)
    results = Results(
        name=name,
        facts=_facts(manifest, rows, table),
        methods={label: _settings(scenario.get("methods", {}).get(label, {})) for label in _distinct(rows, "method")},
        command=str(manifest.get("command") or _command(name, scenario)),
        scenario_toml=toml_text(scenario),
        rows=rows,
        shape_of=lambda name: _shape(name, scenario, rows, folder),
        losses=load_losses(folder, rows),
        tracebacks=load_tracebacks(folder),
        recording_of=lambda key: name if (folder / (name := f"recordings/{key}.rrd")).is_file() else "",
        bad_trials=_bad_trials(folder),
        answers=unless_damaged(lambda: answers_of(folder, measured), "left out") or [],
        trials_of=lambda name: unless_damaged(
            lambda: trials_view(folder, select(rows, object=name)), "its trials are left out"
        ),
    )
    write_report(results, path := inside(folder, "report.html"))
    return path


def _facts(manifest: Mapping[str, Any], rows: Sequence[Row], table: Path) -> dict[str, str]:
    """Known facts of the run, by name."""
    scenario = manifest.get("scenario") or {}
    packages = manifest.get("packages") or {}
    seconds = [row["seconds"] for row in rows if row.get("seconds") is not None]
    axes = {axis.removeprefix(AXIS): _distinct(rows, axis) for axis in axes_of(rows)}
    wall = manifest.get("wall_s")
    facts = {
        "objects": names(_distinct(rows, "object")),
        "supports": names([support_name(name) for name in _distinct(rows, "support")]),
        "sensing": names(_distinct(rows, "sensing")),
        "seeds": f"{scenario['seeds']} draws of the sensor's errors" if "seeds" in scenario else "",
        "swept": "; ".join(f"{axis}: {names(values)}" for axis, values in axes.items()),
        "results written": datetime.fromtimestamp(table.stat().st_mtime, UTC).strftime("%Y-%m-%d %H:%M UTC"),
        "wall time": _time(wall) if isinstance(wall, int | float) else "",
        "estimates took": f"{_time(sum(seconds))} of computing in all" if seconds else "",
        "robot time": _robot_time(rows),
        "versions": ", ".join([f"Python {manifest.get('python', '?')}", *(f"{k} {v}" for k, v in packages.items())]),
    }
    return {name: fact for name, fact in facts.items() if fact}


def _robot_time(rows: Sequence[Row]) -> str:
    """Mean robot time of an object under one support; trials, which all methods share, count once."""
    labels = ("object", "support", "sensing", "seed")
    once = {
        (*(row[name] for name in labels), *(str(v) for k, v in row.items() if k.startswith(AXIS))): row["robot_s"]
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


def _distinct(rows: Sequence[Row], column: str) -> list[str]:
    """Distinct values of a column, in the order of the rows."""
    return list(dict.fromkeys(str(row[column]) for row in rows if row.get(column) not in (None, "")))


def _settings(settings: Mapping[str, Any]) -> str:
    return ", ".join(f"{key} = {json.dumps(value)}" for key, value in settings.items()) or "defaults"


def _command(name: str, scenario: Mapping[str, Any]) -> str:
    """Command that repeats the run: with options for a scenario of the library, else with a file of the one shown."""
    with suppress(ValueError):  # an older scenario
        if name in scenario_names():
            ran, base = Scenario.model_validate(scenario), load_scenario(name)[1]
            if base.model_copy(update={"seeds": ran.seeds, "objects": ran.objects}) == ran:
                seeds = "" if ran.seeds == base.seeds else f" --seeds {ran.seeds}"
                objects = "" if ran.objects == base.objects else f" --objects {' '.join(ran.objects)}"
                return f"heft run {name}{seeds}{objects}"
    return f"heft run {name}.toml   # the scenario below, saved as {name}.toml"


def _shape(name: str, scenario: Mapping[str, Any], rows: Sequence[Row], folder: Path) -> ObjectShape | None:
    """Geometry of an object from the folder, the scenario, the library or a trial; None where its groups changed."""
    row = next((row for row in rows if row["object"] == name and row.get("group_names") is not None), None)
    drawn = [str(path) for path in sorted((folder / "objects").glob("*/*.toml")) if path.stem == name]
    files = [path for path in scenario.get("objects", ()) if Path(path).stem == name]
    for path in dict.fromkeys((*drawn, *files, name)):
        try:
            model = load_object(path)
        except (HeftError, OSError):
            continue
        if model.name == name and (row is None or list(row["group_names"]) == list(model.shape.group_names)):
            return model.shape
    for _, trial in stored(folder, "trials"):
        if trial is None:
            continue
        try:
            if trial["names"]["object"] == name:
                return object_of(trial["asked"]["object"], trial["names"]).shape
        except OTHER_FORMAT:
            continue
    return None


def _bad_trials(folder: Path) -> dict[tuple[str, str], list[str]]:
    """Keys of the trials whose status is not ok, by status and reason."""
    found: dict[tuple[str, str], list[str]] = {}
    for place, trial in stored(folder, "trials"):
        if trial is not None and trial.get("status", "?") != "ok":
            reason = str(trial.get("status", "?")), str(trial.get("reason", ""))
            found.setdefault(reason, []).append(place.name)
    return found
