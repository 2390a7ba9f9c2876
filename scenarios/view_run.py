"""`heft view`, `heft record`, and what `heft run --record --live` does as it goes."""

from __future__ import annotations

import itertools
import tempfile
import webbrowser
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event

from rich.console import Console

from scenarios.comparison import Row
from scenarios.pages import estimate_page, folder_page, page_of, trial_page
from scenarios.progress import show_progress
from scenarios.seen_trials import kind_of_trial
from testbed.errors import HeftError
from viz import viewer
from viz.recording import save, send
from viz.report_lists import worst_of
from viz.web_viewer import served


def view(folder: Path, what: str | None, *, web: bool) -> None:
    """Open a recording in the viewer, and wait until it is closed.

    Raises:
        InvalidValueError: `what` is not in the folder.
        ViewerError: the viewer cannot open here.
    """
    viewer.check_display(web=web)
    page = page_of(folder, what)
    with tempfile.TemporaryDirectory(prefix="heft-") as place:
        path = Path(place) / "page.rrd"
        save(page, path)
        if not web:
            viewer.open_file(path)
            return
        with served(path) as address:
            print(f"viewer: {address}\nCtrl-C ends it", flush=True)
            if viewer.has_display():
                webbrowser.open(address)
            with suppress(KeyboardInterrupt):
                Event().wait()


def record(folder: Path, whats: Sequence[str], console: Console, *, everything: bool) -> None:
    """Write recordings: of the whole folder, of what is named, or of every trial and estimate that has none yet."""
    if everything:
        record_all(folder, console)
        return
    for what in whats or [None]:
        path = folder / "recording.rrd" if what is None else recording_path(folder, what)
        save(page_of(folder, what), path)
        console.print(f"recording: {path}", highlight=False, soft_wrap=True)


def record_all(folder: Path, console: Console) -> None:
    """Record every trial that moved and every estimate that has no recording yet."""
    recorder = Recorder(folder, console, files=True)
    trials = [path.parent.name for path in sorted(folder.glob("trials/*/trial.json"))]
    estimates = [path.parent.name for path in sorted(folder.glob("estimates/*/result.json"))]
    wanted = [(kind, key) for kind, keys in (("trial", trials), ("estimate", estimates)) for key in keys]
    wanted = [(kind, key) for kind, key in wanted if not recording_path(folder, key).is_file()]
    with show_progress(console) as progress:
        for done, (kind, key) in enumerate(wanted):
            progress("recordings", done, len(wanted))
            recorder(kind, key)
        progress("recordings", len(wanted), len(wanted))


def recording_path(folder: Path, name: str) -> Path:
    """Where the recording of an object, a trial or an estimate is."""
    return folder / "recordings" / f"{name}.rrd"


def record_results(folder: Path) -> Path:
    """Write the recording of a finished run; returns its path."""
    save(folder_page(folder), folder / "recording.rrd")
    return folder / "recording.rrd"


def record_worst(folder: Path, rows: Sequence[Row]) -> None:
    """Record the estimates that the report names as the worst, without the bench: the report has links to them."""
    for row in itertools.chain(*worst_of(rows)):
        if row.get("key") and row.get("trial_keys") is not None:
            path = recording_path(folder, row["key"])
            if not path.is_file():
                save(estimate_page(folder, row["key"], light=True), path)


@dataclass(frozen=True)
class Recorder:
    """Told of every trial and estimate as it is done; records it, and shows it."""

    folder: Path
    console: Console
    files: bool = False
    """Write each to its file."""
    url: str | None = None
    """Viewer to send each to."""

    def __call__(self, kind: str, key: str) -> None:
        """Record one that is done; `kind` is "trial" or "estimate". What cannot be shown is told and left out."""
        make = trial_page if kind == "trial" else estimate_page
        if kind == "trial" and kind_of_trial(self.folder, key) == "weigh":
            return
        try:
            if self.files:
                save(make(self.folder, key), recording_path(self.folder, key))
            if self.url is not None:
                send(make(self.folder, key, light=True), self.url)
        except HeftError as error:
            self.console.print(f"no recording of {kind} {key[:8]}: {error}", highlight=False, soft_wrap=True)
