"""`heft watch`: a trial in an interactive window, simulated as one looks or played back."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from scenarios.trial_record import read_trial
from testbed.actions import Accelerate, Rotate, Slide
from testbed.errors import InvalidValueError
from testbed.object_files import load_object
from testbed.objects import ObjectShape
from testbed.simulation.graphics import choose_window
from testbed.trial import Trial, parse_support

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
    from testbed.simulation.playback import Playback  # noqa: PLC0415
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
