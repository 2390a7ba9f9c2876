"""Answers as tables and plain data: masses with intervals, their sum and center, the misfit, the support's verdict."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.objects.model import MassDistribution, ObjectShape
from viz.report.tables import Entry, Table
from viz.values import DEVIATIONS, LEVEL, support_name


class Quantity(NamedTuple):
    """A number of an answer."""

    name: str
    unit: str
    value: float
    error: float
    """Standard error: infinite where the quantity is not observed, NaN where the method gives none."""

    @property
    def interval(self) -> tuple[float, float]:
        """Lower and upper end of the 90 % interval; that of a mass begins at 0 or above."""
        half = DEVIATIONS * self.error
        return max(self.value - half, 0.0) if self.unit == "kg" else self.value - half, self.value + half

    @property
    def ends(self) -> tuple[float | None, float | None]:
        """Ends of the interval as plain data; None where the error is unknown or infinite."""
        low, high = self.interval
        return (low, high) if math.isfinite(self.error) else (None, None)

    def words(self) -> str:
        """Value and interval as text, lengths in mm."""
        scale, digits = (1e3, 1) if self.unit == "m" else (1.0, 3)
        if math.isinf(self.error):
            return "not observed"
        text = f"{scale * self.value:.{digits}f}"
        if math.isnan(self.error):
            return text
        low, high = (f"{scale * end:.{digits}f}" for end in self.interval)
        return f"{text} [{low} {high}]"


@dataclass(frozen=True, eq=False)
class Answer:
    """Answer of one method on one object."""

    object: str
    support: str
    """Support of the object's weight, as stated by the operator."""
    method: str
    status: str
    message: str
    shape: ObjectShape
    distribution: MassDistribution | None
    """Masses and frictions; None without an answer."""
    covariance: Float[np.ndarray, "n_m n_m"] | None
    """Covariance of the particle masses [kg^2]."""
    misfit: float
    """Mean squared residual in standard errors; NaN where the method gives none."""
    verdict: str
    """Verdict of the trials on the support, in one to three words."""
    evidence: str
    """Verdict in a sentence; empty where the support was not tested."""

    @property
    def quantities(self) -> list[Quantity]:
        """Mass of each group, their sum, and their center of mass; empty without an answer."""
        if self.distribution is None:
            return []
        shape, mass, count = self.shape, self.distribution.mass, self.shape.particles_per_group
        total = float(mass @ count)
        moments = shape.per_group(shape.particles.T)
        center = moments @ mass / total
        rows = np.vstack([np.diag(count), count, (moments - np.outer(center, count)) / total])
        values = [*(mass * count), total, *center]
        names = [*((name, "kg") for name in shape.group_names), ("total", "kg"), ("center x", "m"), ("center y", "m")]
        errors = [self._error(row) for row in rows]
        return [Quantity(*name, float(v), e) for name, v, e in zip(names, values, errors, strict=True)]

    def _error(self, row: np.ndarray) -> float:
        """Standard error of the linear combination `row`, (n_m,), of the particle masses."""
        if self.covariance is None:
            return math.nan
        known = np.isfinite(self.covariance)
        unknown = ~known.diagonal() & (row != 0)
        if unknown.any():
            return math.inf
        return math.sqrt(max(float(row @ np.where(known, self.covariance, 0.0) @ row), 0.0))


def answer_table(answers: Sequence[Answer]) -> Table:
    """Table of one object: quantities down, methods across."""
    first = answers[0]
    title = f"{first.object}, {support_name(first.support)}: masses in kg, center in mm [{LEVEL} interval]"
    by_method = [{q.name: q.words() for q in answer.quantities} for answer in answers]
    names = next((list(found) for found in by_method if found), [])
    rows = [((name,), tuple(Entry(found.get(name, "-")) for found in by_method)) for name in names]
    for label, cells in (
        ("friction", [_frictions(answer) for answer in answers]),
        ("misfit", ["-" if math.isnan(answer.misfit) else f"{answer.misfit:.2g}" for answer in answers]),
        ("support", [answer.verdict for answer in answers]),
        ("status", [answer.status for answer in answers]),
    ):
        rows.append(((label,), tuple(map(Entry, cells))))
    note = "misfit: mean squared residual in standard errors; about 1 if the model holds"
    return Table(title, tuple(answer.method for answer in answers), tuple(rows), ("",), note)


def _frictions(answer: Answer) -> str:
    return "-" if answer.distribution is None else " ".join(f"{mu:.2f}" for mu in answer.distribution.friction)


def answer_rows(answers: Sequence[Answer]) -> list[dict[str, Any]]:
    """One row per quantity: object, support, method, status, name, unit, value, and the ends of its interval."""
    labels = ("object", "support", "method", "status")
    return [
        {
            **{label: getattr(answer, label) for label in labels},
            "quantity": quantity.name,
            "unit": quantity.unit,
            "value": quantity.value,
            "low": quantity.ends[0],
            "high": quantity.ends[1],
        }
        for answer in answers
        for quantity in answer.quantities
    ]


def answer_fields(answer: Answer) -> dict[str, Any]:
    """Fields of an answer as plain data; unknown numbers are None."""
    numbers = [(q, *q.ends) for q in answer.quantities]
    return {
        "object": answer.object,
        "support": answer.support,
        "method": answer.method,
        "status": answer.status,
        "message": answer.message,
        "quantities": {q.name: {"unit": q.unit, "value": q.value, "low": a, "high": b} for q, a, b in numbers},
        "interval": LEVEL,
        "friction": None if answer.distribution is None else answer.distribution.friction.tolist(),
        "misfit": None if math.isnan(answer.misfit) else answer.misfit,
        "support_verdict": answer.verdict,
        "support_evidence": answer.evidence,
    }
