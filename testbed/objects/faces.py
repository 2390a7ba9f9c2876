"""Faces: the straight sides of an object's outline, as an upright fingertip meets them."""

from __future__ import annotations

from collections import defaultdict
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.spatial.distance import cdist

from testbed.frames import perpendicular
from testbed.objects.model import ObjectShape

_STEP = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_NEAR = 1e-6


class Face(NamedTuple):
    """A straight side of the outline that belongs to one mass group."""

    begin: Float[np.ndarray, "2"]
    """One end [m], object frame."""
    end: Float[np.ndarray, "2"]
    """The other end [m], object frame."""
    normal: Float[np.ndarray, "2"]
    """Unit vector outwards, object frame."""
    group: int
    """Mass group."""

    @property
    def length(self) -> float:
        """Length [m]."""
        return float(np.linalg.norm(self.end - self.begin))

    def nearest(self, point: Float[np.ndarray, "2"]) -> Float[np.ndarray, "2"]:
        """Nearest point of the face to a point [m]."""
        along = (self.end - self.begin) / self.length
        return self.begin + along * np.clip((point - self.begin) @ along, 0.0, self.length)

    def distance(self, point: Float[np.ndarray, "2"]) -> float:
        """Distance of a point [m]."""
        return float(np.linalg.norm(point - self.nearest(point)))


def faces(shape: ObjectShape) -> list[Face]:
    """Sides of the outline; without `shape.sides`, the free sides of cells, merged along a line of a mass group."""
    if not len(shape.sides):
        return _faces_of_cells(shape)
    begin, end = shape.sides.swapaxes(0, 1)
    along = (end - begin) / np.linalg.norm(end - begin, axis=1, keepdims=True)
    near = cdist((begin + end) / 2, shape.particles).argmin(axis=1)
    return [
        Face(*each) for each in zip(begin, end, -perpendicular(along), shape.mass_group[near].tolist(), strict=True)
    ]


def _faces_of_cells(shape: ObjectShape) -> list[Face]:
    half, cells = shape.cell / 2, shape.particles[shape.cells]
    rows: dict[tuple[int, int, int], list[tuple[float, float]]] = defaultdict(list)
    for way, step in enumerate(_STEP):
        side = cells + half * step
        beyond = side + 0.01 * half * step
        covered = (np.abs(beyond[:, None] - cells).max(axis=2) < half).any(axis=1)
        for index in np.flatnonzero(~covered):
            across = round(float(side[index] @ step) / _NEAR)
            middle = float(side[index] @ _STEP[(way + 1) % 4])
            rows[way, across, int(shape.mass_group[shape.cells[index]])].append((middle - half, middle + half))
    found = []
    for (way, across, group), parts in sorted(rows.items()):
        joined: list[list[float]] = []
        for begin, end in sorted(parts):
            if joined and begin <= joined[-1][1] + _NEAR:
                joined[-1][1] = max(joined[-1][1], end)
            else:
                joined.append([begin, end])
        out, along = _STEP[way], _STEP[(way + 1) % 4]
        foot = across * _NEAR * out
        found += [Face(foot + begin * along, foot + end * along, out, group) for begin, end in joined]
    return found


def face_at(shape: ObjectShape, point: Float[np.ndarray, "2"]) -> tuple[Face, float]:
    """Face nearest to a point, and its distance [m]."""
    every = faces(shape)
    away = [face.distance(np.asarray(point)) for face in every]
    nearest = int(np.argmin(away))
    return every[nearest], away[nearest]


def room_at(shape: ObjectShape, point: Float[np.ndarray, "2"]) -> float:
    """Distance from a point to the outline [m], negative inside it."""
    every = faces(shape)
    ends = np.array([[face.begin, face.end] for face in every]) - point
    crosses = (ends[:, 0, 1] > 0) != (ends[:, 1, 1] > 0)
    (x, y), (dx, dy) = ends[crosses, 0].T, (ends[crosses, 1] - ends[crosses, 0]).T
    within = np.count_nonzero(x - y * dx / dy > 0) % 2
    return (-1) ** within * min(face.distance(point) for face in every)
