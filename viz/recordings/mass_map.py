"""Mass maps in Rerun: an object's cells in the color of their group's value, with outlines, numbers and color bar."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import rerun as rr
from jaxtyping import Float, Int
from matplotlib.transforms import Bbox

from testbed.objects.chain import Chain
from testbed.objects.model import ObjectShape
from viz.recordings.page import Frames, Node
from viz.recordings.planar import (
    LINE,
    MARGIN,
    Canvas,
    have_room,
    label_anchors,
    log_lines,
    log_texts,
    log_upright,
    packed,
    text_width,
    ticks,
)
from viz.style import BACKGROUND, BLACK, MOST_NAMED, Scale, group_middles, mapped, narrowest_group, rgb, text_color

FINE = 4
"""Pixels along a cell's side where cells do not lie on one lattice."""
FITTING = 0.75
"""Least ratio of a group's width to that of its number: the number may overlap its edges slightly."""
SHADES = 64
"""Number of colors of a color bar."""
BELOW = 2 * LINE + 6 * MARGIN
"""Height of the texts below a color bar [pixels]."""
GAP = 0.05
"""Distance between a map and its color bar, relative to the map's size."""


@dataclass(frozen=True, eq=False)
class Raster:
    """An object as pixels."""

    group: Int[np.ndarray, "H W"]
    """Mass group at each pixel, the lowest row first; -1 beside the object."""
    left: float
    bottom: float
    """Lower left corner [m], object frame."""
    pixel: float
    """Side of a pixel [m]."""

    @staticmethod
    def of(shape: ObjectShape) -> Raster:
        """Raster of a shape: one pixel per side of a cell where all cells lie on one lattice, else FINE."""
        cells = shape.particles[shape.cells]
        low = cells.min(axis=0)
        at = (cells - low) / shape.cell
        fine = 1 if np.abs(at - at.round()).max() < 0.02 else FINE
        at = (fine * at).round().astype(int)
        width, height = at.max(axis=0) + fine
        group = np.full((height, width), -1)
        for (x, y), number in zip(at, shape.mass_group[shape.cells], strict=True):
            group[y : y + fine, x : x + fine] = number
        left, bottom = low - shape.cell / 2
        return Raster(group, float(left), float(bottom), shape.cell / fine)

    @property
    def box(self) -> Bbox:
        """Bounds around the object [m], object frame."""
        height, width = self.group.shape
        return Bbox.from_bounds(self.left, self.bottom, width * self.pixel, height * self.pixel)

    def link(self, chain: Chain, link: int) -> Raster:
        """Raster of one link of an object, as one group."""
        return replace(self, group=np.where((self.group >= 0) & (chain.link[self.group] == link), 0, -1))

    def outlines(self) -> list[Float[np.ndarray, "2 2"]]:
        """Borders between groups and around the object [m], object frame."""
        around = np.pad(self.group, 1, constant_values=-1)
        corner, found = np.array([self.left, self.bottom]), []
        for upright, grid in ((True, around), (False, around.T)):
            for line, differs in enumerate((grid[1:-1, 1:] != grid[1:-1, :-1]).T):
                edges = np.flatnonzero(np.diff(np.concatenate([[0], differs.astype(int), [0]])))
                for begin, end in edges.reshape(-1, 2):
                    ends = np.array([[line, begin], [line, end]] if upright else [[begin, line], [end, line]])
                    found.append(corner + self.pixel * ends)
        return found

    def image(self, colors: np.ndarray) -> np.ndarray:
        """Pixels, (..., H, W, 3), from the groups' colors, (..., n_m, 3); the background beside the object."""
        background = np.broadcast_to(np.array(rgb(BACKGROUND), dtype=np.uint8), (*colors.shape[:-2], 1, 3))
        return np.concatenate([colors, background], axis=-2)[..., self.group, :]  # -1 is the last

    def log(self, node: Node, colors: np.ndarray, frames: Frames) -> None:
        """Log the pixels in the object frame; colors (F, n_m, 3)."""
        height, width = self.group.shape
        place = rr.Transform3D(translation=[self.left, self.bottom, 0], scale=[self.pixel, self.pixel, 1])
        look = rr.components.ImageFormat(width=width, height=height, color_model="RGB", channel_datatype="U8")
        sharp = rr.components.MagnificationFilter.Nearest
        node.log(place, rr.Image.from_fields(format=look, magnification_filter=sharp))
        frames.send(
            node, lambda k: rr.Image.columns(buffer=np.ascontiguousarray(self.image(colors[k]).reshape(len(k), -1)))
        )


@dataclass(frozen=True, eq=False)
class MassMap:
    """Values of the mass groups, F frames of them."""

    shape: ObjectShape
    """Geometry of the object."""
    values: Float[np.ndarray, "F n_m"] | None
    """Values; None where there is no answer."""
    scale: Scale
    """Color scale."""
    canvas: Canvas
    """Size of the view."""
    named: bool = True
    """True if cells have the group's name too, where there is room."""

    @property
    def box(self) -> Bbox:
        """Bounds around the map and its color bar."""
        box = Raster.of(self.shape).box
        return self.canvas.framed(Bbox.union([box, bar_box(box)]), 26, 10, BELOW)

    def log(self, node: Node, frames: Frames, box: Bbox, at: tuple[float, float] = (0.0, 0.0)) -> None:
        """Log the map below `node`, with the origin of the object frame at `at`, for a view that shows `box`."""
        log_upright(node, at)
        raster, pixel = Raster.of(self.shape), self.canvas.pixel(box)
        values = np.full((1, self.shape.n_m), np.nan) if self.values is None else self.values
        raster.log(node / "cells", self.scale.color(values), frames)
        log_lines(node / "outlines", raster.outlines())
        log_hinges(node / "hinges", self.shape)
        if self.values is None:
            log_texts(node / "groups", raster.box.get_points().mean(axis=0)[None], ["no answer"], pixel)
        elif self.shape.n_m <= MOST_NAMED:
            self._log_texts(node / "groups", frames, self.values, pixel)

    def log_with_bar(self, node: Node, frames: Frames) -> None:
        """Log the map and its color bar below `node`, for a view of its own."""
        self.log(node, frames, self.box)
        place = bar_box(Raster.of(self.shape).box)
        log_bar(node / "bar", self.scale, place, self.canvas.pixel(self.box))

    def _log_texts(self, node: Node, frames: Frames, values: Float[np.ndarray, "F n_m"], pixel: float) -> None:
        """Log the number of each group, below its name, where there is room."""
        count, middles, digits = self.shape.n_m, group_middles(self.shape), self.scale.digits
        texts = [[f"{value:.{digits}f}" for value in row] for row in values]
        apart = np.array([0.0, LINE * pixel / 2])
        both = np.concatenate([middles + apart, middles - apart])
        shades = text_color(self.scale.color(values))
        narrow = narrowest_group(self.shape) < FITTING * text_width(texts[-1][0]) * pixel
        if self.named and have_room(both, [*self.shape.group_names, *texts[-1]], pixel):
            log_texts(node / "names", middles + apart, self.shape.group_names, pixel, shades[-1])
            middles = middles - apart
        elif narrow or not have_room(middles, texts[-1], pixel):
            return
        (node / "masses").log(rr.Points2D(label_anchors(middles, pixel), radii=1e-6, show_labels=True))
        frames.send(
            node / "masses",
            lambda k: rr.Points2D.columns(
                labels=[text for i in k for text in texts[i]], colors=packed(shades[k]).ravel()
            ).partition([count] * len(k)),
        )


def log_hinges(node: Node, shape: ObjectShape) -> None:
    """Log a ring at each hinge of an object in links [m], object frame."""
    if shape.chain is not None:
        for part, color, radius, order in (("ring", BLACK, 5.0, 25.0), ("middle", BACKGROUND, 3.5, 26.0)):
            look = {"colors": rgb(color), "radii": rr.Radius.ui_points(radius), "draw_order": order}
            (node / part).log(rr.Points2D(shape.chain.hinges, **look))


def bar_box(box: Bbox) -> Bbox:
    """Bounds of the color bar below a map with the bounds `box`: as wide as the map, wider below a tall one."""
    width = max(box.width, 0.85 * box.height)
    middle, top = (box.x0 + box.x1) / 2, box.y0 - GAP * max(width, box.height)
    return Bbox.from_extents(middle - width / 2, top - 0.05 * width, middle + width / 2, top)


def log_bar(node: Node, scale: Scale, box: Bbox, pixel: float) -> None:
    """Log a color bar at `box`, with ticks and title below it."""
    shades = mapped((np.arange(SHADES) + 0.5) / SHADES, 1.0, scale.colors)
    place = rr.Transform3D(translation=[box.x0, box.y0, 0], scale=[box.width / SHADES, box.height, 1])
    strip = rr.Image(bytes=shades.tobytes(), width=SHADES, height=1, color_model="RGB", datatype="U8")
    (node / "colors").log(place, strip)
    values, texts = ticks(scale.top)
    if scale.open:
        last = f"≥ {scale.top:.2g}"
        room = pixel * text_width(last) / box.width * scale.top
        kept = [i for i, value in enumerate(values) if value < scale.top - room]
        values, texts = np.append(values[kept], scale.top), [*(texts[i] for i in kept), last]
    x = box.x0 + box.width * values / scale.top
    marks = [np.array([[each, box.y0], [each, box.y0 - MARGIN * pixel]]) for each in x]
    log_lines(node / "outline", [box.corners()[[0, 2, 3, 1, 0]], *marks])
    below = box.y0 - (2 * MARGIN + LINE / 2) * pixel
    log_texts(node / "ticks", np.column_stack([x, np.full(len(x), below)]), texts, pixel)
    title = np.array([[(box.x0 + box.x1) / 2, below - (LINE + 2 * MARGIN) * pixel]])
    log_texts(node / "title", title, [scale.title], pixel)
