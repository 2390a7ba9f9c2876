"""Colour scales and proportions of mass maps, the same in figures and in recordings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.cm import ScalarMappable
from matplotlib.colors import Normalize

from testbed.objects.model import ObjectShape
from viz.style import DIFFERENCE_COLORS, MASS_COLORS, mapped
from viz.values import EstimateView

LEAST_DIFFERENCE = 0.02
"""Least end of the scale of differences, over the heaviest group: noise is not blown up."""
MOST_NAMED = 30
"""Largest number of groups that have room for names or numbers."""


@dataclass(frozen=True)
class Scale:
    """A colour scale from 0 to `top`; larger values have the colour of `top`."""

    top: float
    """End of the scale."""
    colors: str
    """Name of the colour map."""
    title: str
    """Quantity and unit."""
    open: bool = False
    """True if there are values above `top`."""

    @property
    def digits(self) -> int:
        """Digits after the point: two that count."""
        return int(np.clip(1 - np.floor(np.log10(self.top)), 2, 4))

    @property
    def mappable(self) -> ScalarMappable:
        """The scale for matplotlib."""
        return ScalarMappable(Normalize(0.0, self.top), self.colors)

    def color(self, values: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "... 3"]:
        """Colours of values, 0 to 255."""
        return mapped(values, self.top, self.colors)


def mass_scale(views: Sequence[EstimateView], top: float | None = None) -> Scale:
    """One scale for the true and all estimated masses; by default up to the largest of them."""
    masses = [m for view in views for m in (view.true_mass, view.mass) if m is not None]
    ways = [view.iterates[1] for view in views if view.iterates is not None]
    return _scale(masses, ways, top, 0.0, MASS_COLORS, "mass, kg a group")


def difference_scale(views: Sequence[EstimateView], top: float | None = None) -> Scale:
    """One scale for all absolute differences; by default up to the largest of the answers."""
    known = [(view, view.true_mass) for view in views if view.true_mass is not None]
    off = [view.difference for view, _ in known if view.difference is not None]
    ways = [np.abs(view.iterates[1] - truth) for view, truth in known if view.iterates is not None]
    least = LEAST_DIFFERENCE * max((float(truth.max()) for _, truth in known), default=0.0)
    return _scale(off, ways, top, least, DIFFERENCE_COLORS, "|difference|, kg a group")


def _scale(
    ends: Sequence[np.ndarray], ways: Sequence[np.ndarray], top: float | None, least: float, colors: str, title: str
) -> Scale:
    """Scale up to `top`, or to the largest of `ends`; open where an end or an iterate is larger."""
    largest = max((float(values.max()) for values in ends), default=1.0)
    end = max(largest if top is None else top, least, 1e-6)
    return Scale(end, colors, title, open=any(float(values.max()) > end * (1 + 1e-9) for values in (*ends, *ways)))


def group_middles(shape: ObjectShape) -> Float[np.ndarray, "n_m 2"]:
    """Mean position of each group's particles [m]: the place of its label."""
    return np.array([shape.particles[shape.mass_group == group].mean(axis=0) for group in range(shape.n_m)])


def narrowest_group(shape: ObjectShape) -> float:
    """Width of the narrowest group [m]."""
    return shape.cell + min(float(np.ptp(shape.particles[shape.mass_group == g, 0])) for g in range(shape.n_m))


def aspect(shape: ObjectShape, least: float, most: float) -> float:
    """Height over width of the object, within limits."""
    width, height = np.ptp(shape.particles, axis=0) + shape.cell
    return float(np.clip(height / width, least, most))
