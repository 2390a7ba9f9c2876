"""One estimate as it is shown: the answer with the truth, and all that is known of how it came about."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float

from estimators.protocol import Trace
from testbed.arrays import frozen_array
from testbed.errors import InvalidValueError
from testbed.objects import MassDistribution, ObjectShape
from testbed.trajectory import Trajectory
from viz.cell_map import Scale
from viz.frames import ITERATION, MOST_FRAMES, Frames, evenly
from viz.style import DIFFERENCE_COLORS, MASS_COLORS

LEVEL, DEVIATIONS = "90 %", 1.645
"""Probability of an interval, and its half width in standard deviations."""
LEAST_DIFFERENCE = 0.02
"""Least end of the scale of differences, over the heaviest group: noise is not blown up."""


@dataclass(frozen=True, eq=False)
class EstimateShown:
    """An estimate with all that is known about it."""

    title: str
    """What is shown: object, method, sensing."""
    shape: ObjectShape
    """Of the object."""
    truth: MassDistribution | None = None
    """None on a real object."""
    answer: MassDistribution | None = None
    """None where the method has none."""
    covariance: Float[np.ndarray, "n_m n_m"] | None = None
    """Of the particle masses, kg^2."""
    traces: tuple[Trace, ...] = ()
    """The one that led to the answer first."""
    trajectory: Trajectory | None = None
    """A trial to show the particles' velocities in."""
    facts: Mapping[str, str] = field(default_factory=dict)
    """What else is said in words; "method" names it in a comparison."""

    def __post_init__(self) -> None:
        shape = self.shape
        for name, given in (("truth", self.truth), ("answer", self.answer)):
            for what, count in (("mass", shape.n_m), ("friction", shape.n_mu)) if given is not None else ():
                values = getattr(given, what)
                if len(values) != count:
                    raise InvalidValueError(
                        f"EstimateShown.{name}.{what}", values.tolist(), f"{count} numbers, one a group"
                    )
        if self.covariance is not None:
            square = (shape.n_m, shape.n_m)
            checked = frozen_array("EstimateShown.covariance", self.covariance, square, finite=False)
            object.__setattr__(self, "covariance", checked)
        for trace in self.traces:
            if trace.mass.size and trace.mass.shape != (len(trace.loss), shape.n_m):
                allowed = f"({len(trace.loss)}, {shape.n_m}), or none"
                raise InvalidValueError(f"EstimateShown.traces.{trace.method}.mass", trace.mass.shape, allowed)
        object.__setattr__(self, "traces", tuple(self.traces))

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.facts.get("method", self.title)

    @property
    def true_mass(self) -> Float[np.ndarray, "n_m"] | None:
        """kg a group."""
        return None if self.truth is None else self.truth.mass * self.shape.particles_per_group

    @property
    def mass(self) -> Float[np.ndarray, "n_m"] | None:
        """The answer, kg a group."""
        return None if self.answer is None else self.answer.mass * self.shape.particles_per_group

    @property
    def difference(self) -> Float[np.ndarray, "n_m"] | None:
        """|answer - truth|, kg a group."""
        mass, truth = self.mass, self.true_mass
        return None if mass is None or truth is None else np.abs(mass - truth)

    @property
    def nad(self) -> float | None:
        """The paper's eta_1: what is misplaced, over the whole mass."""
        off, truth = self.difference, self.true_mass
        return None if off is None or truth is None else float(off.sum() / truth.sum())

    @property
    def half_width(self) -> Float[np.ndarray, "n_m"] | None:
        """Half of the interval of each group's mass, kg; NaN where the variance is none or infinite."""
        if self.covariance is None:
            return None
        variance = np.diagonal(self.covariance)
        deviation = np.sqrt(np.where((variance >= 0) & np.isfinite(variance), variance, np.nan))
        return DEVIATIONS * deviation * self.shape.particles_per_group

    @property
    def history(self) -> tuple[Frames, Float[np.ndarray, "F n_m"]] | None:
        """The masses on the way of the trace that led to the answer, kg a group, and the answer itself at the end."""
        mass = self.mass
        if mass is None:
            return None
        if not self.traces or not self.traces[0].mass.size:
            return Frames.still(), mass[None]
        way = self.traces[0].mass * self.shape.particles_per_group
        kept = evenly(len(way), MOST_FRAMES - 1)
        frames = Frames(ITERATION, np.append(kept, len(way)).astype(float), len(kept))
        return frames, np.vstack([way[kept], mass])


def mass_scale_of(every: Sequence[EstimateShown], top: float | None = None) -> Scale:
    """One scale for the true and all estimated masses; by default up to the largest of them."""
    masses = [m for shown in every for m in (shown.true_mass, shown.mass) if m is not None]
    ways = [shown.history[1] for shown in every if shown.history is not None]
    return _scale(masses, ways, top, 0.0, MASS_COLORS, "mass, kg a group")


def difference_scale_of(every: Sequence[EstimateShown], top: float | None = None) -> Scale:
    """One scale for all absolute differences; by default up to the largest of the answers."""
    known = [(shown, shown.true_mass) for shown in every if shown.true_mass is not None]
    off = [shown.difference for shown, _ in known if shown.difference is not None]
    ways = [np.abs(shown.history[1] - truth) for shown, truth in known if shown.history is not None]
    least = LEAST_DIFFERENCE * max((float(truth.max()) for _, truth in known), default=0.0)
    return _scale(off, ways, top, least, DIFFERENCE_COLORS, "|difference|, kg a group")


def _scale(
    ends: Sequence[np.ndarray], ways: Sequence[np.ndarray], top: float | None, least: float, colors: str, title: str
) -> Scale:
    """Up to `top`, or to the largest of `ends`; open where an end or something on the way to it is larger."""
    largest = max((float(values.max()) for values in ends), default=1.0)
    end = max(largest if top is None else top, least, 1e-6)
    return Scale(end, colors, title, open=any(float(values.max()) > end * (1 + 1e-9) for values in (*ends, *ways)))
