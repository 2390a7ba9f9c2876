"""An object's particles in Rerun: coloured by mass, sized by friction load; rings show the true load."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import rerun as rr
from jaxtyping import Float

from testbed.objects.model import GRAVITY, MassDistribution, ObjectShape
from viz.recordings.mass_map import BELOW, Raster, Scale, bar_box, log_bar, packed
from viz.recordings.page import Frames
from viz.recordings.planar import (
    HAIR,
    LINE,
    MARGIN,
    Box,
    Canvas,
    log_lines,
    log_texts,
    log_upright,
)
from viz.style import BLACK, mapped, rgb

FULL = 0.46
"""Radius of the particle with the largest load, over its cell's side."""


def friction_load(
    shape: ObjectShape, mass: Float[np.ndarray, "... n_m"], friction: Float[np.ndarray, "n_mu"]
) -> Float[np.ndarray, "... P"]:
    """mu m g of every particle, N; 0 where it does not touch the table."""
    pressed = np.where(shape.friction_group < 0, 0.0, np.append(friction, 0.0)[shape.friction_group])
    return pressed * np.asarray(mass)[..., shape.mass_group] * GRAVITY


@dataclass(frozen=True, eq=False)
class LoadScene:
    """Particles of an estimate, F frames, and of the truth."""

    shape: ObjectShape
    mass: Float[np.ndarray, "F n_m"]
    """kg a particle."""
    friction: Float[np.ndarray, "n_mu"]
    truth: MassDistribution | None
    scale: Scale
    """Of the mass of a particle."""
    canvas: Canvas

    @property
    def largest(self) -> float:
        """The load that fills a cell, N: of the answer or the truth."""
        known = [friction_load(self.shape, self.mass[-1], self.friction)]
        if self.truth is not None:
            known.append(friction_load(self.shape, self.truth.mass, self.truth.friction))
        return max(float(np.max(known)), 1e-12)

    def radius(self, load: np.ndarray) -> np.ndarray:
        """Of a disc whose area is as its load, m; a load beyond the largest fills its cell no more than that."""
        return FULL * self.shape.cell * np.sqrt(np.clip(load / self.largest, 0.0, 1.0))

    @property
    def box(self) -> Box:
        """All that is drawn."""
        box = Raster.of(self.shape).box
        return self.canvas.framed(box.joined(bar_box(box)), 24, LINE + 3 * MARGIN, BELOW)

    def log(self, stream: rr.RecordingStream, entity: str, frames: Frames) -> None:
        """Draw it below `entity`."""
        log_upright(stream, entity)
        raster, pixel = Raster.of(self.shape), self.canvas.pixel(self.box)
        log_lines(stream, f"{entity}/outlines", raster.outlines())
        load = friction_load(self.shape, self.mass, self.friction)
        colors = packed(mapped(self.mass[:, self.shape.mass_group], self.scale.top, self.scale.colors))
        # the smallest disc still shows the colour of a particle that carries no load
        radii = np.maximum(self.radius(load), 0.1 * self.shape.cell)
        stream.log(f"{entity}/particles", rr.Points2D(self.shape.particles), static=True, strict=True)
        each = len(self.shape.particles)
        frames.send(
            stream,
            f"{entity}/particles",
            lambda k: rr.Points2D.columns(colors=colors[k].ravel(), radii=radii[k].ravel()).partition([each] * len(k)),
        )
        if self.truth is not None:
            ring = self.radius(friction_load(self.shape, self.truth.mass, self.truth.friction))
            half = np.column_stack([ring, ring])[ring > 0]
            rings = rr.Ellipses2D(
                half_sizes=half,
                centers=self.shape.particles[ring > 0],
                colors=rgb(BLACK),
                line_radii=HAIR,
                draw_order=40,
            )
            stream.log(f"{entity}/true_load", rings, static=True, strict=True)
        log_bar(stream, f"{entity}/bar", self.scale, bar_box(raster.box), pixel)
        self._log_key(stream, f"{entity}/key", raster.box, pixel)

    def _log_key(self, stream: rr.RecordingStream, entity: str, box: Box, pixel: float) -> None:
        """What the largest disc stands for."""
        ring = ", ring: truth" if self.truth is not None else ""
        middle = np.array([[(box.left + box.right) / 2, box.top + (LINE / 2 + 1.5 * MARGIN) * pixel]])
        log_texts(stream, entity, middle, [f"full cell: {self.largest:.2g} N{ring}"], pixel)
