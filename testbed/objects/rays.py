"""Parallel rays on a grid through a surface of triangles, by rasterization: no ray passes between two triangles."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from testbed.frames import cross_2d

if TYPE_CHECKING:
    import trimesh

_PAIRS = 4_000_000
"""Greatest number of pairs of triangle and ray in one batch, about."""
OFF_CENTER = np.array([0.00137, 0.00071])
"""Shift of the rays in steps of their grid, so that no ray lies in a wall of a mesh symmetric about the grid."""


class RayGrid(NamedTuple):
    """n x m rays; ray i * m + j runs through `corner` + i `first` + j `second`, at a right angle to both."""

    corner: Float[np.ndarray, "3"]
    """Point of the first ray [m]."""
    first: Float[np.ndarray, "3"]
    """Step between rows of rays [m]."""
    second: Float[np.ndarray, "3"]
    """Step between rays of a row, at a right angle to `first` [m]."""
    counts: tuple[int, int]
    """n and m."""


def grid_hits(
    mesh: trimesh.Trimesh, grid: RayGrid
) -> tuple[Float[np.ndarray, "H"], Int[np.ndarray, "H"], Int[np.ndarray, "H"]]:
    """Hits of the rays: height over the grid [m], index of the ray, and 1 out of the body or -1 into it.

    The rays run along first x second and have no ends. A ray through an edge hits one of its two triangles, decided by
    the same arithmetic for both, so that it enters a closed surface as often as it leaves it.
    """
    sides = np.linalg.norm([grid.first, grid.second], axis=1)
    axes = np.array([grid.first / sides[0], grid.second / sides[1]])
    axes = np.vstack([axes, np.cross(axes[0], axes[1])])
    corners = (np.asarray(mesh.vertices) - grid.corner) @ axes.T / [*sides, 1.0]  # in steps
    faces = np.asarray(mesh.faces)
    flat = corners[faces]
    most = np.array(grid.counts) - 1
    low = np.maximum(np.ceil(flat[:, :, :2].min(axis=1)), 0).astype(int)
    high = np.minimum(np.floor(flat[:, :, :2].max(axis=1)), most).astype(int)
    a, b, c = flat[:, 0], flat[:, 1], flat[:, 2]
    area = cross_2d(b - a, c - a)
    over = np.flatnonzero((low <= high).all(axis=1) & (area != 0))
    spans = (high - low + 1)[over]
    found: list[tuple[np.ndarray, np.ndarray, np.ndarray]] = []
    ends = np.cumsum(spans.prod(axis=1))
    for part in np.split(
        np.arange(len(over)), np.searchsorted(ends, np.arange(_PAIRS, ends[-1], _PAIRS)) if len(ends) else []
    ):
        face, span = over[part], spans[part]
        pairs = span.prod(axis=1)
        which = np.repeat(np.arange(len(part)), pairs)
        place = np.arange(pairs.sum()) - np.repeat(np.cumsum(pairs) - pairs, pairs)
        i = low[face][which, 0] + place // span[which, 1]
        j = low[face][which, 1] + place % span[which, 1]
        corner = faces[face]
        inside = np.ones(len(which), dtype=bool)
        turn = np.sign(area[face])
        for start, end in ((0, 1), (1, 2), (2, 0)):
            swapped = corner[:, start] > corner[:, end]  # the same numbers for both triangles of an edge
            p = corners[np.where(swapped, corner[:, end], corner[:, start])][which]
            q = corners[np.where(swapped, corner[:, start], corner[:, end])][which]
            beside = (q[:, 0] - p[:, 0]) * (j - p[:, 1]) - (q[:, 1] - p[:, 1]) * (i - p[:, 0])
            left = np.where(swapped, -1, 1) * turn
            inside &= np.where(beside == 0, left[which] > 0, beside * left[which] > 0)
        which, i, j = which[inside], i[inside], j[inside]
        face = face[which]
        at = np.column_stack([i, j]) - a[face, :2]
        s = cross_2d(at, (c - a)[face]) / area[face]
        t = cross_2d((b - a)[face], at) / area[face]
        height = a[face, 2] + s * (b - a)[face, 2] + t * (c - a)[face, 2]
        found.append((height, i * grid.counts[1] + j, np.sign(area[face]).astype(int)))
    if not found:
        return np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    height, ray, out = (np.concatenate(each) for each in zip(*found, strict=True))
    return height, ray, out
