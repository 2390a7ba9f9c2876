"""Planar scenes in Rerun: y upwards, a length or a mass as the unit, and checks for overlapping labels.

Rerun's planar views have y downwards; scenes are logged below an entity that mirrors y, so that the stored coordinates
are the object's own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import rerun as rr
import rerun.blueprint as rrb
from jaxtyping import Float, UInt8, UInt32
from matplotlib.ticker import MaxNLocator
from matplotlib.transforms import Bbox

from viz.recordings.page import Node
from viz.style import BACKGROUND, BLACK, EDGE, rgb

CHARACTER, LINE = 7.5, 22.0
"""Width of a character of a label, and height of a label with its frame [pixels]."""
MARGIN = 4.0
"""Distance between a label and its surroundings [pixels]."""
HAIR = rr.Radius.ui_points(0.75)
"""Half the width of an outline."""
TITLE = 30.0
"""Height of a view's title [pixels]."""


@dataclass(frozen=True)
class Canvas:
    """Size of a view [pixels], which decides which labels have room."""

    width: float
    height: float

    def pixel(self, box: Bbox) -> float:
        """Size of a pixel where the view shows all of `box`, in the box's unit."""
        return max(box.width / self.width, box.height / self.height)

    def framed(self, box: Bbox, sides: float, above: float, below: float) -> Bbox:
        """The box with margins around it; `sides`, `above` and `below` in pixels."""
        pixel = max(box.width / (self.width - 2 * sides), box.height / (self.height - above - below))
        left, right = box.x0 - sides * pixel, box.x1 + sides * pixel
        return Bbox.from_extents(left, box.y0 - below * pixel, right, box.y1 + above * pixel)


def planar_view(origin: str, box: Bbox, name: str) -> rrb.Spatial2DView:
    """A view of the scene below `origin` that shows at least `box`."""
    bounds = rrb.VisualBounds2D(x_range=(box.x0, box.x1), y_range=(-box.y1, -box.y0))
    return rrb.Spatial2DView(origin=origin, name=name, background=rgb(BACKGROUND), visual_bounds=bounds)


def log_upright(node: Node, at: tuple[float, float] = (0.0, 0.0)) -> None:
    """Make an entity the root of a scene with y upwards and its origin at `at` of the view."""
    node.log(rr.Transform3D(translation=[at[0], -at[1], 0], mat3x3=np.diag([1.0, -1.0, 1.0])))


def log_lines(node: Node, lines: Sequence[np.ndarray], color: str = EDGE, order: float = 20.0) -> None:
    """Log thin lines, each (N, 2); lines of higher `order` are drawn on top."""
    node.log(rr.LineStrips2D(lines, colors=rgb(color), radii=HAIR, draw_order=order))


def log_texts(
    node: Node,
    middles: Float[np.ndarray, "N 2"],
    texts: Sequence[str],
    pixel: float,
    colors: UInt8[np.ndarray, "N 3"] | str = BLACK,
) -> None:
    """Log texts of one line centered at `middles`; `pixel` is the size of a pixel in the scene's unit."""
    shade = rgb(colors) if isinstance(colors, str) else colors
    node.log(rr.Points2D(label_anchors(middles, pixel), radii=1e-6, labels=texts, show_labels=True, colors=shade))


def label_anchors(middles: Float[np.ndarray, "N 2"], pixel: float) -> Float[np.ndarray, "N 2"]:
    """Points whose labels, which Rerun draws below them, are centered at `middles`."""
    return np.asarray(middles) + np.array([0, (LINE / 2 + 3) * pixel])


def text_width(text: str) -> float:
    """Width of a label with its frame [pixels]."""
    return CHARACTER * len(text) + 2 * MARGIN


def have_room(middles: Float[np.ndarray, "N 2"], texts: Sequence[str], pixel: float) -> bool:
    """True if no two texts centered at `middles` overlap."""
    width = np.array([text_width(text) for text in texts]) * pixel
    apart = np.abs(middles[:, None] - middles[None])
    clash = (apart[..., 0] < (width[:, None] + width) / 2) & (apart[..., 1] < LINE * pixel)
    return int(clash.sum()) == len(texts)


def ticks(top: float, most: int = 4) -> tuple[Float[np.ndarray, "K"], list[str]]:
    """Round values from 0 to at most `top`, about `most` of them, and their texts."""
    values = np.array(MaxNLocator(most, steps=[1, 2, 2.5, 5, 10]).tick_values(0.0, top))
    values = values[(values >= 0) & (values <= top * (1 + 1e-9))]
    return values, [f"{value:.6g}" for value in values]


def packed(colors: UInt8[np.ndarray, "... 3"]) -> UInt32[np.ndarray, "..."]:
    """Colors, 0 to 255, as Rerun's 0xRRGGBBAA."""
    red, green, blue = np.moveaxis(np.asarray(colors).astype(np.uint32), -1, 0)
    return (red << 24) | (green << 16) | (blue << 8) | np.uint32(255)
