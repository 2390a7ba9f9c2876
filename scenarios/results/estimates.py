"""Estimates of a results folder, read back to be looked at: masses, their way, and how they explain each trial."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from estimators.base import Trace
from estimators.evaluation.statistics import AXIS, Row, axes_of, select
from estimators.particles.wrench import predicted_wrenches
from scenarios.results.load import load_results
from scenarios.results.store import Store, read_json, rows_of
from scenarios.results.trials import TrialRecord, kind_of_trial, read_trial, wrench_fit
from scenarios.study.estimates import sensed
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory
from viz.values import EstimateView, WrenchFit, support_name


def rows_in(folder: Path) -> Sequence[Row]:
    """The rows of the estimates that are done; of a finished run in the order in which they were asked for."""
    if (folder / "results.parquet").is_file():
        return rows_of(load_results(folder))
    done = sorted(folder.glob("estimates/*/result.json"))
    return [{"key": path.parent.name} | said for path in done if (said := read_json(path))]


def estimate_shown(folder: Path, row: Row) -> EstimateView:
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
        arrays.get("fill", np.ones(0)),  # not in folders from before it was kept
    )
    truth = MassDistribution(
        np.array(row["true_mass_kg"]) / shape.particles_per_group, friction_of(record.object, shape)
    )
    answer = MassDistribution(arrays["mass"], arrays["friction"]) if "mass" in arrays else None
    support = support_name(row["support"])
    return EstimateView(
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


def fits_of(folder: Path, row: Row, shown: EstimateView) -> list[tuple[str, Trajectory, WrenchFit]]:
    """The moved trials behind an estimate in order: key, record as sensed, and how the answer explains it."""
    keys = tuple(row["trial_keys"])
    drawn = zip(keys, sensed(Store(folder), keys, row["sensing"], int(row["seed"])), strict=True)
    moved = [(key, trajectory) for key, trajectory in drawn if trajectory.action.moves]
    predicted: list[Any] = [None] * len(moved)
    if shown.answer is not None:
        predicted = list(predicted_wrenches(shown.shape, shown.answer, [trajectory for _, trajectory in moved]))
    fits = [
        wrench_fit(f"{i + 1}: {trajectory.action.describe(shown.shape)}", trajectory, wrench)
        for i, ((_, trajectory), wrench) in enumerate(zip(moved, predicted, strict=True))
    ]
    return [(key, trajectory, fit) for (key, trajectory), fit in zip(moved, fits, strict=True)]


def settings_of(rows: Sequence[Row]) -> list[tuple[str, list[Row]]]:
    """What one object was asked under, in words, and its first draw by every method: a comparison each."""
    axes = axes_of(rows)
    groups: dict[tuple[Any, ...], list[Row]] = {}
    for row in rows:
        if row.get("key") and row.get("trial_keys") is not None:
            groups.setdefault((row["support"], row["sensing"], *(row.get(axis) for axis in axes)), []).append(row)
    named = []
    for (support, sensing, *values), found in groups.items():
        swept = [f"{axis.removeprefix(AXIS)} {value}" for axis, value in zip(axes, values, strict=True)]
        first = select(found, seed=min(row["seed"] for row in found))
        named.append((", ".join([support_name(support), str(sensing), *swept]), first))
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


@lru_cache(maxsize=4)
def _record(folder: Path, key: str) -> TrialRecord:
    """The methods of an object are shown one after the other, with the same trial."""
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
