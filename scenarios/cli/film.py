"""Recorded trials as films and pictures; and heft watch, a trial in an interactive window."""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro

from scenarios.cli.terminal import default_hint
from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from rich.table import Table

    from scenarios.results.trials import TrialRecord
    from scenarios.study.experiment import Progress
    from testbed.objects.model import ObjectShape
    from testbed.trajectory import Trajectory

FILM_S = 20.0
"""Longest film at the default speed [s]."""


@dataclass(frozen=True)
class RenderRequest:
    """Options of a film or a picture of a trial."""

    out: Annotated[Path | None, tyro.conf.arg(metavar="FILE", help_behavior_hint=default_hint)] = None
    """output file (.mp4, .gif or .png); default: DIR/trials/TRIAL/trial.mp4."""
    width: Annotated[int, tyro.conf.arg(metavar="PX")] = 960
    """width of the picture, px; even."""
    height: Annotated[int, tyro.conf.arg(metavar="PX")] = 640
    """height of the picture, px; even."""
    fps: Annotated[float, tyro.conf.arg(metavar="N")] = 25.0
    """pictures per second of film."""
    speed: Annotated[float | None, tyro.conf.arg(metavar="X", help_behavior_hint=default_hint)] = None
    """seconds of trial per second of film, 1 for real time; default: the film lasts at most 20 s."""
    camera: Literal["bench", "object", "above"] = "bench"
    """bench (whole scene), object (close-up), or above (the object without the arm)."""
    at: Annotated[float | None, tyro.conf.arg(metavar="S", help_behavior_hint=default_hint)] = None
    """time of the picture of a .png, s; default: the middle."""
    caption: bool = True
    """write the object, the action and the time into each picture."""


def render_trial(root: Path, beginning: str, request: RenderRequest, progress: Progress) -> tuple[Path, float]:
    """Render a trial by the beginning of its key; return the file and the speed of the film.

    Raises:
        InvalidValueError: no such trial, a trial where nothing moves, or options that do not fit.
        NoGraphicsError: the machine cannot draw.
    """
    from scenarios.results.files import inside
    from scenarios.results.trials import read_trial
    from testbed.simulation.graphics import choose_offscreen
    from testbed.validation import check_positive
    from viz.film import captioned, check_film, write_film

    record = read_trial(root, beginning)
    out = request.out or inside(root, "trials", record.folder.name, "trial.mp4")
    check_film(out, request.width, request.height, request.fps)
    still, pace = out.suffix.lower() == ".png", pace_of(record.trajectory, request)
    option, given, ending = ("--speed", request.speed, ".mp4 or .gif") if still else ("--at", request.at, ".png")
    if given is not None:
        raise InvalidValueError(option, given, f"only with a {ending} file as --out")
    check_positive("--speed", pace)
    choose_offscreen()
    from testbed.simulation.rendering import Playback, drawing

    playback = Playback(record.trajectory, record.object, record.pads)
    samples = _samples(record.trajectory, request, 0 if still else pace)

    def pictures(draw: Callable[[int], np.ndarray]) -> Iterator[np.ndarray]:
        for done, sample in enumerate(samples.tolist(), start=1):
            picture = draw(sample)
            yield captioned(picture, _caption(record, sample)) if request.caption else picture
            if len(samples) > 1:
                progress("pictures", done, len(samples))

    try:
        with drawing(playback, request.camera, request.width, request.height) as draw:
            write_film(pictures(draw), out, request.fps)
    except KeyboardInterrupt:
        print("heft: stopped; nothing was written", file=sys.stderr)
        sys.exit(130)
    return out, 1.0 if still else pace


def pace_of(trajectory: Trajectory, request: RenderRequest) -> float:
    """Seconds of trial per second of film: the requested ones, or the least whole number for at most FILM_S."""
    if request.speed is not None:
        return request.speed
    return float(max(1, math.ceil((trajectory.time_s[-1] - trajectory.time_s[0]) / FILM_S)))


def _samples(trajectory: Trajectory, request: RenderRequest, pace: float) -> np.ndarray:
    """Indices of the samples to draw: those of a film at a pace, or the one of a picture at pace 0."""
    time = trajectory.time_s
    if pace:
        rate = request.fps / pace
        count = math.floor((time[-1] - time[0]) * rate + 1e-9) + 1
        return nearest(time, time[0] + np.arange(count) / rate)
    at = (time[0] + time[-1]) / 2 if request.at is None else request.at
    if not time[0] <= at <= time[-1]:
        raise InvalidValueError("--at", at, f"an instant of the trial, from {time[0]:g} to {time[-1]:g} s")
    return nearest(time, np.array([at]))


def nearest(time_s: Float[np.ndarray, "T"], instants: Float[np.ndarray, "N"]) -> Int[np.ndarray, "N"]:
    """Index of the time nearest to each instant [s], the earlier of two."""
    middles = (time_s[1:] + time_s[:-1]) / 2
    return np.searchsorted(middles, instants)


def _caption(record: TrialRecord, sample: int) -> str:
    from testbed.trajectory import Phase

    trajectory = record.trajectory
    doing = Phase(trajectory.phase[sample]).name.lower()
    what = f"{record.object.name}, {trajectory.action.kind}, {record.support.replace('_', ' ')}"
    return f"{what}   {trajectory.time_s[sample]:.1f} s   {doing}"


def list_trials(root: Path) -> Table:
    """Table of the trials of a results folder, by object, support and grasp."""
    from rich.table import Table

    from scenarios.results.files import read_json
    from scenarios.results.trials import keys_of
    from testbed.files import unless_damaged

    table = Table("trial", "object", "support", "grasp", "action", "status")
    keys = keys_of(root)
    read = [unless_damaged(lambda key=key: read_json(root / "trials" / key / "trial.json"), "left out") for key in keys]
    lines = [_line_of(key, content) for key, content in zip(keys, read, strict=True) if content is not None]
    for line in sorted(lines, key=lambda line: (*line[1:], line[0])):
        table.add_row(*line)
    return table


def _line_of(key: str, content: dict[str, Any]) -> tuple[str, ...]:
    """Key, object, support, grasp, action and status of a trial; "?" where its file lacks them."""
    from scenarios.results.trials import OTHER_FORMAT

    try:
        asked, names, action = content["asked"], content["names"], content["asked"]["action"]
        grasp = "-" if action.get("grasp") is None else names["grasps"][action["grasp"]]
        done = f"{action['kind']}{' and back' if action.get('back') else ''}"
        return key[:8], names["object"], asked["support"], grasp, done, content["status"]
    except OTHER_FORMAT:
        return key[:8], "?", "?", "?", "?", str(content.get("status", "?"))


def watch(
    what: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="OBJECT|DIR")] = "L2",
    trial: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="TRIAL")] = None,
    *,
    action: Literal["rotate", "slide", "accelerate"] = "rotate",
    grasp: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    support: Annotated[str | None, tyro.conf.arg(metavar="SUPPORT")] = None,
) -> None:
    """Show a trial in a window: heft watch OBJECT simulates one live, heft watch DIR TRIAL plays a recorded one.

    Needs a display; heft view DIR TRIAL --film does not. Space starts and stops, backspace restarts, F1 lists all keys.

    Examples: heft watch hammer --action slide --grasp handle_mid
              heft watch results/blocks 3f9a

    Args:
        what: object, by name in the library or path to a TOML file; or the results folder of a run.
        trial: key of a trial in that folder, or an unambiguous beginning of it.
        action: action to simulate, at its default speed and duration.
        grasp: grasp by name (see heft show); default: the first.
        support: support of the object: own_weight, rigid, or a stiffness in N/m; default: rigid for an object with
            contact points, otherwise own_weight.
    """
    if trial is None:
        watch_live(what, action, grasp, support)
    else:
        watch_record(Path(what), trial)


def watch_live(name: str, action: str, grasp: str | None, support: str | None) -> None:
    """Simulate a trial in a window, and print its outcome when the window is closed.

    Raises:
        NoGraphicsError: no window can be opened.
        InvalidValueError: no such object, grasp or support.
        InfeasibleTrialError: the arm, the gripper or the table cannot do it.
    """
    from testbed.actions.base import action_from_dict
    from testbed.objects.files import load_object
    from testbed.simulation.graphics import choose_window
    from testbed.trial import Trial, support_of

    obj = load_object(name)
    asked = action_from_dict({"kind": action, "grasp": grasp_index(obj.shape, grasp)})
    trial = Trial(obj, asked, support_of(obj.shape, support))
    choose_window()
    from testbed.simulation.watch import KEYS, LiveTrial, watch  # now that MuJoCo knows how to draw

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
    from scenarios.results.trials import read_trial
    from testbed.simulation.graphics import choose_window

    record = read_trial(root, beginning)
    choose_window()
    from testbed.simulation.rendering import Playback
    from testbed.simulation.watch import KEYS, Replay, watch

    replay = Replay(Playback(record.trajectory, record.object, record.pads))
    print(KEYS, flush=True)
    watch(replay, f"heft: {record.object.name}, trial {record.folder.name}")


def grasp_index(shape: ObjectShape, name: str | None) -> int:
    """Index of a grasp by its name; the first by default."""
    names = [grasp.name for grasp in shape.grasps]
    if name is None and names:
        return 0
    if name not in names:
        raise InvalidValueError("--grasp", name, ", ".join(names) or "none: nothing is grippable")
    return names.index(name)
