"""`heft render`: a film or a picture of a recorded trial."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int
from rich.console import Console
from rich.table import Table

from scenarios.progress import show_progress
from scenarios.store import read_json
from scenarios.trial_record import TrialRecord, keys_of, read_trial
from testbed.arrays import check_positive
from testbed.errors import InvalidValueError
from testbed.simulation.graphics import choose_offscreen
from testbed.trajectory import Phase, Trajectory
from viz.film import captioned, check_film, write_film

if TYPE_CHECKING:
    from scenarios.cells import Progress
    from testbed.simulation.views import ViewName


@dataclass(frozen=True)
class Wish:
    """How a trial is to be shown."""

    out: Path | None = None
    """A file that ends in .mp4, .gif or .png; trial.mp4 in the trial's folder if None."""
    width: int = 960
    """px."""
    height: int = 640
    """px."""
    fps: float = 25.0
    """Pictures a second of film."""
    speed: float = 1.0
    """Seconds of trial a second of film."""
    camera: ViewName = "bench"
    at: float | None = None
    """The one instant of a PNG, s; None is the middle."""
    caption: bool = True
    """Whether each picture says what it shows, and when."""


def render_trial(root: Path, beginning: str, wish: Wish) -> Path:
    """Draw the trial whose key has this beginning, and write it where asked.

    Raises:
        InvalidValueError: no such trial, a trial where nothing moves, or a wish that cannot be met.
        NoGraphicsError: the machine cannot draw.
    """
    record = read_trial(root, beginning)
    out = wish.out or record.folder / "trial.mp4"
    check_film(out, wish.width, wish.height, wish.fps)
    check_positive("--speed", wish.speed)
    choose_offscreen()
    from testbed.simulation.playback import Playback  # noqa: PLC0415  MuJoCo only now that it knows how to draw
    from testbed.simulation.render import drawing  # noqa: PLC0415

    playback = Playback(record.trajectory, record.object, record.grip_width)
    samples = _samples(record.trajectory, wish, one=out.suffix.lower() == ".png")

    def pictures(draw: Callable[[int], np.ndarray], progress: Progress) -> Iterator[np.ndarray]:
        for done, sample in enumerate(samples.tolist(), start=1):
            picture = draw(sample)
            yield captioned(picture, _caption(record, sample)) if wish.caption else picture
            if len(samples) > 1:
                progress("pictures", done, len(samples))

    try:
        with (
            show_progress(Console()) as progress,
            drawing(playback, wish.camera, wish.width, wish.height) as draw,
        ):
            write_film(pictures(draw, progress), out, wish.fps)
    except KeyboardInterrupt:
        print("heft: stopped; nothing was written", file=sys.stderr)
        sys.exit(130)
    return out


def _samples(trajectory: Trajectory, wish: Wish, *, one: bool) -> np.ndarray:
    """Which samples are drawn: the one asked for, or all the film's; the nearest to each instant."""
    time = trajectory.time_s
    if not one:
        rate = wish.fps / wish.speed
        count = math.floor((time[-1] - time[0]) * rate + 1e-9) + 1
        return nearest(time, time[0] + np.arange(count) / rate)
    at = (time[0] + time[-1]) / 2 if wish.at is None else wish.at
    if not time[0] <= at <= time[-1]:
        raise InvalidValueError("--at", at, f"an instant of the trial, from {time[0]:g} to {time[-1]:g} s")
    return nearest(time, np.array([at]))


def nearest(time_s: Float[np.ndarray, "T"], instants: Float[np.ndarray, "N"]) -> Int[np.ndarray, "N"]:
    """Index of the time nearest to each instant, s, the earlier of two."""
    middles = (time_s[1:] + time_s[:-1]) / 2
    return np.searchsorted(middles, instants)


def _caption(record: TrialRecord, sample: int) -> str:
    trajectory = record.trajectory
    doing = Phase(trajectory.phase[sample]).name.lower()
    what = f"{record.object.name}, {type(trajectory.action).__name__.lower()}, {record.support.replace('_', ' ')}"
    return f"{what}   {trajectory.time_s[sample]:.1f} s   {doing}"


def list_trials(console: Console, root: Path) -> None:
    """A line a trial: its key, and what was done to what."""
    table = Table()
    for column in ("trial", "object", "support", "action", "status"):
        table.add_column(column)
    for key in keys_of(root):
        said = read_json(root / "trials" / key / "trial.json") or {}
        asked, names = said.get("asked") or {}, said.get("names") or {}
        action = asked.get("action") or {}
        done = f"{action.get('kind', '?')}{' and back' if action.get('back') else ''}"
        table.add_row(key[:8], names.get("object", "?"), asked.get("support", "?"), done, said.get("status", "?"))
    console.print(table)
