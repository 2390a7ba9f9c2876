"""Trials of a results folder: as recorded, with a draw of a sensor's errors, and measured ones by object."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np

from estimators.evaluation.statistics import Row
from scenarios.results.files import check_unambiguous, done_keys, inside, read_json, some_keys
from scenarios.results.store import Store, object_request
from testbed.actions.base import Action
from testbed.actions.rotate import Rotate
from testbed.actions.weigh import Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.files import DamagedFileError, unless_damaged
from testbed.objects.chain import Chain
from testbed.objects.files import load_object
from testbed.objects.model import STROKE, Grasp, MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.noise import draw_sensing
from testbed.sensing.presets import preset
from testbed.trajectory import Trajectory, load_trajectory
from testbed.trial import Support, parse_support
from testbed.worlds.seeds import seed_of

OTHER_FORMAT = (KeyError, IndexError, TypeError, ValueError, AttributeError)
"""Errors of reading a trial.json of another format."""
_SHAPE = ("particles", "mass_group", "friction_group", "grasps", "fill", "feet")
"""Entries of the request that all trials of an object must share."""


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """One trial of a results folder."""

    folder: Path
    """trials/<key> of the results folder."""
    object: ObjectModel
    """Object that was moved; named "object" where the folder has no name."""
    support: str
    """Support that carried its weight, by name."""
    trajectory: Trajectory
    pads: tuple[float, float]
    """Distance between the pads while they hold the object, and before and after [m]."""
    request: dict[str, Any]
    """All that determines the trial, as plain data."""


def read_trial(root: Path, beginning: str) -> TrialRecord:
    """The trial of a results folder whose key has this beginning.

    Raises:
        InvalidValueError: no such trial, or more than one.
        HeftError: a file of it is damaged.
    """
    keys = keys_of(root)
    found = [key for key in keys if key.startswith(beginning)]
    check_unambiguous("TRIAL", beginning, found)
    if not found:
        allowed = f"the beginning of one trial's key in {root / 'trials'}: {some_keys(keys) or 'none'}"
        raise InvalidValueError("TRIAL", beginning, allowed)
    folder = root / "trials" / found[0]
    trajectory, content = load_trajectory(folder / "trajectory.parquet"), read_json(folder / "trial.json")
    assert content is not None
    try:
        request = content["asked"]
        obj = object_of(request["object"], content.get("names") or {})
        width, opening = pads_of(obj.shape, trajectory.action)
        if request.get("simulation", {}).get("grip", {}).get("mode") == "weld":  # the fingers stay open
            width = opening
        return TrialRecord(folder, obj, str(request["support"]), trajectory, (width, opening), request)
    except OTHER_FORMAT as error:
        raise DamagedFileError(f"{folder / 'trial.json'}: not a whole trial file: {error!r}") from None


def pads_of(shape: ObjectShape, action: Action) -> tuple[float, float]:
    """Distance between the pads in an action: while they hold the object, and before and after [m]."""
    if action.grasp is None:
        return STROKE, STROKE
    grasp = shape.grasps[action.grasp]
    return grasp.width, grasp.opening or STROKE


def object_of(request: dict[str, Any], names: dict[str, Any]) -> ObjectModel:
    """Object of a trial, with its solids where the object of its name still has them.

    Args:
        request: object as `object_request` wrote it.
        names: names of the object, its mass groups and its grasps, where known.
    """
    called = names.get("grasps") or [str(i) for i in range(len(request["grasps"]))]
    grasps = [
        Grasp(str(name), np.array([x, y]), *size) for name, (x, y, *size) in zip(called, request["grasps"], strict=True)
    ]
    shape = ObjectShape(
        particles=np.array(request["particles"]),
        mass_group=np.array(request["mass_group"]),
        friction_group=np.array(request["friction_group"]),
        cell=request["cell"],
        height=request["height"],
        grasps=tuple(grasps),
        group_names=tuple(names.get("groups") or ()),
        fill=np.array(request.get("fill", [])),
        chain=Chain(np.array(chain["link"]), np.array(chain["hinges"])) if (chain := request.get("chain")) else None,
        stands_on_feet=request.get("feet") == "known",
    )
    truth = MassDistribution(np.array(request["mass"]), np.array(request["friction"]))
    known = request.get("masses") != "unknown"
    hinges = tuple(chain["friction"]) if chain else ()
    name = str(names.get("object") or "object")
    model = ObjectModel(name, shape, truth, masses_known=known, hinge_friction=hinges)
    if not request["solids"]:
        return model
    try:
        whole = load_object(model.name)
    except HeftError:
        return model  # its particles are known all the same
    same = object_request(whole)["solids"] == request["solids"]
    return replace(model, solids=whole.solids) if same else model


def keys_of(root: Path) -> list[str]:
    """Keys of all whole trials, sorted.

    Raises:
        InvalidValueError: not a results folder.
    """
    if not (root / "trials").is_dir():
        raise InvalidValueError("DIR", str(root), "a results folder, with trials in it")
    return done_keys(root, "trials")


def kind_of_trial(root: Path, key: str) -> str:
    """Kind of a trial's action, such as "rotate"; empty where its trial.json does not say.

    Raises:
        DamagedFileError: it is damaged.
    """
    try:
        return str(_asked(root, key)["action"]["kind"])
    except (KeyError, TypeError):
        return ""


def log_of_trial(root: Path, key: str) -> list[str]:
    """Log and stretch of an imported trial; empty for others.

    Raises:
        DamagedFileError: its trial.json is damaged.
    """
    source = _asked(root, key).get("import", {})
    return [source[name] for name in ("log", "stretch") if name in source]


def trials_in_words(root: Path, shape: ObjectShape, keys: Sequence[str], trials: Sequence[Trajectory]) -> list[str]:
    """Number, action and log of every trial after the weighing, with the numbers of the messages of estimates."""
    each = enumerate(zip(trials, keys, strict=True), start=1)
    return [", ".join([f"{i}: {trial.action.describe(shape)}", *log_of_trial(root, key)]) for i, (trial, key) in each]


def _asked(root: Path, key: str) -> dict[str, Any]:
    """Request of a trial, as its trial.json has it."""
    return (read_json(inside(root, "trials", key, "trial.json")) or {}).get("asked", {})


def sensed_trials(store: Store, keys: tuple[str, ...], sensing: str, seed: int) -> list[Trajectory]:
    """Trials with one draw of a sensor's errors; measured ones unchanged. Read-only, since methods share them.

    Args:
        store: results folder.
        keys: keys in the order in which the trials were made, the weighing first, the held-out ones last.
        sensing: name of the preset.
        seed: seed of the draw.
    """
    return list(_draw(store, keys, sensing, seed, store.secret))


def trials_behind(folder: Path, row: Row) -> list[Trajectory]:
    """Trials of an estimate as its method received them, the weighing first."""
    return sensed_trials(Store(folder), tuple(row["trial_keys"]), row["sensing"], int(row["seed"]))


@lru_cache(maxsize=8)
def _draw(store: Store, keys: tuple[str, ...], sensing: str, seed: int, secret: str) -> tuple[Trajectory, ...]:
    """Draws of the last experiments, cached for the next methods of a worker."""
    drawn = [sensed(t, sensing, seed, i, keys[i], secret) for i, t in enumerate(_trajectories(store, keys))]
    for trajectory in drawn:
        for value in vars(trajectory).values():
            if isinstance(value, np.ndarray):
                value.setflags(write=False)
    return tuple(drawn)


def sensed(trajectory: Trajectory, sensing: str, seed: int, index: int, key: str, secret: str) -> Trajectory:
    """Trial number `index` of an experiment, blinded, with one draw of a sensor's errors where the record has none.

    Methods and policies receive trials from this function only.
    """
    if not trajectory.is_clean:  # measured, or by a runner that draws errors of its own
        return trajectory.blinded()
    # each trial of each draw has a stream of its own, a repeated trial included
    return draw_sensing(trajectory, preset(sensing), seed_of(secret, seed, index, key)).blinded()


@lru_cache(maxsize=4)
def _trajectories(store: Store, keys: tuple[str, ...]) -> tuple[Trajectory, ...]:
    """Trials of one experiment, cached for the next draws and methods of a worker."""
    return tuple(store.trajectory(key) for key in keys)


@dataclass(frozen=True, eq=False)
class MeasuredTrials:
    """Measured trials of one object under one support."""

    object: ObjectModel
    """Object as in its last trial; the estimates are compared with its masses."""
    support: Support
    """Support as stated by the operator."""
    weighing: str
    """Key of its last weighing."""
    moved: tuple[str, ...]
    """Keys of its turns and slides in order of recording."""
    held_out: tuple[str, ...]
    """Keys of turns that are hidden from the methods."""


def measured_records(root: Path) -> list[TrialRecord]:
    """All whole trials of a folder in order of recording, unusable ones included; a warning for damaged ones.

    Trials of logs without a date come first, in order of import.

    Raises:
        InvalidValueError: not a results folder, or simulated trials.
    """
    read = [unless_damaged(lambda key=key: read_trial(root, key), "left out") for key in keys_of(root)]
    trials = [trial for trial in read if trial is not None]
    for trial in trials:
        if trial.trajectory.simulated:
            key = trial.folder.name[:8]
            allowed = f"a folder of measured trials, but {key} is simulated: heft run asks about these"
            raise InvalidValueError("DIR", str(root), allowed)
    return sorted(trials, key=recorded_order)


def recorded_order(trial: TrialRecord) -> tuple[str, ...]:
    """Sort key of a trial: the times of its recording and import, empty for a simulated one, and its key."""
    origin = trial.trajectory.provenance
    return origin.get("recorded", ""), origin.get("imported", ""), trial.folder.name


def is_weighed(root: Path, name: str) -> bool:
    """True if a folder has a weighing of an object."""
    weighings = [key for key in keys_of(root) if kind_of_trial(root, key) == Weigh.kind]
    return any(read_trial(root, key).object.name == name for key in weighings)


def measured_trials(
    root: Path, objects: Sequence[str] | None = None, held_out: int = 0
) -> tuple[list[MeasuredTrials], list[str]]:
    """Measured trials of a folder by object and support, and a line for each that is left out as unusable.

    Args:
        root: results folder.
        objects: names of the objects to take; None is all.
        held_out: number of last turns at constant speed, of each object and support, hidden from the methods.

    Raises:
        InvalidValueError: simulated trials, no trials, an object that is not there, was never weighed, or was not
            always of the same shape.
    """
    if held_out < 0:
        raise InvalidValueError("--held-out", held_out, "an integer >= 0")
    trials = measured_records(root)
    names = list(dict.fromkeys(t.object.name for t in trials))
    if unknown := [name for name in objects or () if name not in names]:
        raise InvalidValueError("--objects", " ".join(unknown), f"objects of {root}: {', '.join(names)}")
    wanted = [t for t in trials if objects is None or t.object.name in objects]
    left_out = [
        f"trial {t.folder.name[:8]} of {t.object.name} is left out: {t.trajectory.status}: {t.trajectory.reason}"
        for t in wanted
        if not t.trajectory.ok
    ]
    weighings: dict[str, str] = {}
    groups: dict[tuple[str, str], list[TrialRecord]] = {}
    for t in wanted:
        if t.trajectory.ok and not t.trajectory.action.moves:
            weighings[t.object.name] = t.folder.name
        elif t.trajectory.ok:
            groups.setdefault((t.object.name, t.support), []).append(t)
    if not groups:
        why = f"; {len(left_out)} are no data" if left_out else ""
        allowed = "a folder with turns or slides, as heft robot trial and heft import make them"
        raise InvalidValueError("DIR", str(root), f"{allowed}{why}")
    return [_of_group(root, group, weighings, held_out) for group in groups.values()], left_out


def _of_group(root: Path, group: list[TrialRecord], weighings: dict[str, str], held_out: int) -> MeasuredTrials:
    last, name = group[-1], group[-1].object.name
    if name not in weighings:
        allowed = f"a folder in which {name} was weighed: heft robot trial --action weigh --weight KG, or heft import"
        raise InvalidValueError("DIR", str(root), f"{allowed} --weight KG")
    for other in group:
        if any(other.request["object"].get(part) != last.request["object"].get(part) for part in _SHAPE):
            keys = f"{other.folder.name[:8]} and {last.folder.name[:8]}"
            allowed = f"trials of one shape; {keys} differ: import them again, or apart"
            raise InvalidValueError(name, f"two shapes in {root}", allowed)
    turns = [t.folder.name for t in group if t.trajectory.action.kind == Rotate.kind]
    if held_out and (held_out > len(turns) or held_out == len(group)):
        most = min(len(turns), len(group) - 1)
        raise InvalidValueError("--held-out", held_out, f"at most {most} of {name}'s turns; a method needs one trial")
    kept_back = tuple(turns[len(turns) - held_out :])
    moved = tuple(t.folder.name for t in group if t.folder.name not in kept_back)
    support = parse_support(last.support)
    return MeasuredTrials(last.object, support, weighings[name], moved, kept_back)
