"""Values that `viz` draws, from a results folder: trials, estimates, and the wrench that an estimate predicts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from estimators.evaluation.statistics import AXIS, Row, axes_of, select
from estimators.particles.wrench import predicted_wrenches
from scenarios.results.estimates import load_arrays, load_estimate, load_results, this_version
from scenarios.results.files import read_manifest
from scenarios.results.store import Store
from scenarios.results.table import TABLE, has_files, rows_of
from scenarios.results.trials import (
    TrialRecord,
    kind_of_trial,
    read_trial,
    sensed,
    sensed_trials,
    trials_behind,
)
from testbed.errors import InvalidValueError
from testbed.files import unless_damaged
from testbed.foot_forces import FootForces, load_foot_forces
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.sensing.push_windows import window_samples
from testbed.sensing.windows import sample_deviation, wrench_in_object
from testbed.trajectory import Trajectory
from viz.trials import TrialsView
from viz.values import EstimateView, TrialView, WrenchFit, support_name

POSES_EVERY = 5
"""Stride of the samples with a pose of the robot."""
WITHIN = 1.96
"""Half width of a 95 % interval [standard deviations]."""
PLANAR = (0, 1, 5)
"""Force x, y and torque z of a wrench."""


def sensing_of(folder: Path) -> str:
    """Default sensor of simulated trials in views: the scenario's first one with errors, else a perfect one."""
    names = ((read_manifest(folder) or {}).get("scenario") or {}).get("sensing") or []
    return next((name for name in names if name != "ideal"), "ideal")


def trial_view(folder: Path, key: str, *, seed: int = 0, meshes: bool = True) -> TrialView:
    """View of a trial; a simulated one has a draw of the sensor's errors, and the true masses as its model.

    Args:
        folder: results folder.
        key: key of the trial, or a unique beginning of it.
        seed: draw of the sensor's errors; replaced by a draw of the results where none of them has this one.
        meshes: True to draw the arm with its own meshes where the extra "meshes" is installed.

    Raises:
        InvalidValueError: a weighing, where nothing moves.
        HeftError: a file of it is damaged.
    """
    record = read_trial(folder, key)
    trajectory, sensor = record.trajectory, "as measured"
    if trajectory.simulated:
        whole, sensing = record.folder.name, sensing_of(folder)
        row = _row_with(folder, whole, sensing, seed)
        index, sensor = 0, f"{sensing}, an example draw"
        if row is not None:
            index, sensing, seed = list(row["trial_keys"]).index(whole), row["sensing"], int(row["seed"])
            sensor = f"{sensing}, draw {seed}"
        trajectory = sensed(trajectory, sensing, seed, index, whole, Store(folder).secret)
    model = record.object.truth if trajectory.simulated else None
    apart = record.object.shape.stands_in_groups
    name = f"the true masses, {'each on its own weight' if apart else 'one rigid body'}"
    return recorded_view(record, trajectory, record.object.shape, model, name, {"sensing": sensor}, meshes=meshes)


def _row_with(folder: Path, key: str, sensing: str, seed: int) -> Row | None:
    """Row of an estimate from a trial, preferably of this sensor and draw; None without such a row or any table."""
    if not (table := folder / TABLE).is_file():
        return None
    rows = _draws(folder, table.stat().st_mtime_ns)
    own = [row for row in rows if row["trial_keys"] is not None and key in row["trial_keys"]]
    return min(own, key=lambda row: (row["sensing"] != sensing, row["seed"] != seed), default=None)


@lru_cache(maxsize=1)
def _draws(folder: Path, _written_ns: int) -> list[dict[str, Any]]:
    """Trials, sensor and draw of each row of the table, cached until it is written again; none where it is damaged."""
    frame = unless_damaged(lambda: load_results(folder), "an example draw is shown")
    return [] if frame is None else rows_of(frame.reindex(columns=["trial_keys", "sensing", "seed"]))


def recorded_view(
    record: TrialRecord,
    trajectory: Trajectory,
    shape: ObjectShape,
    model: MassDistribution | None,
    model_name: str,
    facts: dict[str, str],
    *,
    meshes: bool = True,
) -> TrialView:
    """View of a trial of a results folder; see `view_of`.

    Raises:
        InvalidValueError: a weighing, where nothing moves.
        DamagedFileError: a file of it is damaged.
    """
    feet = record.folder / "foot_forces.parquet"
    known = {
        "support": support_name(record.support) if trajectory.simulated else "",
        "trial": record.folder.name,
        "feet": "" if feet.is_file() else "forces not known: no foot_forces.parquet beside this trial",
    }
    forces = load_foot_forces(feet) if feet.is_file() else None
    return view_of(
        record.object, trajectory, record.pads, shape, model, model_name, known | facts, feet=forces, meshes=meshes
    )


def view_of(
    obj: ObjectModel,
    trajectory: Trajectory,
    pads: tuple[float, float],
    shape: ObjectShape,
    model: MassDistribution | None,
    model_name: str,
    facts: dict[str, str],
    *,
    feet: FootForces | None = None,
    meshes: bool = True,
) -> TrialView:
    """View of a trial with the wrench that a model predicts.

    Args:
        obj: object of the trial; its masses are the truth of a simulated trial.
        trajectory: trajectory as sensed.
        pads: distance between the pads while they hold the object, and before and after [m].
        shape: particles of the model.
        model: masses and friction from which the wrench is predicted; None without a prediction.
        model_name: name of those masses.
        facts: further facts by name.
        feet: forces on the feet; None where they were not recorded.
        meshes: as in `trial_view`.

    Raises:
        InvalidValueError: a weighing, where nothing moves.
    """
    from testbed.simulation.rendering import body_poses  # noqa: PLC0415  graphics are chosen before MuJoCo loads

    if not trajectory.action.moves:
        given = " ".join(["a weighing", facts.get("trial", "")[:8]]).strip()
        raise InvalidValueError("TRIAL", given, "a slide or a turn: nothing else moves")
    predicted = None if model is None else predicted_wrenches(shape, model, [trajectory])[0]
    name = trajectory.action.describe(obj.shape)
    return TrialView(
        title=f"{obj.name}: {name}",
        shape=obj.shape,
        trajectory=trajectory,
        poses=body_poses(trajectory, pads, meshes=meshes, every=POSES_EVERY),
        pose_times=trajectory.time_s[::POSES_EVERY],
        fit=wrench_fit(name, trajectory, predicted),
        model=model_name if model is not None else "",
        truth=obj.truth if trajectory.simulated and obj.masses_known else None,
        feet=feet,
        facts={
            "object": obj.name,
            "action": name,
            "runner": trajectory.provenance.get("runner", ""),
            "arm": "" if trajectory.joint_position.any() else "not where it was: its joints were not logged",
        }
        | facts,
    )


def wrench_fit(label: str, trajectory: Trajectory, predicted: np.ndarray | None) -> WrenchFit:
    """Wrench fit of a trial, object axes; `predicted` has the shape (T, 3)."""
    steady = np.zeros(len(trajectory.time_s), dtype=bool)
    try:
        for kept in window_samples(trajectory):
            steady[kept] = True
    except InvalidValueError:  # a trial that ended before its steady window is drawn too
        pass
    measured = wrench_in_object(trajectory)[:, PLANAR]
    return WrenchFit(
        label,
        trajectory.time_s,
        measured,
        steady,
        np.full_like(measured, np.nan) if predicted is None else predicted,
        WITHIN * sample_deviation(trajectory)[:, PLANAR],
    )


def estimate_view(folder: Path, row: Row) -> EstimateView:
    """View of an estimate by its row.

    Raises:
        HeftError: a file of it is damaged.
    """
    with this_version(folder / "estimates" / row["key"]):
        answer, record = load_estimate(folder, row["key"]), typical_trial(folder, row)
        shape = _shape(folder, row, record.object)
        truth = None
        if row["true_mass_kg"] is not None:
            mass = np.array(row["true_mass_kg"]) / shape.particles_per_group
            truth = MassDistribution(mass, friction_of(record.object, shape))
        return EstimateView(
            title=f"{row['object']}, {support_name(row['support'])}, {row['sensing']}: {row['method']}",
            shape=shape,
            truth=truth,
            answer=answer.distribution,
            covariance=answer.covariance,
            traces=answer.traces,
            trajectory=record.trajectory,
            facts=_facts(row),
        )


def _shape(folder: Path, row: Row, true: ObjectModel) -> ObjectShape:
    """Shape with the particles of the estimator's grid."""
    arrays = load_arrays(folder, row["key"])
    own = {name: arrays[name] for name in ("particles", "mass_group", "friction_group", "fill")}
    return replace(true.shape, **own, cell=float(arrays["cell"]), group_names=tuple(row["group_names"]))


def friction_of(truth: ObjectModel, shape: ObjectShape) -> Float[np.ndarray, "n_mu"]:
    """True friction of the friction groups of an estimator's shape: means over the nearest particles of the truth."""
    touching = truth.shape.friction_group >= 0
    each = truth.truth.friction[truth.shape.friction_group[touching]]
    near = np.asarray(KDTree(truth.shape.particles[touching]).query(shape.particles)[1])
    return np.array([each[near[shape.friction_group == group]].mean() for group in range(shape.n_mu)])


def fits_of(folder: Path, row: Row, shown: EstimateView) -> list[tuple[str, Trajectory, WrenchFit]]:
    """Key, trajectory as sensed and wrench fit of every trial of an estimate that moves, in order."""
    drawn = zip(row["trial_keys"], trials_behind(folder, row), strict=True)
    moved = [(key, trajectory) for key, trajectory in drawn if trajectory.action.moves]
    predicted: Sequence[np.ndarray | None] = [None] * len(moved)
    if shown.answer is not None:
        predicted = predicted_wrenches(shown.shape, shown.answer, [trajectory for _, trajectory in moved])
    return [
        (key, trajectory, wrench_fit(f"{i}: {trajectory.action.describe(shown.shape)}", trajectory, wrench))
        for i, ((key, trajectory), wrench) in enumerate(zip(moved, predicted, strict=True), start=1)
    ]


def trials_view(folder: Path, rows: Sequence[Row]) -> TrialsView | None:
    """Trials of one object by its rows, under the first setting and draw, by a perfect sensor and camera.

    Returns:
        View of the trials; None where they are no longer in the folder, or nothing moves.

    Raises:
        DamagedFileError: a file of one is damaged.
    """
    found = settings_of(rows)
    if not found:
        return None
    setting, (row, *_) = found[0]
    keys = tuple(row["trial_keys"])
    if not all((folder / "trials" / key / "trial.json").is_file() for key in keys):
        return None
    shape = typical_trial(folder, row).object.shape
    view = TrialsView.of(shape, sensed_trials(Store(folder), keys, "ideal", 0), f"{row['object']}, {setting}")
    return view if view.actions else None


def settings_of(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """Settings of one object: description, and the rows of every method at the first draw."""
    axes = axes_of(rows)
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if has_files(row) and row.get("trial_keys") is not None:
            groups.setdefault((row["support"], row["sensing"], *(row.get(axis) for axis in axes)), []).append(row)
    named = []
    for (support, sensing, *values), found in groups.items():
        swept = [f"{axis.removeprefix(AXIS)} {value}" for axis, value in zip(axes, values, strict=True)]
        first = select(found, seed=min(row["seed"] for row in found))
        named.append((", ".join([support_name(support), str(sensing), *swept]), first))
    return named


def typical_trial(folder: Path, row: Row) -> TrialRecord:
    """First turn at constant speed among an estimate's trials, else the first trial that moves, else a weighing.

    Raises:
        HeftError: a file of it is damaged.
    """
    keys = row["trial_keys"]
    kinds = {key: kind_of_trial(folder, key) for key in keys}
    best = min(keys, key=lambda key: {"rotate": 0, "weigh": 2}.get(kinds[key], 1))  # min keeps the first
    return _record(folder, best)


@lru_cache(maxsize=4)
def _record(folder: Path, key: str) -> TrialRecord:
    """Record of a trial; cached, since the methods of an object are drawn in turn with the same trial."""
    return read_trial(folder, key)


def _facts(row: Row) -> dict[str, str]:
    weight = row.get("weight_kg")
    return {
        "method": str(row["method"]),
        "object": str(row["object"]),
        "support": support_name(row["support"]),
        "sensing": f"{row['sensing']}, draw {row['seed']}",
        "status": str(row["status"]),
        "why": str(row.get("message") or ""),
        "assumed, not tested": str(row.get("assumes") or ""),
        "M as weighed": "" if weight is None else f"{weight:.3f} kg",
        "optimiser": str(row.get("optimizer") or ""),
        "computing": f"{row['seconds']:.2g} s" if row.get("seconds") is not None else "",
        "trials": str(row.get("trials") or ""),
        "robot time": f"{row['robot_s']:.0f} s" if row.get("robot_s") is not None else "",
        "not observed": str(row.get("unobserved") or ""),
        "estimate": str(row["key"]),
    }
