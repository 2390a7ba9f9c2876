"""Scores of answers to the benchmark: accuracy, honesty of the error bars, and robot time, by world and kind."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
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
"""Nominal fraction of the truths outside the intervals of the score."""
MISSING = "missing"
"""Status of a problem without an answer."""


def with_masses(model: ObjectModel, mass: Float[np.ndarray, "n_m"], friction: Float[np.ndarray, "n_mu"]) -> ObjectModel:
    """Object with other masses of its groups [kg] and other frictions; a body has at least a billionth of the mass."""
    mass = np.maximum(mass, 1e-9 * mass.sum())
    solids = tuple(replace(solid, mass=float(own)) for solid, own in zip(model.solids, mass, strict=False))
    truth = MassDistribution(mass / model.shape.particles_per_group, friction)
    return replace(model, truth=truth, solids=solids)


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
    """Row of one problem: the answer compared with the truth. A missing answer counts as even masses."""
    true = np.array(truth.mass_kg)
    mass, error, answered = even_masses(model.shape, problem.weight_kg), None, False
    if answer is not None and answer.mass_kg is not None and sum(answer.mass_kg) > 0:
        mass, answered = np.array(answer.mass_kg), True
        error = None if answer.error_kg is None else np.array(answer.error_kg)
    at, exact = (with_masses(model, each, np.array(truth.friction)) for each in (mass, true))
    sharp = None if error is None else interval_score(mass, error, true, problem.weight_kg) / true.sum()
    return {
        "problem": problem.problem,
        "split": problem.split,
        "world": problem.world,
        "kind": problem.kind,
        "status": MISSING if answer is None else answer.status,
        "answered": answered,
        "nad": normalized_absolute_difference(model.shape, at.truth, exact.truth),
        "com_error_m": float(np.linalg.norm(at.center_of_mass - exact.center_of_mass)),
        "inertia_error": at.inertia_cm / exact.inertia_cm - 1,
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
