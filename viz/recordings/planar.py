"""Planar scenes in Rerun: y upwards, a length or a mass as the unit, and text that fits.

Rerun's planar views have y downwards; everything here is logged below an entity that turns it over, so that what is
stored are the object's own coordinates.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8
from matplotlib.ticker import MaxNLocator

from viz.style import BACKGROUND, BLACK, EDGE, rgb

CHARACTER, LINE = 7.5, 22.0
"""Size of a label in the viewer, pixels: a letter's width, and the height with its frame."""
MARGIN = 4.0
"""Between a label and what it is not about, pixels."""
HAIR = rr.Radius.ui_points(0.75)
"""Half the width of an outline."""


@dataclass(frozen=True)
class Box:
    """A part of the plane, y upwards."""

    left: float
    bottom: float
    right: float
    top: float

    @property
    def width(self) -> float:
        """Along x."""
        return self.right - self.left

    @property
    def height(self) -> float:
        """Along y."""
        return self.top - self.bottom

    def moved(self, x: float, y: float) -> Box:
        """The same elsewhere."""
        return Box(self.left + x, self.bottom + y, self.right + x, self.top + y)

    def grown(self, left: float, bottom: float, right: float, top: float) -> Box:
        """With room added on each side."""
        return Box(self.left - left, self.bottom - bottom, self.right + right, self.top + top)

    def joined(self, other: Box) -> Box:
        """The least box around both."""
        return Box(
            min(self.left, other.left),
            min(self.bottom, other.bottom),
            max(self.right, other.right),
            max(self.top, other.top),
        )

    @property
    def corners(self) -> Float[np.ndarray, "5 2"]:
        """A closed line around it."""
        x, y = [self.left, self.right, self.right, self.left], [self.bottom, self.bottom, self.top, self.top]
        return np.column_stack([[*x, x[0]], [*y, y[0]]])


@dataclass(frozen=True)
class Canvas:
    """Pixels that a view can count on; decides which labels have room."""

    width: float
    height: float

    def pixel(self, box: Box) -> float:
        """Size of a pixel where the view shows all of `box`, in the box's unit."""
        return max(box.width / self.width, box.height / self.height)

    def framed(self, box: Box, sides: float, above: float, below: float) -> Box:
        """The box with room for so many pixels around it."""
        pixel = max(box.width / (self.width - 2 * sides), box.height / (self.height - above - below))
        return box.grown(sides * pixel, below * pixel, sides * pixel, above * pixel)


def planar_view(origin: str, box: Box, name: str) -> rrb.Spatial2DView:
    """A view of the scene below `origin`, showing at least `box`."""
    bounds = rrb.VisualBounds2D(x_range=(box.left, box.right), y_range=(-box.top, -box.bottom))
    return rrb.Spatial2DView(origin=origin, name=name, background=rgb(BACKGROUND), visual_bounds=bounds)


def log_upright(stream: rr.RecordingStream, entity: str, at: tuple[float, float] = (0.0, 0.0)) -> None:
    """Make an entity the root of what is drawn y upwards, with its own origin at `at` of the scene."""
    place = rr.Transform3D(translation=[at[0], -at[1], 0], mat3x3=np.diag([1.0, -1.0, 1.0]))
    stream.log(entity, place, static=True, strict=True)


def log_lines(
    stream: rr.RecordingStream, entity: str, lines: Sequence[np.ndarray], color: str = EDGE, order: float = 20.0
) -> None:
    """Thin lines, each (N, 2); those of higher `order` lie on top."""
    strips = rr.LineStrips2D(lines, colors=rgb(color), radii=HAIR, draw_order=order)
    stream.log(entity, strips, static=True, strict=True)


def log_texts(
    stream: rr.RecordingStream,
    entity: str,
    middles: Float[np.ndarray, "N 2"],
    texts: Sequence[str],
    pixel: float,
    colors: UInt8[np.ndarray, "N 3"] | str = BLACK,
) -> None:
    """Texts about their middles.

    Args:
        stream: recording.
        entity: below which.
        middles: of each text.
        texts: one each, of one line.
        pixel: size of a pixel in the scene's unit.
        colors: of the letters.
    """
    shade = rgb(colors) if isinstance(colors, str) else colors
    said = rr.Points2D(hung(middles, pixel), radii=1e-6, labels=texts, show_labels=True, colors=shade)
    stream.log(entity, said, static=True, strict=True)


def hung(middles: Float[np.ndarray, "N 2"], pixel: float) -> Float[np.ndarray, "N 2"]:
    """Where a point must be for its label, which hangs below it, to lie about `middles`."""
    return np.asarray(middles) + np.array([0, (LINE / 2 + 3) * pixel])


def text_width(text: str) -> float:
    """Of a label with its frame, pixels."""
    return CHARACTER * len(text) + 2 * MARGIN


def have_room(middles: Float[np.ndarray, "N 2"], texts: Sequence[str], pixel: float) -> bool:
    """Whether no two texts about these middles overlap."""
    width = np.array([text_width(text) for text in texts]) * pixel
    apart = np.abs(middles[:, None] - middles[None])
    clash = (apart[..., 0] < (width[:, None] + width) / 2) & (apart[..., 1] < LINE * pixel)
    return int(clash.sum()) == len(texts)


def ticks(top: float, most: int = 4) -> tuple[Float[np.ndarray, "K"], list[str]]:
    """Round values from 0 to at most `top`, and how they are written."""
    values = np.array(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, top))
    values = values[(values >= 0) & (values <= top * (1 + 1e-9))]
    return values, [f"{value:.6g}" for value in values]
