"""What a results folder holds, read back to be looked at: a trial, an estimate, an object under every method."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from estimators.protocol import Trace
from estimators.wrench_prediction import predicted_wrenches
from scenarios.comparison import Row, axes_of, select
from scenarios.estimates import sensed
from scenarios.results import load_results
from scenarios.store import Store, read_json, rows_of
from scenarios.tables import SUPPORT_NAMES
from scenarios.trial_record import TrialRecord, read_trial
from testbed.actions import Rotate, Slide, Weigh
from testbed.errors import HeftError, InvalidValueError
from testbed.foot_forces import load_foot_forces
from testbed.objects import MassDistribution, ObjectModel, ObjectShape
from testbed.reduction import sample_deviation, steady_samples, wrench_in_object
from testbed.simulation.replay import body_poses
from testbed.trajectory import Trajectory
from viz.estimate_shown import EstimateShown
from viz.trial_view import TrialShown
from viz.wrench_fit import WrenchFit

POSES_EVERY = 5
"""The bench moves at one sample in so many."""
WITHIN = 1.96
"""Standard deviations to each side that hold 95 %."""
PLANAR = (0, 1, 5)
"""Force x, y and torque z of a wrench."""


def rows_in(folder: Path) -> Sequence[Row]:
    """The rows of the estimates that are done; of a finished run in the order in which they were asked for."""
    if (folder / "results.parquet").is_file():
        return rows_of(load_results(folder))
    done = sorted(folder.glob("estimates/*/result.json"))
    return [{"key": path.parent.name} | said for path in done if (said := read_json(path))]


def sensing_of(folder: Path) -> str:
    """How a folder's simulated trials are shown: the scenario's first sensor that errs, else a perfect one."""
    asked = ((read_json(folder / "manifest.json") or {}).get("scenario") or {}).get("sensing") or []
    return next((name for name in asked if name != "ideal"), "ideal")


def trial_shown(folder: Path, key: str, *, seed: int = 0, meshes: bool = True) -> TrialShown:
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


def is_simulated(trajectory: Trajectory) -> bool:
    """Whether the truth behind a record is known."""
    return trajectory.provenance.get("runner") == "simulation"


def show_trial(
    record: TrialRecord,
    trajectory: Trajectory,
    shape: ObjectShape,
    model: MassDistribution | None,
    called: str,
    facts: dict[str, str],
    *,
    meshes: bool = True,
) -> TrialShown:
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
    action = trajectory.action
    if isinstance(action, Weigh):
        raise InvalidValueError(
            "TRIAL", f"{record.folder.name[:8]}, a weighing", "a slide or a turn: nothing else moves"
        )
    feet = record.folder / "foot_forces.parquet"
    predicted = None if model is None else predicted_wrenches(shape, model, [trajectory])[0]
    name = f"{describe(trajectory, record.object.shape)}"
    return TrialShown(
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
            "support": SUPPORT_NAMES.get(record.support, record.support) if is_simulated(trajectory) else "",
            "trial": record.folder.name,
            "runner": trajectory.provenance.get("runner", ""),
            "feet": "" if feet.is_file() else "forces not known: no foot_forces.parquet beside this trial",
        }
        | facts,
    )


def describe(trajectory: Trajectory, shape: ObjectShape) -> str:
    """What was done, in words."""
    action = trajectory.action
    if isinstance(action, Weigh):
        return "weigh"
    held = shape.grasps[action.grasp].name if action.grasp < len(shape.grasps) else f"grasp {action.grasp}"
    if isinstance(action, Slide):
        return f"slide at {held}, towards {np.degrees(action.direction):.0f} deg"
    if isinstance(action, Rotate):
        return f"turn at {held}, {np.degrees(action.speed):+.0f} deg/s{' and back' if action.back else ''}"
    return f"accelerated turn at {held}"


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


def estimate_shown(folder: Path, row: Row) -> EstimateShown:
    """An estimate by its row.

    Raises:
        InvalidValueError: it was written by a version that did not keep what is to be seen.
        HeftError: a file of it is damaged.
    """
    arrays = _arrays(folder / "estimates" / row["key"] / "estimate.npz")
    record = typical_trial(folder, row)
    shape = ObjectShape(
        arrays["particles"],
        arrays["mass_group"],
        arrays["friction_group"],
        float(arrays["cell"]),
        record.object.shape.height,
        record.object.shape.grasps,
        tuple(row["group_names"]),
    )
    truth = MassDistribution(
        np.array(row["true_mass_kg"]) / shape.particles_per_group, friction_of(record.object, shape)
    )
    answer = MassDistribution(arrays["mass"], arrays["friction"]) if "mass" in arrays else None
    support = SUPPORT_NAMES.get(row["support"], row["support"])
    return EstimateShown(
        title=f"{row['object']}, {support}, {row['sensing']}: {row['method']}",
        shape=shape,
        truth=truth,
        answer=answer,
        covariance=arrays.get("covariance"),
        traces=_traces(arrays, str(row.get("optimizer") or "")),
        trajectory=record.trajectory,
        facts=_facts(row),
    )


def friction_of(truth: ObjectModel, shape: ObjectShape) -> Float[np.ndarray, "n_mu"]:
    """The object's friction by the friction groups of an estimator's shape: their mean, where it has more of them."""
    touching = truth.shape.friction_group >= 0
    each = truth.truth.friction[truth.shape.friction_group[touching]]
    near = np.asarray(KDTree(truth.shape.particles[touching]).query(shape.particles)[1])
    return np.array([each[near[shape.friction_group == group]].mean() for group in range(shape.n_mu)])


def fits_of(
    folder: Path, row: Row, shown: EstimateShown
) -> tuple[list[TrialRecord], list[Trajectory], list[WrenchFit]]:
    """The moved trials behind an estimate, as sensed, and how the answer explains each."""
    keys = tuple(row["trial_keys"])
    drawn = sensed(Store(folder), keys, row["sensing"], int(row["seed"]))
    records = [read_trial(folder, key) for key in keys]
    moved = [(r, t) for r, t in zip(records, drawn, strict=True) if not isinstance(t.action, Weigh)]
    trajectories = [t for _, t in moved]
    predicted: list[Any] = [None] * len(moved)
    if shown.answer is not None:
        predicted = list(predicted_wrenches(shown.shape, shown.answer, trajectories))
    fits = [
        wrench_fit(f"{i + 1}: {describe(t, r.object.shape)}", t, p)
        for i, ((r, t), p) in enumerate(zip(moved, predicted, strict=True))
    ]
    return [r for r, _ in moved], trajectories, fits


def settings_of(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """What one object was asked under, in words, and its first draw by every method: a comparison each."""
    axes = axes_of(rows)
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row.get("key") and row.get("trial_keys") is not None:
            groups.setdefault((row["support"], row["sensing"], *(row.get(axis) for axis in axes)), []).append(row)
    named = []
    for (support, sensing, *values), found in groups.items():
        swept = [f"{axis.removeprefix('axis.')} {value}" for axis, value in zip(axes, values, strict=True)]
        first = select(found, seed=min(row["seed"] for row in found))
        named.append((", ".join([str(SUPPORT_NAMES.get(support, support)), str(sensing), *swept]), first))
    return named


def typical_trial(folder: Path, row: Row) -> TrialRecord:
    """The first turn at constant speed behind an estimate, or else what there is.

    Raises:
        InvalidValueError: the estimate does not say which trials it is from.
        HeftError: a file of it is damaged.
    """
    keys = row.get("trial_keys")
    if keys is None or len(keys) == 0:
        raise InvalidValueError("ESTIMATE", row["key"], "one that says which trials it is from: run it again")
    kinds = {key: kind_of_trial(folder, key) for key in keys}
    best = min(keys, key=lambda key: {"rotate": 0, "weigh": 2}.get(kinds[key], 1))  # of equals the first
    return _record(folder, best)


def kind_of_trial(folder: Path, key: str) -> str:
    """What was done: "weigh", "rotate", "accelerate" or "slide"; empty where its trial.json does not say."""
    asked = (read_json(folder / "trials" / key / "trial.json") or {}).get("asked") or {}
    return str((asked.get("action") or {}).get("kind") or "")


@lru_cache(maxsize=4)
def _record(folder: Path, key: str) -> TrialRecord:
    """The methods of an object are shown one after the other, with the same trial."""
    return read_trial(folder, key)


def _facts(row: Row) -> dict[str, str]:
    weight = row.get("weight_kg")
    return {
        "method": str(row["method"]),
        "object": str(row["object"]),
        "support": str(SUPPORT_NAMES.get(row["support"], row["support"])),
        "sensing": f"{row['sensing']}, draw {row['seed']}",
        "status": str(row["status"]),
        "why": str(row.get("message") or ""),
        "M as weighed": "" if weight is None else f"{weight:.3f} kg",
        "optimiser": str(row.get("optimizer") or ""),
        "computing": f"{row['seconds']:.2g} s" if row.get("seconds") is not None else "",
        "trials": str(row.get("trials") or ""),
        "robot time": f"{row['robot_s']:.0f} s" if row.get("robot_s") is not None else "",
        "not observed": str(row.get("unobserved") or ""),
        "estimate": str(row["key"]),
    }


def _traces(arrays: dict[str, np.ndarray], best: str) -> tuple[Trace, ...]:
    """The traces that a file holds; the one that led to the answer first."""
    names = [name.removesuffix(".loss") for name in arrays if name.endswith(".loss")]
    names.sort(key=lambda name: name != best.replace(" ", "_"))
    return tuple(
        Trace(
            name.replace("_", " "),
            tuple(arrays[f"{name}.loss"].tolist()),
            tuple(arrays[f"{name}.seconds"].tolist()),
            0.0,
            arrays[f"{name}.mass"],
        )
        for name in names
    )


def _arrays(path: Path) -> dict[str, np.ndarray]:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: file[name] for name in file}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise HeftError(f"{path}: not a whole estimate: {error}") from None
    if "particles" not in arrays:
        raise InvalidValueError("ESTIMATE", str(path), "one that says where its particles are: run it again")
    return arrays
