"""What a results folder has of a real bench: the trials of each object, by who carried its weight."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scenarios.results.store import read_json
from scenarios.results.trials import keys_of, object_of
from testbed.actions.rotate import Rotate
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.model import ObjectModel
from testbed.trajectory import Trajectory, load_trajectory
from testbed.trial import Support, parse_support

_SHAPE = ("particles", "mass_group", "friction_group", "grasps", "fill")
"""What all trials of an object must have been asked for with."""


@dataclass(frozen=True, eq=False)
class Measured:
    """One object under one support."""

    object: ObjectModel
    """As its last trial has it; its masses are what the answers are held against."""
    support: Support
    """Who carried its weight, as far as whoever ran the trials knew."""
    weighing: str
    """Key of its last weighing."""
    moved: tuple[str, ...]
    """Keys of its turns and slides in order of recording."""
    held_out: tuple[str, ...]
    """Keys of turns that no method is given."""


@dataclass(frozen=True, eq=False)
class MeasuredTrial:
    """One trial as it lies in the folder."""

    key: str
    asked: dict[str, Any]
    """All that decided it."""
    names: dict[str, Any]
    """Of its object, and of that one's groups and grasps."""
    trajectory: Trajectory

    @property
    def object(self) -> str:
        """Name of what was moved."""
        return str(self.names["object"])


def measured_trials(folder: Path) -> list[MeasuredTrial]:
    """All trials of a folder in order of recording, those that are no data among them.

    Raises:
        InvalidValueError: not a results folder, or simulated trials.
        HeftError: a file is damaged.
    """
    trials = [_read(folder, key) for key in keys_of(folder)]
    return sorted(trials, key=lambda t: (t.trajectory.provenance.get("recorded", ""), t.key))


def measured_in(
    folder: Path, objects: Sequence[str] | None = None, held_out: int = 0
) -> tuple[list[Measured], list[str]]:
    """The measured trials of a folder, and a line for each that is left out because it is no data.

    Args:
        folder: results folder.
        objects: names of those to take; None is all.
        held_out: number of each one's last turns at constant speed that are kept from the methods.

    Raises:
        InvalidValueError: simulated trials, no trials, an object that is not there, was never weighed, or was not
            always of the same shape.
        HeftError: a file is damaged.
    """
    if held_out < 0:
        raise InvalidValueError("--held-out", held_out, "an integer >= 0")
    trials = measured_trials(folder)
    names = list(dict.fromkeys(t.object for t in trials))
    if unknown := [name for name in objects or () if name not in names]:
        raise InvalidValueError("--objects", " ".join(unknown), f"objects of {folder}: {', '.join(names)}")
    wanted = [t for t in trials if objects is None or t.object in objects]
    left_out = [
        f"trial {t.key[:8]} of {t.object} is left out: {t.trajectory.status}: {t.trajectory.reason}"
        for t in wanted
        if not t.trajectory.ok
    ]
    sound = [t for t in wanted if t.trajectory.ok]
    weighings = {t.object: t.key for t in sound if not t.trajectory.action.moves}
    groups: dict[tuple[str, str], list[MeasuredTrial]] = {}
    for t in sound:
        if t.trajectory.action.moves:
            groups.setdefault((t.object, str(t.asked["support"])), []).append(t)
    if not groups:
        why = f"; {len(left_out)} are no data" if left_out else ""
        allowed = "a folder with turns or slides, as heft robot trial and heft import make them"
        raise InvalidValueError("DIR", str(folder), f"{allowed}{why}")
    return [_measured(folder, group, weighings, held_out) for group in groups.values()], left_out


def _read(folder: Path, key: str) -> MeasuredTrial:
    path = folder / "trials" / key
    said, trajectory = read_json(path / "trial.json") or {}, load_trajectory(path / "trajectory.parquet")
    if trajectory.provenance.get("runner") == "simulation":
        raise InvalidValueError(
            "DIR", str(folder), f"a folder of measured trials, but {key[:8]} is simulated: heft run asks about these"
        )
    try:
        trial = MeasuredTrial(key, said["asked"], said["names"], trajectory)
        if trial.object and trial.asked["support"] and trial.asked["object"]:
            return trial
    except (KeyError, TypeError):
        pass
    raise HeftError(f"{path / 'trial.json'}: not a whole trial file")


def _measured(folder: Path, group: list[MeasuredTrial], weighings: dict[str, str], held_out: int) -> Measured:
    last, name = group[-1], group[-1].object
    if name not in weighings:
        allowed = f"a folder in which {name} was weighed: heft robot trial --action weigh --weight KG, or heft import"
        raise InvalidValueError("DIR", str(folder), f"{allowed} --weight KG")
    for other in group:
        if any(other.asked["object"].get(part) != last.asked["object"].get(part) for part in _SHAPE):
            allowed = f"trials of one shape; {other.key[:8]} and {last.key[:8]} differ: import them again, or apart"
            raise InvalidValueError(name, f"two shapes in {folder}", allowed)
    turns = [t.key for t in group if t.trajectory.action.kind == Rotate.kind]
    if held_out and (held_out > len(turns) or held_out == len(group)):
        most = min(len(turns), len(group) - 1)
        raise InvalidValueError("--held-out", held_out, f"at most {most} of {name}'s turns; a method needs one trial")
    kept_back = tuple(turns[len(turns) - held_out :])
    moved = tuple(t.key for t in group if t.key not in kept_back)
    support = parse_support(str(last.asked["support"]).removesuffix(" N/m"))
    return Measured(object_of(last.asked["object"], last.names), support, weighings[name], moved, kept_back)
