"""Views of an estimate: its masses, its iterations, and how it explains each trial."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from estimators.evaluation.statistics import AXIS, Row, axes_of, select
from estimators.particles.wrench import predicted_wrenches
from scenarios.results.estimates import load_arrays, load_estimate
from scenarios.results.store import Store
from scenarios.results.trials import TrialRecord, kind_of_trial, read_trial, sensed_trials
from scenarios.views.trial import wrench_fit
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape
from testbed.trajectory import Trajectory
from viz.values import EstimateView, WrenchFit, support_name


def estimate_view(folder: Path, row: Row) -> EstimateView:
    """View of an estimate by its row.

    Raises:
        HeftError: a file of it is damaged.
    """
    answer, record = load_estimate(folder, row["key"]), typical_trial(folder, row)
    shape = _shape(folder, row, record.object)
    truth = MassDistribution(
        np.array(row["true_mass_kg"]) / shape.particles_per_group, friction_of(record.object, shape)
    )
    support = support_name(row["support"])
    return EstimateView(
        title=f"{row['object']}, {support}, {row['sensing']}: {row['method']}",
        shape=shape,
        truth=truth,
        answer=answer.distribution,
        covariance=answer.covariance,
        traces=answer.traces,
        trajectory=record.trajectory,
        facts=_facts(row),
    )


def _shape(folder: Path, row: Row, true: ObjectModel) -> ObjectShape:
    """Shape as the estimator saw it, with the particles of its own grid."""
    arrays = load_arrays(folder, row["key"])
    return ObjectShape(
        arrays["particles"],
        arrays["mass_group"],
        arrays["friction_group"],
        float(arrays["cell"]),
        true.shape.height,
        true.shape.grasps,
        tuple(row["group_names"]),
        arrays["fill"],
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
    drawn = zip(keys, sensed_trials(Store(folder), keys, row["sensing"], int(row["seed"])), strict=True)
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
    """Comparisons of one object: the setting in words, and the first draw by every method."""
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
    keys = row["trial_keys"]
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
