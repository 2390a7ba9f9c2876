"""Recordings of what a results folder holds: a trial, an estimate, an object, or all of it."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from estimators.plugins import nearest
from scenarios.comparison import select
from scenarios.seen_estimates import estimate_shown, fits_of, rows_in, settings_of, typical_trial
from scenarios.seen_trials import show_trial, trial_shown
from scenarios.store import Store
from testbed.errors import InvalidValueError
from viz.comparison_view import comparison_blueprint, log_comparison
from viz.estimate_shown import EstimateShown
from viz.estimate_view import estimate_blueprint, log_estimate
from viz.frames import ITERATION, SIM_TIME
from viz.recording import Page
from viz.trial_view import fits_blueprint, log_fits, log_trial, trial_blueprint

MOST_NAMED = 12
"""Objects that an error lists."""


def page_of(folder: Path, what: str | None) -> Page:
    """What `what` names in a results folder: an object, or the beginning of the key of a trial or an estimate.

    Args:
        folder: results folder, of a finished run or of one that still runs.
        what: None is every object under every method.

    Raises:
        InvalidValueError: nothing is called so, or more than one thing is.
        HeftError: a file of it is damaged.
    """
    if not folder.is_dir():
        raise InvalidValueError("DIR", str(folder), "a results folder; `heft run` makes one")
    if what is None:
        return folder_page(folder)
    estimates = {path.parent.name for path in folder.glob("estimates/*/result.json")}
    trials = {path.parent.name for path in folder.glob("trials/*/trial.json")}
    found = [key for key in sorted(estimates | trials) if key.startswith(what)]
    if len(found) == 1:
        return estimate_page(folder, found[0]) if found[0] in estimates else trial_page(folder, found[0])
    objects = list(dict.fromkeys(row["object"] for row in rows_in(folder)))
    if what in objects:
        return object_page(folder, what)
    many = f": {len(found)} begin so" if found else ""
    named = ", ".join(objects[:MOST_NAMED]) or "none is done yet"
    raise InvalidValueError(
        "WHAT",
        what,
        f"an object ({named}), or the beginning of one key in {folder}/trials or {folder}/estimates{many}"
        f"{nearest(what, objects)}",
    )


def trial_page(folder: Path, key: str, *, light: bool = False) -> Page:
    """One trial; `light`, with capsules for an arm, at a tenth of the size."""
    shown = trial_shown(folder, key, meshes=not light)
    return Page(
        shown.title,
        f"trial {key}",
        lambda stream: log_trial(stream, "trial", shown),
        trial_blueprint("trial", shown),
        SIM_TIME,
    )


def estimate_page(folder: Path, key: str, *, light: bool = False) -> Page:
    """One estimate, the trials behind it as it explains them, and one of these whole; `light`, without the last."""
    row = Store(folder).result(key)  # its own file: a sweep records each estimate as it is done
    if row is None:
        raise InvalidValueError("WHAT", key, f"an estimate of {folder} with a whole result.json")
    row |= {"key": key}
    shown = estimate_shown(folder, row)
    explained = fits_of(folder, row, shown)
    fits = [fit for _, _, fit in explained]
    typical, trial = typical_trial(folder, row), None
    as_sensed = next((trajectory for of, trajectory, _ in explained if of == typical.folder.name), None)
    if as_sensed is not None and not light:
        said = {"sensing": f"{row['sensing']}, draw {row['seed']}"}
        trial = show_trial(typical, as_sensed, shown.shape, shown.answer, f"{shown.method}'s masses", said)

    def log(stream: rr.RecordingStream) -> None:
        log_estimate(stream, "estimate", shown)
        log_fits(stream, "fits", fits)
        if trial is not None:
            log_trial(stream, "trial", trial)

    tabs = [estimate_blueprint("estimate", shown), fits_blueprint("fits", fits)]
    if trial is not None:
        tabs.append(trial_blueprint("trial", trial))
    return Page(shown.title, f"estimate {key}", log, rrb.Tabs(*tabs, active_tab=0), ITERATION)


def object_page(folder: Path, name: str) -> Page:
    """One object under every method: a tab for every support, sensor and point of a sweep."""
    return _comparisons(folder, [name], f"{name} in {folder.resolve().name}", f"object {name} {folder.resolve()}")


def folder_page(folder: Path) -> Page:
    """Every object under every method."""
    objects = list(dict.fromkeys(row["object"] for row in rows_in(folder) if row.get("key")))
    if not objects:
        raise InvalidValueError("DIR", str(folder), "a results folder with an estimate that is done")
    return _comparisons(folder, objects, folder.resolve().name, f"folder {folder.resolve()}")


def _comparisons(folder: Path, objects: Sequence[str], name: str, identity: str) -> Page:
    rows = rows_in(folder)
    compared: list[tuple[str, str, list[EstimateShown]]] = [
        (each, setting, [estimate_shown(folder, row) for row in found])
        for each in objects
        for setting, found in settings_of(select(rows, object=each))
    ]
    if not compared:
        raise InvalidValueError("WHAT", ", ".join(objects), "objects with an estimate that is done")

    def log(stream: rr.RecordingStream) -> None:
        for index, (_, _, shown) in enumerate(compared):
            log_comparison(stream, f"comparison/{index}", shown)

    tabs = []
    for each in objects:
        inner = [
            rrb.Vertical(
                comparison_blueprint(f"comparison/{i}", shown),
                name=setting if len(objects) == 1 else f"{each}: {setting}",
            )
            for i, (named, setting, shown) in enumerate(compared)
            if named == each
        ]
        tabs.append(inner[0] if len(inner) == 1 else rrb.Tabs(*inner, name=each, active_tab=0))
    return Page(name, identity, log, tabs[0] if len(tabs) == 1 else rrb.Tabs(*tabs, active_tab=0), ITERATION)
