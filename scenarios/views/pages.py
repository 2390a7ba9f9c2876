"""Recordings of a results folder: of a trial, an estimate, an object, or the whole folder."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import rerun as rr
import rerun.blueprint as rrb

from estimators.evaluation.statistics import Row, select
from scenarios.results.estimates import load_rows
from scenarios.results.files import STAGES, check_results, check_unambiguous, done_keys, inside
from scenarios.results.store import Store
from scenarios.results.table import has_files
from scenarios.results.trials import kind_of_trial
from scenarios.study.experiment import Progress
from scenarios.views.values import estimate_view, fits_of, recorded_view, settings_of, trial_view, typical_trial
from testbed.errors import HeftError, InvalidValueError, nearest
from viz.recordings.comparison import comparison_blueprint, log_comparison
from viz.recordings.estimate import estimate_blueprint, log_estimate
from viz.recordings.page import ITERATION, SIM_TIME, Page, save, send
from viz.recordings.trial import fits_blueprint, log_fits, log_trial, trial_blueprint
from viz.report.lists import worst_of
from viz.values import EstimateView, TrialView

MOST_NAMED = 12
"""Largest number of objects in a message."""


def page_of(folder: Path, what: str | None) -> Page:
    """Page of an object, a trial, an estimate, or the whole folder.

    Args:
        folder: results folder of a finished or a running run.
        what: name of an object, or beginning of the key of a trial or an estimate; None for every object under every
            method.

    Raises:
        InvalidValueError: `what` is no object, and the beginning of no key or of several.
        HeftError: a file of it is damaged.
    """
    check_results(folder)
    if what is None:
        return folder_page(folder)
    estimates = done_keys(folder, "estimates")
    found = [key for key in sorted({*estimates, *done_keys(folder, "trials")}) if key.startswith(what)]
    if len(found) == 1:
        return estimate_page(folder, found[0]) if found[0] in estimates else trial_page(folder, found[0])
    objects = list(dict.fromkeys(row["object"] for row in load_rows(folder)))
    if what in objects:
        return object_page(folder, what)
    check_unambiguous("WHAT", what, found)
    named = ", ".join(objects[:MOST_NAMED]) or "none is done yet"
    raise InvalidValueError(
        "WHAT",
        what,
        f"an object ({named}), or the beginning of one key in {folder}/trials or {folder}/estimates"
        f"{nearest(what, objects)}",
    )


def trial_page(folder: Path, key: str, *, light: bool = False) -> Page:
    """Page of one trial; `light` draws the arm as capsules, at a tenth of the size."""
    return page_of_trial(trial_view(folder, key, meshes=not light), f"trial {key}")


def page_of_trial(shown: TrialView, identity: str) -> Page:
    """Page of a trial's view."""
    return Page(
        shown.title,
        identity,
        lambda stream: log_trial(stream, "trial", shown),
        trial_blueprint("trial", shown),
        SIM_TIME,
    )


def estimate_page(folder: Path, key: str, *, light: bool = False) -> Page:
    """Page of one estimate: its maps, the wrench fits of its trials, and a typical trial, which `light` leaves out."""
    row = Store(folder).result(key)  # from its own file, which is there before the table of the sweep
    if row is None:
        raise InvalidValueError("WHAT", key, f"an estimate of {folder} with a whole result.json")
    row |= {"key": key}
    shown = estimate_view(folder, row)
    explained = fits_of(folder, row, shown)
    fits = [fit for _, _, fit in explained]
    typical, trial = typical_trial(folder, row), None
    as_sensed = next((trajectory for key, trajectory, _ in explained if key == typical.folder.name), None)
    if as_sensed is not None and not light:
        facts = {"sensing": f"{row['sensing']}, draw {row['seed']}"}
        trial = recorded_view(typical, as_sensed, shown.shape, shown.answer, f"{shown.method}'s masses", facts)

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
    """Page of one object under every method: a tab for every support, sensor and point of a sweep."""
    return _comparisons(folder, [name], f"{name} in {folder.resolve().name}", f"object {name} {folder.resolve()}")


def folder_page(folder: Path) -> Page:
    """Page of every object under every method."""
    objects = list(dict.fromkeys(row["object"] for row in load_rows(folder) if row.get("trial_keys") is not None))
    if not objects:
        raise InvalidValueError("DIR", str(folder), "a results folder with an estimate that is done")
    return _comparisons(folder, objects, folder.resolve().name, f"folder {folder.resolve()}")


def _comparisons(folder: Path, objects: Sequence[str], name: str, identity: str) -> Page:
    rows = load_rows(folder)
    compared: list[tuple[str, str, list[EstimateView]]] = [
        (each, setting, [estimate_view(folder, row) for row in found])
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


def record_all(folder: Path, progress: Progress) -> None:
    """Record every trial that moved and every estimate that has no recording yet."""
    recorder = Recorder(folder, files=True)
    wanted = [(stage.removesuffix("s"), key) for stage in STAGES for key in done_keys(folder, stage)]
    wanted = [(kind, key) for kind, key in wanted if not recording_path(folder, key).is_file()]
    for done, (kind, key) in enumerate(wanted):
        progress("recordings", done, len(wanted))
        recorder(kind, key)
    progress("recordings", len(wanted), len(wanted))


def recording_path(folder: Path, name: str) -> Path:
    """Path of the recording of an object, a trial or an estimate."""
    return inside(folder, "recordings", f"{name}.rrd")


def record_results(folder: Path) -> Path:
    """Write the recording of a finished run; returns its path."""
    save(folder_page(folder), folder / "recording.rrd")
    return folder / "recording.rrd"


def record_worst(folder: Path, rows: Sequence[Row]) -> None:
    """Record the worst estimates of the report, which links to them, without a view of the robot."""
    for row in itertools.chain(*worst_of(rows)):
        if has_files(row) and row.get("trial_keys") is not None:
            path = recording_path(folder, row["key"])
            if not path.is_file():
                save(estimate_page(folder, row["key"], light=True), path)


@dataclass(frozen=True)
class Recorder:
    """Receiver of finished trials and estimates; writes their recordings, sends them to a viewer, or both."""

    folder: Path
    files: bool = False
    """True to write recordings to files."""
    url: str | None = None
    """Address of a viewer to which recordings are sent."""

    def __call__(self, kind: str, key: str) -> None:
        """Record a finished "trial" or "estimate"; one that cannot be drawn is reported and left out."""
        make = trial_page if kind == "trial" else estimate_page
        if kind == "trial" and kind_of_trial(self.folder, key) == "weigh":
            return
        try:
            if self.files:
                save(make(self.folder, key), recording_path(self.folder, key))
            if self.url is not None:
                send(make(self.folder, key, light=True), self.url)
        except HeftError as error:
            print(f"no recording of {kind} {key[:8]}: {error}")
