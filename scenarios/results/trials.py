"""A trial read back from its folder, simulated or real: the record, and the object that was moved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from estimators.particles.wrench import predicted_wrenches
from scenarios.results.store import Store, object_request, read_json
from scenarios.study.estimates import is_simulated, sensed
from testbed.errors import HeftError, InvalidValueError
from testbed.foot_forces import load_foot_forces
from testbed.objects.files import load_object
from testbed.objects.gripper import STROKE
from testbed.objects.model import Grasp, MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.windows import sample_deviation, steady_samples, wrench_in_object
from testbed.trajectory import Trajectory, load_trajectory
from viz.values import TrialView, WrenchFit, support_name

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
        grasp = trajectory.action.grasp
        width = STROKE if grasp is None else obj.shape.grasps[grasp].width
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


POSES_EVERY = 5
"""The bench moves at one sample in so many."""
WITHIN = 1.96
"""Standard deviations to each side that hold 95 %."""
PLANAR = (0, 1, 5)
"""Force x, y and torque z of a wrench."""


def sensing_of(folder: Path) -> str:
    """How a folder's simulated trials are shown: the scenario's first sensor that errs, else a perfect one."""
    asked = ((read_json(folder / "manifest.json") or {}).get("scenario") or {}).get("sensing") or []
    return next((name for name in asked if name != "ideal"), "ideal")


def trial_shown(folder: Path, key: str, *, seed: int = 0, meshes: bool = True) -> TrialView:
    """A trial by its key; a simulated one is given a draw of the sensor's errors, and the true masses as a model.

    Args:
        folder: results folder.
        key: whole, or a beginning that no other has.
        seed: of the draw.
        meshes: dress the arm in its own meshes where the extra "meshes" is installed.

    Raises:
        InvalidValueError: a weighing, where nothing moves.
        HeftError: a file of it is damaged.
    """
    record = read_trial(folder, key)
    trajectory, said = record.trajectory, "as measured"
    if is_simulated(trajectory):
        sensing = sensing_of(folder)
        trajectory = sensed(Store(folder), (record.folder.name,), sensing, seed)[0]
        said = f"{sensing}, draw {seed}"
    model = record.object.truth if is_simulated(trajectory) else None
    called = "the true masses, each on its own weight"
    return show_trial(record, trajectory, record.object.shape, model, called, {"sensing": said}, meshes=meshes)


def show_trial(
    record: TrialRecord,
    trajectory: Trajectory,
    shape: ObjectShape,
    model: MassDistribution | None,
    called: str,
    facts: dict[str, str],
    *,
    meshes: bool = True,
) -> TrialView:
    """A trial with what a model says of it.

    Args:
        record: the trial as it lies in the folder.
        trajectory: as sensed.
        shape: the model's particles.
        model: masses and friction that the wrench is predicted from; None without.
        called: which masses those are.
        facts: more to be said.
        meshes: as `trial_shown`.
    """
    from testbed.simulation.rendering import body_poses  # noqa: PLC0415  graphics are chosen before MuJoCo loads

    action = trajectory.action
    if not action.moves:
        raise InvalidValueError(
            "TRIAL", f"{record.folder.name[:8]}, a weighing", "a slide or a turn: nothing else moves"
        )
    feet = record.folder / "foot_forces.parquet"
    predicted = None if model is None else predicted_wrenches(shape, model, [trajectory])[0]
    name = trajectory.action.describe(record.object.shape)
    return TrialView(
        title=f"{record.object.name}: {name}",
        shape=record.object.shape,
        trajectory=trajectory,
        poses=body_poses(trajectory, record.grip_width, meshes=meshes, every=POSES_EVERY),
        pose_times=trajectory.time_s[::POSES_EVERY],
        fit=wrench_fit(name, trajectory, predicted),
        model=called if model is not None else "",
        truth=record.object.truth if is_simulated(trajectory) else None,
        feet=load_foot_forces(feet) if feet.is_file() else None,
        facts={
            "object": record.object.name,
            "action": name,
            "support": support_name(record.support) if is_simulated(trajectory) else "",
            "trial": record.folder.name,
            "runner": trajectory.provenance.get("runner", ""),
            "arm": "" if trajectory.joint_position.any() else "not where it was: its joints were not logged",
            "feet": "" if feet.is_file() else "forces not known: no foot_forces.parquet beside this trial",
        }
        | facts,
    )


def wrench_fit(label: str, trajectory: Trajectory, predicted: np.ndarray | None) -> WrenchFit:
    """Measured against predicted (T, 3), in the object's axes."""
    steady = np.zeros(len(trajectory.time_s), dtype=bool)
    try:
        for kept in steady_samples(trajectory):
            steady[kept] = True
    except InvalidValueError:  # cut short before it was steady: it is still worth seeing
        pass
    measured = wrench_in_object(trajectory)[:, PLANAR]
    deviation = sample_deviation(trajectory)[list(PLANAR)]
    return WrenchFit(
        label,
        trajectory.time_s,
        measured,
        steady,
        np.full_like(measured, np.nan) if predicted is None else predicted,
        np.broadcast_to(WITHIN * deviation, measured.shape),
    )


def kind_of_trial(folder: Path, key: str) -> str:
    """What was done: "weigh", "rotate", "accelerate", "slide" or "lift"; empty where its trial.json does not say."""
    asked = (read_json(folder / "trials" / key / "trial.json") or {}).get("asked") or {}
    return str((asked.get("action") or {}).get("kind") or "")
