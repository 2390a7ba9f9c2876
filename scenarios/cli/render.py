"""`heft watch`: a trial in an interactive window, simulated as one looks or played back."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from jaxtyping import Float, Int
from rich.console import Console
from rich.table import Table

from scenarios.cli.progress import show_progress
from scenarios.results.store import read_json
from scenarios.results.trials import TrialRecord, keys_of, read_trial
from testbed.actions.accelerate import Accelerate
from testbed.actions.rotate import Rotate
from testbed.actions.slide import Slide
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectShape
from testbed.simulation.graphics import choose_offscreen, choose_window
from testbed.trajectory import Phase, Trajectory
from testbed.trial import Trial, parse_support
from testbed.validation import check_positive
from viz.film import captioned, check_film, write_film

if TYPE_CHECKING:
    from scenarios.study.experiment import Progress
    from testbed.simulation.rendering import ViewName


ActionName = Literal["rotate", "slide", "accelerate"]
_ACTIONS = {"rotate": Rotate, "slide": Slide, "accelerate": Accelerate}


def watch_live(name: str, action: ActionName, grasp: str | None, support: str) -> None:
    """Simulate a trial in a window, and say what it came to when the window is closed.

    Raises:
        NoGraphicsError: no window can be opened.
        InvalidValueError: no such object, grasp or support.
        InfeasibleTrialError: the arm, the gripper or the table cannot do it.
    """
    obj = load_object(name)
    trial = Trial(obj, _ACTIONS[action](grasp_index(obj.shape, grasp)), parse_support(support))
    choose_window()
    from testbed.simulation.watch import KEYS, LiveTrial, watch  # noqa: PLC0415  now that MuJoCo knows how to draw

    live = LiveTrial(trial)
    print(KEYS, flush=True)
    watch(live, f"heft: {obj.name}, {action}, {trial.support.name.replace('_', ' ')}")
    outcome, shown = live.outcome(), live.physics.time()
    print(
        f"{outcome.status} until {shown:.1f} of {live.duration:.1f} s{': ' if outcome.reason else ''}{outcome.reason}"
    )


def watch_record(root: Path, beginning: str) -> None:
    """Play a recorded trial in a window.

    Raises:
        NoGraphicsError: no window can be opened.
        InvalidValueError: no such trial, or one where nothing moves.
    """
    record = read_trial(root, beginning)
    choose_window()
    from testbed.simulation.rendering import Playback  # noqa: PLC0415
    from testbed.simulation.watch import KEYS, Replay, watch  # noqa: PLC0415

    replay = Replay(Playback(record.trajectory, record.object, record.grip_width))
    print(KEYS, flush=True)
    watch(replay, f"heft: {record.object.name}, trial {record.folder.name}")


def grasp_index(shape: ObjectShape, name: str | None) -> int:
    """Index of a grasp by its name; the first where none is named."""
    names = [grasp.name for grasp in shape.grasps]
    if name is None and names:
        return 0
    if name not in names:
        raise InvalidValueError("--grasp", name, ", ".join(names) or "none: nothing is grippable")
    return names.index(name)


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
    from testbed.simulation.rendering import Playback, drawing  # noqa: PLC0415

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
    what = f"{record.object.name}, {trajectory.action.kind}, {record.support.replace('_', ' ')}"
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
