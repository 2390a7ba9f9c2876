"""Colours, marks and fonts of figures, the report and the Rerun views.

Single colours are Okabe and Ito's, told apart by the colour-blind; colour maps are even in lightness, so that they also
survive a grey print.
"""

from __future__ import annotations

from typing import Any

import matplotlib as mpl
import numpy as np
from jaxtyping import Float, UInt8
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.colors import to_rgb
from matplotlib.ticker import FuncFormatter, NullFormatter

BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK = (
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000",
)  # fmt: skip
PALETTE = (BLUE, VERMILLION, GREEN, PURPLE, ORANGE, SKY, BLACK)
MARKERS = "osD^vPX"
DASHES = ("-", "--", ":", "-.")

MASS_COLORS = "viridis"
"""Colour map of mass; bright is heavy."""
DIFFERENCE_COLORS = "cividis_r"
"""Colour map of absolute differences; dark is wrong."""
TOP = 95
"""Percentile of many answers at which a scale ends: one lost method must not bleach the rest."""

TRUTH, ESTIMATE = "#B4B4B4", BLUE
AXIS_COLORS = (VERMILLION, GREEN, BLUE)
"""Colours of x, y and z of a force or a torque."""
NORMAL_FORCE, FRICTION_FORCE = SKY, VERMILLION
"""Colours of the arrows at the feet."""
VELOCITY, OBJECT_VELOCITY, PADS = BLUE, BLACK, PURPLE
"""Colours of the particles' and the object's arrows and of the gripper's pads, as in the paper's Fig. trajectory."""
PHASE_COLORS = ("#8C8C8C", "#BFBFBF", ORANGE, SKY, PURPLE, GREEN, "#BFBFBF")
"""Colours of the phases of a trial, in the order of `Phase`."""
BACKGROUND = "#FAFAF8"
"""Background of the planar views: as light as paper, so that colour maps read as in the figures."""
EDGE = "#505050"
"""Colour of outlines and axes."""
LIGHT = 175.0
"""Luminance, 0 to 255, above which text on a colour is black; Rerun's frame around a text darkens its background."""
NO_ANSWER = "#DCDCDA"
"""Colour of cells without a value."""

STYLE: dict[Any, Any] = {
    "font.size": 9.0,
    "pdf.fonttype": 42,
    "svg.fonttype": "none",
    "svg.hashsalt": "heft",
    "text.parse_math": False,
    "path.simplify": True,
}
"""matplotlib's settings for a figure: text stays text, a $ too, and the same figure is the same file."""


def bare(axis: Axes) -> None:
    """Draw a light grid, and no frame above and to the right."""
    axis.grid(color="0.88", linewidth=0.6)
    axis.set_axisbelow(True)
    for side in ("top", "right"):
        axis.spines[side].set_visible(False)


def plain_numbers(axis: Axis) -> None:
    """Write plain numbers on a logarithmic axis, and none at its small marks."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def rgb(color: str) -> tuple[int, int, int]:
    """Red, green and blue, 0 to 255, of a colour's name or #RRGGBB."""
    red, green, blue = (round(255 * part) for part in to_rgb(color))
    return red, green, blue


def series_color(index: int) -> str:
    """Colour of the `index`-th of many series: the palette without black, then the same colours lighter."""
    base = PALETTE[:-1]
    part = 0.5 * ((index // len(base)) % 2)
    mixed = [(1 - part) * value + part for value in to_rgb(base[index % len(base)])]
    return "#" + "".join(f"{round(255 * value):02X}" for value in mixed)


def action_colors(count: int) -> Float[np.ndarray, "T 4"]:
    """Colours of the actions of a plan in their order, RGBA from 0 to 1."""
    return mpl.colormaps["viridis"](np.linspace(0.0, 0.85, max(count, 1)))


def mapped(values: Float[np.ndarray, "..."], top: float, colors: str) -> UInt8[np.ndarray, "... 3"]:
    """Colours, 0 to 255, of values from 0 to `top`; values above have the colour of `top`, NaN has NO_ANSWER."""
    values = np.asarray(values, dtype=float)
    colored = np.round(255 * mpl.colormaps[colors](np.clip(values / top, 0, 1))[..., :3]).astype(np.uint8)
    colored[np.isnan(values)] = rgb(NO_ANSWER)
    return colored


def text_color(behind: UInt8[np.ndarray, "... 3"]) -> UInt8[np.ndarray, "... 3"]:
    """Black or white, whichever reads better on a colour."""
    light = np.asarray(behind) @ np.array([0.299, 0.587, 0.114]) > LIGHT
    return np.where(light[..., None], np.uint8(0), np.uint8(255)) * np.ones(3, dtype=np.uint8)
