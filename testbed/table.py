"""The table: how far it goes, and how far past its edges an action would carry an object."""

from __future__ import annotations

import math

import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull

from testbed.objects import ObjectShape
from testbed.tool_path import ToolPath

LOW, HIGH = (-0.30, -0.60), (1.00, 0.60)
"""Two opposite corners of the simulated table's top, m, from the arm's base; a test holds them to its MJCF."""
EDGES = ("far", "left", "near", "right")
"""As the arm faces them: the side of +x, +y, -x and -y."""
OFFSET = np.array([HIGH[0], HIGH[1], -LOW[0], -LOW[1]])
"""Of each edge from the arm's base, outwards, m."""
_WAY = np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
_HEADING = np.array([0.0, 0.5, 1.0, 1.5]) * math.pi


def outline(shape: ObjectShape) -> Float[np.ndarray, "K 2"]:
    """Corners of the convex hull of all cells, m, object frame."""
    half = shape.cell / 2 * np.array([[-1, -1], [-1, 1], [1, -1], [1, 1]])
    corners = (shape.particles[:, None] + half).reshape(-1, 2)
    return corners[ConvexHull(corners).vertices]


def overhang(
    corners: Float[np.ndarray, "K 2"],
    pivot: Float[np.ndarray, "N 2"],
    centre: Float[np.ndarray, "N 2"],
    yaw: Float[np.ndarray, "N"],
    turn: Float[np.ndarray, "N"],
    slide: Float[np.ndarray, "N 2"],
) -> Float[np.ndarray, "N 4"]:
    """How far past each edge an object gets anywhere on its way, m; less than 0 where all of it stays inside.

    Exact: of an arc, the farthest point is one of its ends, or where it heads straight for the edge.

    Args:
        corners: of its outline, m, object frame.
        pivot: point of the object about which it turns, m, object frame.
        centre: where that is at the middle of the way, m, world.
        yaw: of the object there, rad.
        turn: angle of the whole way, rad; 0 of a slide.
        slide: displacement over the whole way, m, world; 0 of a turn.
    """
    lever = corners - pivot[:, None]
    radius = np.hypot(lever[..., 0], lever[..., 1])[..., None]
    middle = (np.arctan2(lever[..., 1], lever[..., 0]) + yaw[:, None])[..., None] - _HEADING
    half = np.abs(turn)[:, None, None] / 2
    off = np.abs(np.remainder(middle + math.pi, 2 * math.pi) - math.pi)  # from the heading, at the middle of the way
    reach = (radius * np.cos(np.maximum(off - half, 0.0))).max(axis=1)
    return centre @ _WAY.T + np.abs(slide @ _WAY.T) / 2 + reach - OFFSET


def overhang_of(shape: ObjectShape, path: ToolPath) -> Float[np.ndarray, "4"]:
    """That of one path."""
    each = (path.pivot, path.centre, path.yaw, path.turn, path.slide)
    return overhang(outline(shape), *(np.asarray(value)[None] for value in each))[0]
