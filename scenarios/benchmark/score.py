"""Scores of answers to the benchmark: accuracy, honesty of the error bars, and robot time, by world and kind."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from estimators.evaluation.metrics import normalized_absolute_difference
from estimators.evaluation.statistics import NINETY, Claims
from scenarios.benchmark.answers import Answer
from scenarios.benchmark.dataset import Benchmark, Problem, Truth, truth_of
from testbed.errors import InvalidValueError
from testbed.files import read_file
from testbed.objects.model import MassDistribution, ObjectModel, ObjectShape

ALPHA = 0.1
"""Part of the truths that the intervals of the score should miss."""
MISSING = "missing"
"""Status of a problem without an answer."""


@dataclass(frozen=True, eq=False)
class Moments:
    """Center of mass and inertia of an object as functions of the masses of its groups."""

    center: Float[np.ndarray, "n_m 2"]
    """Center of mass of each group [m], object frame."""
    spread: Float[np.ndarray, "n_m"]
    """Inertia of each group about its center of mass, vertical axis, over its mass [m^2]."""

    @staticmethod
    def of(model: ObjectModel) -> Moments:
        """Moments of an object, whose own masses do not count."""
        if model.solids:
            solids = model.solids
            return Moments(
                np.array([solid.center_of_mass[:2] for solid in solids]),
                np.array([solid.inertia_z / solid.mass for solid in solids]),
            )
        shape = model.shape
        center = np.array([shape.middle_of(group) for group in range(shape.n_m)])
        square = ((shape.particles - center[shape.mass_group]) ** 2).sum(axis=1) + shape.cell**2 / 6
        return Moments(center, shape.per_group(square) / shape.per_group(np.ones(len(square))))

    def at(self, mass: Float[np.ndarray, "n_m"]) -> tuple[Float[np.ndarray, "2"], float]:
        """Center of mass [m] and inertia about it [kg m^2] at masses of the groups [kg]."""
        middle = mass @ self.center / mass.sum()
        return middle, float(mass @ (self.spread + ((self.center - middle) ** 2).sum(axis=1)))


def interval_score(
    mass: Float[np.ndarray, "n"], error: Float[np.ndarray, "n"], truth: Float[np.ndarray, "n"], most: float
) -> Float[np.ndarray, "n"]:
    """Interval score of the central 90 % intervals of normal errors (Gneiting and Raftery 2007) [kg]; less is better.

    Width, and 2 / alpha times the distance of a truth outside.

    Args:
        mass: masses [kg].
        error: their standard errors [kg], infinite where not known.
        truth: true masses [kg].
        most: mass of the object as weighed [kg]; intervals end there and at 0.
    """
    low = np.clip(mass - NINETY * error, 0, most)
    high = np.clip(mass + NINETY * error, 0, most)
    outside = np.maximum(low - truth, 0) + np.maximum(truth - high, 0)
    return high - low + 2 / ALPHA * outside


def even_masses(shape: ObjectShape, weight: float) -> Float[np.ndarray, "n_m"]:
    """Masses of groups [kg] of an object of one area density, as weighed."""
    cells = np.array([len(shape.cells_of(group)) for group in range(shape.n_m)])
    return weight * cells / cells.sum()


def judged_row(problem: Problem, model: ObjectModel, truth: Truth, answer: Answer | None) -> dict[str, Any]:
    """Row of one problem: the answer held against the truth. A missing one counts as even masses."""
    shape, true = model.shape, np.array(truth.mass_kg)
    mass, error, answered = even_masses(shape, problem.weight_kg), None, False
    if answer is not None and answer.mass_kg is not None and sum(answer.mass_kg) > 0:
        mass, answered = np.array(answer.mass_kg), True
        error = None if answer.error_kg is None else np.array(answer.error_kg)
    (c, inertia), (true_c, true_inertia) = (Moments.of(model).at(m) for m in (mass, true))
    count, friction = shape.particles_per_group, np.array(truth.friction)
    nad = normalized_absolute_difference(
        shape, MassDistribution(mass / count, friction), MassDistribution(true / count, friction)
    )
    sharp = None if error is None else interval_score(mass, error, true, problem.weight_kg) / true.sum()
    return {
        "problem": problem.problem,
        "split": problem.split,
        "world": problem.world,
        "kind": problem.kind,
        "status": MISSING if answer is None else answer.status,
        "answered": answered,
        "nad": nad,
        "com_error_m": float(np.linalg.norm(c - true_c)),
        "inertia_error": inertia / true_inertia - 1,
        "mass_kg": mass.tolist(),
        "mass_error_kg": None if error is None else error.tolist(),
        "true_mass_kg": true.tolist(),
        "interval_score": math.nan if sharp is None else float(sharp.mean()),
        "robot_s": problem.robot_s,
    }


def figures(rows: Sequence[Mapping[str, Any]]) -> dict[str, float]:
    """Figures of some rows of `judged_row`; NaN where nothing is claimed.

    Returns:
        problems, missing (without a row in the file), answered (share with masses and status ok), nad (mean),
        nad_median, com_error_m (median), inertia_error (median of its size), held (share of the 90 % intervals),
        interval_score (mean over the object's mass), silent (share of answers that claim errors), robot_s (mean).
    """
    claims = Claims.of(rows)
    values = {name: np.array([row[name] for row in rows], dtype=float) for name in
              ("nad", "com_error_m", "inertia_error", "interval_score", "robot_s")}  # fmt: skip
    scored = values["interval_score"][~np.isnan(values["interval_score"])]
    return {
        "problems": len(rows),
        "missing": sum(row["status"] == MISSING for row in rows),
        "answered": float(np.mean([row["answered"] and row["status"] == "ok" for row in rows])),
        "nad": float(values["nad"].mean()),
        "nad_median": float(np.median(values["nad"])),
        "com_error_m": float(np.median(values["com_error_m"])),
        "inertia_error": float(np.median(np.abs(values["inertia_error"]))),
        "held": claims.held if claims else math.nan,
        "interval_score": float(scored.mean()) if len(scored) else math.nan,
        "silent": claims.silent if claims else math.nan,
        "robot_s": float(values["robot_s"].mean()),
    }


def truths(benchmark: Benchmark, file: Path | None) -> dict[str, Truth]:
    """Truth of train and validation, and of test where its file is given.

    Raises:
        InvalidValueError: a file that is not the one whose SHA-256 the benchmark states.
    """
    if file is None:
        return benchmark.truth
    data, stated = read_file(file), benchmark.facts["truth_sha256"]
    if (digest := hashlib.sha256(data).hexdigest()) != stated:
        raise InvalidValueError("--truth", f"{file} of SHA-256 {digest[:16]}...", f"the file of SHA-256 {stated}")
    return benchmark.truth | {row["problem"]: truth_of(row) for row in json.loads(data)["problems"]}


def score(
    benchmark: Benchmark, answers: Mapping[str, Answer], truth: Mapping[str, Truth], split: str
) -> list[dict[str, Any]]:
    """Rows of all problems of a split.

    Raises:
        InvalidValueError: a split whose truth is not known.
    """
    problems = benchmark.of_split(split)
    if any(each.problem not in truth for each in problems):
        raise InvalidValueError("--truth", None, f"the truth file of split {split}, which is not published")
    return [
        judged_row(each, each.model(benchmark.folder), truth[each.problem], answers.get(each.problem))
        for each in problems
    ]
