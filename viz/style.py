"""Colors, fonts and color scales of figures, the report and the Rerun views.

Single colors are Okabe and Ito's, which color-blind readers can tell apart; color maps are monotonic in lightness, so
that they also read in a gray print.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.ticker import FuncFormatter, NullFormatter

from testbed.objects.model import ObjectShape
from viz.values import EstimateView

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
)  # fmt: skip
PALETTE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
MARKERS = "osD^vPX"
DASHES = ("-", "--", ":", "-.")

MASS_COLORS = "viridis"
"""Color map of mass; large masses are bright."""
DIFFERENCE_COLORS = "cividis_r"
"""Color map of absolute differences; large differences are dark."""
LINK_COLORS, MOST_LINK_COLORS = "Pastel1", 9.0
"""Color map of the links of an object, light under the arrows, and the number of its colors."""
TOP = 95
"""Percentile of many answers at which a scale ends, so that an outlier does not compress the scale."""
LEAST_DIFFERENCE = 0.02
"""Least end of the scale of differences, relative to the heaviest group, so that noise stays light."""
MOST_NAMED = 30
"""Largest number of groups that have room for names or numbers."""

PLAN_ERROR = "expected standard error, g"
"""Title of the scale of a plan's errors."""
TRUTH, ESTIMATE = "#B4B4B4", BLUE
AXIS_COLORS = (VERMILLION, GREEN, BLUE)
"""Colors of x, y and z of a force or a torque."""
NORMAL_FORCE, FRICTION_FORCE = SKY, VERMILLION
"""Colors of the arrows at the feet."""
VELOCITY, OBJECT_VELOCITY, PADS = BLUE, BLACK, PURPLE
"""Colors of the particles' and the object's arrows and of the gripper's pads, as in the paper's Fig. trajectory."""
PUSH = VERMILLION
"""Color of a push's contact and direction in a scene."""
PHASE_COLORS = ("#8C8C8C", "#BFBFBF", ORANGE, SKY, PURPLE, GREEN, "#BFBFBF")
"""Colors of the phases of a trial, in the order of `Phase`."""
BACKGROUND = "#FAFAF8"
"""Background of the planar views: as light as paper, so that color maps read as in the figures."""
EDGE = "#505050"
"""Color of outlines and axes."""
LIGHT = 175.0
"""Luminance, 0 to 255, above which text on a color is black; Rerun's frame around a text darkens its background."""
NO_ANSWER = "#DCDCDA"
"""Color of cells without a value."""

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "heft",
    "text.parse_math": False,
    "path.simplify": True,
}
"""matplotlib's settings for a figure: text as text, "$" as a plain character, and files that are reproducible."""


def bare(axis: Axes) -> None:
    """Draw a light grid, and no frame above and to the right."""
    axis.grid(color="0.88", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def plain_numbers(axis: Axis) -> None:
    """Label the major ticks of a logarithmic axis with plain numbers, and no minor tick."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a matplotlib color: a name or #RRGGBB."""
    red, green, blue = (round(255 * part) for part in to_rgb(color))
    return red, green, blue


def series_color(index: int) -> str:
    """Color of the `index`-th of many series: the palette without black, then the same colors lighter."""
    base = PALETTE[:-1]
    white = 0.5 * ((index // len(base)) % 2)
    mixed = [(1 - white) * value + white for value in to_rgb(base[index % len(base)])]
    return "#" + "".join(f"{round(255 * value):02X}" for value in mixed)


def action_colors(count: int) -> Float[np.ndarray, "T 4"]:
    """Colors of the actions of a plan in their order, RGBA from 0 to 1."""
    return mpl.colormaps["viridis"](np.linspace(0.0, 0.85, max(count, 1)))


def mapped(values: Float[np.ndarray, "..."], top: float, colors: str) -> UInt8[np.ndarray, "... 3"]:
    """Colors, 0 to 255, of values from 0 to `top`; values above have the color of `top`, NaN has NO_ANSWER."""
    values = np.asarray(values, dtype=float)
    colored = np.round(255 * mpl.colormaps[colors](np.clip(values / top, 0, 1))[..., :3]).astype(np.uint8)
    colored[np.isnan(values)] = rgb(NO_ANSWER)
    return colored


def text_color(background: UInt8[np.ndarray, "... 3"]) -> UInt8[np.ndarray, "... 3"]:
    """Color of a text on a background, 0 to 255: black or white, by the luminance of the background."""
    light = np.asarray(background) @ np.array([0.299, 0.587, 0.114]) > LIGHT
    return np.where(light[..., None], np.uint8(0), np.uint8(255)) * np.ones(3, dtype=np.uint8)


@dataclass(frozen=True)
class Scale:
    """A color scale from 0 to `top`; larger values have the color of `top`."""

    top: float
    """End of the scale."""
    colors: str
    """Name of the color map."""
    title: str
    """Quantity and unit."""
    open: bool = False
    """True if there are values above `top`."""

    @property
    def digits(self) -> int:
        """Decimal places that show two significant digits of `top`, 2 to 4."""
        return int(np.clip(1 - np.floor(np.log10(self.top)), 2, 4))

    def color(self, values: Float[np.ndarray, "..."]) -> UInt8[np.ndarray, "... 3"]:
        """Colors of values, 0 to 255."""
        return mapped(values, self.top, self.colors)


def mass_scale(views: Sequence[EstimateView], top: float | None = None) -> Scale:
    """One scale for the true and all estimated masses; by default up to the largest of them."""
    masses = [m for view in views for m in (view.true_mass, view.mass) if m is not None]
    iterates = [view.iterates[1] for view in views if view.iterates is not None]
    return _scale(masses, iterates, top, 0.0, MASS_COLORS, "mass, kg per group")


def difference_scale(views: Sequence[EstimateView], top: float | None = None) -> Scale:
    """One scale for all absolute differences; by default up to the largest of the answers."""
    known = [(view, view.true_mass) for view in views if view.true_mass is not None]
    differences = [view.difference for view, _ in known if view.difference is not None]
    iterates = [np.abs(view.iterates[1] - truth) for view, truth in known if view.iterates is not None]
    least = LEAST_DIFFERENCE * max((float(truth.max()) for _, truth in known), default=0.0)
    return _scale(differences, iterates, top, least, DIFFERENCE_COLORS, "|difference|, kg per group")


def _scale(
    finals: Sequence[np.ndarray],
    iterates: Sequence[np.ndarray],
    top: float | None,
    least: float,
    colors: str,
    title: str,
) -> Scale:
    """Scale up to `top`, or to the largest of `finals`, at least up to `least`; open where any value is larger."""
    largest = max((float(values.max()) for values in finals), default=1.0)
    end = max(largest if top is None else top, least, 1e-6)
    exceeds = any(float(values.max()) > end * (1 + 1e-9) for values in (*finals, *iterates))
    return Scale(end, colors, title, open=exceeds)


def top_of(values: Sequence[np.ndarray]) -> float:
    """End of a scale of many answers: the percentile TOP of their values; 0 without any."""
    return float(np.percentile(np.concatenate(values), TOP)) if values else 0.0


def group_middles(shape: ObjectShape) -> Float[np.ndarray, "n_m 2"]:
    """Mean position of each group's particles [m], where its label is drawn."""
    return np.array([shape.particles[shape.mass_group == group].mean(axis=0) for group in range(shape.n_m)])


def narrowest_group(shape: ObjectShape) -> float:
    """Width of the narrowest group [m]."""
    return shape.cell + min(float(np.ptp(shape.particles[shape.mass_group == g, 0])) for g in range(shape.n_m))


def aspect(shape: ObjectShape, least: float, most: float) -> float:
    """Height over width of the object, within limits."""
    width, height = np.ptp(shape.particles, axis=0) + shape.cell
    return float(np.clip(height / width, least, most))
