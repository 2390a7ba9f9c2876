"""heft view, heft record: recordings of a results folder, opened or written."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console


def view(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")] = None,
    *,
    web: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Open a trial, an estimate or a comparison of methods in the Rerun viewer.

    Examples: heft view results/blocks            every object under every method
              heft view results/blocks L2         one object under every method
              heft view results/blocks 3f9a       the trial or the estimate whose key begins so (see its report)

    Args:
        folder: of a run, finished or still running.
        what: an object, or the beginning of a trial's or an estimate's key; everything if left out.
        web: serve the viewer to a browser on this machine instead of opening a window.
    """
    import tempfile
    import webbrowser
    from contextlib import suppress
    from threading import Event

    from scenarios.views.pages import page_of
    from viz.recordings import viewer
    from viz.recordings.page import save

    viewer.check_display(web=web)
    page = page_of(folder, what)
    with tempfile.TemporaryDirectory(prefix="heft-") as place:
        path = Path(place) / "page.rrd"
        save(page, path)
        if not web:
            viewer.open_file(path)
            return
        with viewer.served(path) as address:
            print(f"viewer: {address}\nCtrl-C ends it", flush=True)
            if viewer.has_display():
                webbrowser.open(address)
            with suppress(KeyboardInterrupt):
                Event().wait()


def record(
    folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")],
    what: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="WHAT")] = (),
    *,
    all_: Annotated[bool, tyro.conf.arg(name="all"), tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Write Rerun recordings: DIR/recording.rrd, or DIR/recordings/WHAT.rrd.

    `rerun FILE` opens one on any machine; it needs nothing else of the folder.

    Args:
        folder: of a run, finished or still running.
        what: objects, or beginnings of trials' or estimates' keys; every object under every method if left out.
        all_: every trial and estimate that has no recording yet, instead.
    """
    from scenarios.cli.progress import show_progress
    from scenarios.views.pages import page_of, record_all, recording_path
    from viz.recordings.page import save

    console = Console()
    if all_:
        with show_progress(console) as progress:
            record_all(folder, console, progress)
        return
    for name in what or [None]:
        path = folder / "recording.rrd" if name is None else recording_path(folder, name)
        save(page_of(folder, name), path)
        console.print(f"recording: {path}", highlight=False, soft_wrap=True)
