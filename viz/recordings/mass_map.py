"""A number for each mass group of an object, as a coloured map in Rerun: cells, outlines, names, colour bar."""

from __future__ import annotations

from dataclasses import dataclass
from typing import cast

import numpy as np
import rerun as rr
from jaxtyping import Float, Int

from testbed.objects.model import ObjectShape
from viz.recordings.page import Frames
from viz.recordings.planar import (
    LINE,
    MARGIN,
    Box,
    Canvas,
    have_room,
    hung,
    log_lines,
    log_texts,
    log_upright,
    text_width,
    ticks,
)
from viz.style import BACKGROUND, mapped, rgb, text_color

MOST_NAMED = 30
"""More groups than this have no room for names."""
FINE = 4
"""Pixels along a cell's side where cells do not lie on one lattice."""
FITTING = 0.75
"""A number may stick out of its group by no more than this, as the group's width over the text's."""
SHADES = 64
"""Of a colour bar."""
BELOW = 2 * LINE + 6 * MARGIN
"""Room for what is written below a colour bar, pixels."""
GAP = 0.05
"""Between a map and its colour bar, over the map's size."""


@dataclass(frozen=True)
class Scale:
    """A colour scale from 0 to `top`; what is above has the colour of `top`."""

    top: float
    colors: str
    """Name of the colour map."""
    title: str
    """Quantity and unit."""
    open: bool = False
    """Whether there are values above `top`."""

    @property
    def digits(self) -> int:
        """After the point: two that count."""
        return int(np.clip(1 - np.floor(np.log10(self.top)), 2, 4))


@dataclass(frozen=True, eq=False)
class Raster:
    """An object as pixels."""

    group: Int[np.ndarray, "H W"]
    """Mass group at each pixel, the lowest row first; -1 beside the object."""
    left: float
    bottom: float
    """Its lower left corner, m, object frame."""
    pixel: float
    """Side of a pixel, m."""

    @staticmethod
    def of(shape: ObjectShape) -> Raster:
        """A pixel a cell where the cells lie on one lattice."""
        low = shape.particles.min(axis=0)
        at = (shape.particles - low) / shape.cell
        fine = 1 if np.abs(at - at.round()).max() < 0.02 else FINE
        at = (fine * at).round().astype(int)
        width, height = at.max(axis=0) + fine
        group = np.full((height, width), -1)
        for (x, y), which in zip(at, shape.mass_group, strict=True):
            group[y : y + fine, x : x + fine] = which
        left, bottom = low - shape.cell / 2
        return Raster(group, float(left), float(bottom), shape.cell / fine)

    @property
    def box(self) -> Box:
        """Around the object, m, object frame."""
        height, width = self.group.shape
        return Box(self.left, self.bottom, self.left + width * self.pixel, self.bottom + height * self.pixel)

    def outlines(self) -> list[Float[np.ndarray, "2 2"]]:
        """Borders between groups and around the object, m, object frame."""
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
        """Pixels, (..., H, W, 3), of a colour a group, (..., n_m, 3); the background beside the object."""
        beside = np.broadcast_to(np.array(rgb(BACKGROUND), dtype=np.uint8), (*colors.shape[:-2], 1, 3))
        return np.concatenate([colors, beside], axis=-2)[..., self.group, :]  # -1 is the last


@dataclass(frozen=True, eq=False)
class CellMap:
    """Numbers of the mass groups, F frames of them."""

    shape: ObjectShape
    values: Float[np.ndarray, "F n_m"] | None
    """None where there is no answer."""
    scale: Scale
    canvas: Canvas
    """What the view can count on."""
    named: bool = True
    """Whether cells say the group's name too, where there is room."""

    def box(self, *, bar: bool = True) -> Box:
        """Of the map, its colour bar included if there is one."""
        box = Raster.of(self.shape).box
        if not bar:
            return self.canvas.framed(box, 10, 10, 10)
        return self.canvas.framed(box.joined(bar_box(box)), 26, 10, BELOW)

    def log(
        self,
        stream: rr.RecordingStream,
        entity: str,
        frames: Frames,
        box: Box,
        at: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        """Draw it below `entity`, its object frame at `at` of a scene of which the view shows `box`."""
        log_upright(stream, entity, at)
        raster, pixel = Raster.of(self.shape), self.canvas.pixel(box)
        values = np.full((1, self.shape.n_m), np.nan) if self.values is None else self.values
        log_raster(stream, f"{entity}/cells", raster, mapped(values, self.scale.top, self.scale.colors), frames)
        log_lines(stream, f"{entity}/outlines", raster.outlines())
        if self.values is None:
            middle = np.array([[(raster.box.left + raster.box.right) / 2, (raster.box.bottom + raster.box.top) / 2]])
            log_texts(stream, f"{entity}/groups", middle, ["no answer"], pixel)
        elif self.shape.n_m <= MOST_NAMED:
            self._log_texts(stream, f"{entity}/groups", frames, pixel)

    def log_bar(self, stream: rr.RecordingStream, entity: str, box: Box) -> None:
        """Draw its colour bar below `entity`, in the same place and scene as the map."""
        log_bar(stream, entity, self.scale, bar_box(Raster.of(self.shape).box), self.canvas.pixel(box))

    def _log_texts(self, stream: rr.RecordingStream, entity: str, frames: Frames, pixel: float) -> None:
        """A number a group and its name above, where there is room."""
        assert self.values is not None
        groups, count = range(self.shape.n_m), self.shape.n_m
        middles = np.array([self.shape.particles[self.shape.mass_group == group].mean(axis=0) for group in groups])
        texts = [[f"{value:.{self.scale.digits}f}" for value in row] for row in self.values]
        apart = np.array([0.0, LINE * pixel / 2])
        both = np.concatenate([middles + apart, middles - apart])
        shades = text_color(mapped(self.values, self.scale.top, self.scale.colors))
        if self.named and have_room(both, [*self.shape.group_names, *texts[-1]], pixel):
            log_texts(stream, f"{entity}/names", middles + apart, self.shape.group_names, pixel, shades[-1])
            middles = middles - apart
        elif not have_room(middles, texts[-1], pixel) or self._narrowest() < FITTING * text_width(texts[-1][0]) * pixel:
            return
        place = rr.Points2D(hung(middles, pixel), radii=1e-6, show_labels=True)
        stream.log(f"{entity}/masses", place, static=True, strict=True)
        frames.send(
            stream,
            f"{entity}/masses",
            lambda k: rr.Points2D.columns(
                labels=[text for i in k for text in texts[i]], colors=packed(shades[k]).ravel()
            ).partition([count] * len(k)),
        )

    def _narrowest(self) -> float:
        """Width of the narrowest group, m."""
        of = [self.shape.particles[self.shape.mass_group == group, 0] for group in range(self.shape.n_m)]
        return self.shape.cell + min(float(np.ptp(x)) for x in of)


def log_raster(stream: rr.RecordingStream, entity: str, raster: Raster, colors: np.ndarray, frames: Frames) -> None:
    """An object's pixels in its own frame; colours (F, n_m, 3)."""
    height, width = raster.group.shape
    place = rr.Transform3D(translation=[raster.left, raster.bottom, 0], scale=[raster.pixel, raster.pixel, 1])
    look = rr.components.ImageFormat(width=width, height=height, color_model="RGB", channel_datatype="U8")
    sharp = rr.components.MagnificationFilter.Nearest
    stream.log(entity, place, rr.Image.from_fields(format=look, magnification_filter=sharp), static=True, strict=True)
    frames.send(
        stream,
        entity,
        lambda k: rr.Image.columns(buffer=np.ascontiguousarray(raster.image(colors[k]).reshape(len(k), -1))),
    )


def bar_box(box: Box) -> Box:
    """Place of the colour bar below a map at `box`: as wide as the map, wider under a tall one."""
    width = max(box.width, 0.85 * box.height)
    middle, top = (box.left + box.right) / 2, box.bottom - GAP * max(width, box.height)
    return Box(middle - width / 2, top - 0.05 * width, middle + width / 2, top)


def log_bar(stream: rr.RecordingStream, entity: str, scale: Scale, box: Box, pixel: float) -> None:
    """A colour bar at `box`, with ticks and title below it."""
    shades = mapped((np.arange(SHADES) + 0.5) / SHADES, 1.0, scale.colors)
    place = rr.Transform3D(translation=[box.left, box.bottom, 0], scale=[box.width / SHADES, box.height, 1])
    strip = rr.Image(bytes=shades.tobytes(), width=SHADES, height=1, color_model="RGB", datatype="U8")
    stream.log(f"{entity}/colors", place, strip, static=True, strict=True)
    values, texts = ticks(scale.top)
    if scale.open:
        last = f"≥ {scale.top:.2g}"
        room = pixel * text_width(last) / box.width * scale.top
        kept = [i for i, value in enumerate(values) if value < scale.top - room]
        values, texts = np.append(values[kept], scale.top), [*(texts[i] for i in kept), last]
    x = box.left + box.width * values / scale.top
    marks = [np.array([[each, box.bottom], [each, box.bottom - MARGIN * pixel]]) for each in x]
    log_lines(stream, f"{entity}/outline", [box.corners, *marks])
    below = box.bottom - (2 * MARGIN + LINE / 2) * pixel
    log_texts(stream, f"{entity}/ticks", np.column_stack([x, np.full(len(x), below)]), texts, pixel)
    middle = np.array([[(box.left + box.right) / 2, below - (LINE + 2 * MARGIN) * pixel]])
    log_texts(stream, f"{entity}/title", middle, [scale.title], pixel)


def packed(colors: np.ndarray) -> np.ndarray:
    """RGB 0 to 255, (..., 3), as Rerun's 0xRRGGBBAA, (...)."""
    red, green, blue = (cast(np.ndarray, colors[..., i]).astype(np.uint32) for i in range(3))
    return (red << 24) | (green << 16) | (blue << 8) | np.uint32(255)
