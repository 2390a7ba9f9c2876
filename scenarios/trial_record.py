"""A trial read back from its folder, simulated or real: the record, and the object that was moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from scenarios.store import object_request, read_json
from testbed.actions import Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.gripper import STROKE
from testbed.object_files import load_object
from testbed.objects import Grasp, MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory, load_trajectory

_MOST_NAMED = 6
"""Keys that an error lists."""


@dataclass(frozen=True, eq=False)
class TrialRecord:
    """One trial as it lies in a results folder."""

    folder: Path
    """trials/<key> of the results folder."""
    object: ObjectModel
    """What was moved; named "object" where the folder does not say."""
    support: str
    """Who carried its weight, as asked."""
    trajectory: Trajectory
    grip_width: float
    """Between the pads while they held it, m."""


def read_trial(root: Path, beginning: str) -> TrialRecord:
    """The trial of a results folder whose key has this beginning.

    Raises:
        InvalidValueError: no such trial, or more than one.
        HeftError: a file of it is damaged.
    """
    folder = _folder_of(root, beginning)
    trajectory, said = load_trajectory(folder / "trajectory.parquet"), read_json(folder / "trial.json") or {}
    try:
        asked = said["asked"]
        obj = object_of(asked["object"], said.get("names") or {})
        width = STROKE if isinstance(trajectory.action, Weigh) else obj.shape.grasps[trajectory.action.grasp].width
        if asked.get("simulation", {}).get("grip", {}).get("mode") == "weld":
            width = STROKE  # the fingers stay open
        return TrialRecord(folder, obj, str(asked["support"]), trajectory, width)
    except (KeyError, IndexError, TypeError, ValueError, AttributeError) as error:
        raise HeftError(f"{folder / 'trial.json'}: not a whole trial file: {error!r}") from None


def object_of(asked: dict[str, Any], names: dict[str, Any]) -> ObjectModel:
    """The object that a trial was asked for; with its solids where its name still leads to them.

    Args:
        asked: as `object_request` wrote it.
        names: of the object, its mass groups and its grasps, as far as they are known.
    """
    called = names.get("grasps") or [str(i) for i in range(len(asked["grasps"]))]
    grasps = [
        Grasp(str(name), np.array([x, y]), angle, width, length, bottom, top)
        for name, (x, y, angle, width, length, bottom, top) in zip(called, asked["grasps"], strict=True)
    ]
    shape = ObjectShape(
        particles=np.array(asked["particles"]),
        mass_group=np.array(asked["mass_group"]),
        friction_group=np.array(asked["friction_group"]),
        cell=asked["cell"],
        height=asked["height"],
        grasps=tuple(grasps),
        group_names=tuple(names.get("groups") or ()),
        fill=np.array(asked.get("fill", [])),
    )
    truth = MassDistribution(np.array(asked["mass"]), np.array(asked["friction"]))
    model = ObjectModel(str(names.get("object") or "object"), shape, truth)
    if not asked["solids"]:
        return model
    try:
        known = load_object(model.name)
    except HeftError:
        return model  # its particles are known all the same
    same = object_request(known)["solids"] == asked["solids"]
    return replace(model, solids=known.solids) if same else model


def keys_of(root: Path) -> list[str]:
    """Keys of all whole trials, sorted.

    Raises:
        InvalidValueError: not a results folder.
    """
    if not (root / "trials").is_dir():
        raise InvalidValueError("DIR", str(root), "a results folder, with trials in it")
    return sorted(path.parent.name for path in (root / "trials").glob("*/trial.json"))


def _folder_of(root: Path, beginning: str) -> Path:
    keys = keys_of(root)
    found = [key for key in keys if key.startswith(beginning)]
    if len(found) == 1:
        return root / "trials" / found[0]
    some = found or keys
    named = ", ".join(key[:8] for key in some[:_MOST_NAMED]) + (", ..." if len(some) > _MOST_NAMED else "")
    raise InvalidValueError(
        "TRIAL", beginning, f"the beginning of one trial's key in {root / 'trials'}: {named or 'none'}"
    )
