"""Poses of a rigid body on the table: its stable faces, and the points on which it then rests."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import trimesh
from jaxtyping import Float
from scipy.optimize import nnls
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import ConvexHull, KDTree, QhullError

from testbed.errors import InvalidValueError
from testbed.frames import cross_2d
from testbed.objects.conversion.surface import Surface, as_mesh

AXES = {sign + name: k for k, name in enumerate("xyz") for sign in ("", "-")}
"""Axes of a file that may point down."""
RESTING = 1e-4
"""Height up to which a point of a hull's face touches the table [m]."""
MOST_CONTACTS = 6
"""Greatest number of points of contact."""
LEAST_LOSS = 0.01
"""Part of the polygon's area, or of the mean load, below which a point of contact is left out."""
LEAST_PROBABILITY = 0.02
"""Probability below which a resting pose is not listed."""
CURVED = np.radians(15.1)
"""Greatest angle between neighboring facets of a curved side, such as a cylinder of 24 facets. Ours."""


@dataclass(frozen=True, eq=False)
class Pose:
    """A pose on the table: a convex hull's face lies on z = 0, the longest side along x."""

    matrix: Float[np.ndarray, "3 4"]
    """Rotation and shift [m] from the frame of the mesh file."""
    probability: float
    """Probability that a fall ends in it; NaN for a pose chosen by its axis."""
    contacts: Float[np.ndarray, "C 2"]
    """Points of contact [m], anticlockwise: three or more."""


def stable_poses(surface: Surface, center: Float[np.ndarray, "3"] | None = None) -> list[Pose]:
    """Poses in which a body comes to rest, the likeliest first (Goldberg et al. 1999, by trimesh).

    Args:
        surface: surface of the body.
        center: center of mass, m, axes of the file; that of one density if left out.

    Raises:
        InvalidValueError: no face on which it rests.
    """
    whole = as_mesh(surface.whole)
    center = whole.center_mass if center is None else center
    matrices, chances = trimesh.poses.compute_stable_poses(whole.convex_hull, center_mass=center)
    found = list(_distinct(surface, center, matrices, chances))
    if not found:
        raise InvalidValueError("down", "auto", "a face on which the mesh rests; ask for one of " + ", ".join(AXES))
    return found


def asked_pose(surface: Surface, down: str, center: Float[np.ndarray, "3"] | None = None) -> Pose:
    """The pose in which an axis of the file points down: the face of the hull nearest to it lies on the table.

    Args:
        surface: surface of the body.
        down: the axis.
        center: center of mass, m, axes of the file; that of one density if left out.

    Raises:
        InvalidValueError: not an axis.
    """
    if down not in AXES:
        raise InvalidValueError("down", down, f"auto or one of {', '.join(AXES)}")
    axis = np.zeros(3)
    axis[AXES[down]] = -1.0 if down.startswith("-") else 1.0
    whole = as_mesh(surface.whole)
    hull, center = whole.convex_hull, whole.center_mass if center is None else center
    normal = hull.face_normals[(hull.face_normals @ axis).argmax()]
    return _placed(surface, center, np.asarray(trimesh.geometry.align_vectors(normal, [0, 0, -1]))[:3, :3], np.nan)


def _distinct(surface: Surface, center: np.ndarray, matrices: np.ndarray, chances: np.ndarray) -> Iterator[Pose]:
    """Poses on distinct sides, the likeliest first: the facets of a curved side are one, with their whole probability.

    A side is a chain of facets that differ by `CURVED` at most.
    """
    downs = matrices[:, 2, :3]
    near = KDTree(downs).query_pairs(2 * np.sin(CURVED / 2), output_type="ndarray")
    linked = coo_array((np.ones(len(near)), (near[:, 0], near[:, 1])), (len(downs), len(downs)))
    side = connected_components(linked, directed=False)[1]
    total = np.bincount(side, chances)
    for rank, each in enumerate(np.argsort(-total, kind="stable")):
        if rank and total[each] < LEAST_PROBABILITY:
            return
        facets = np.flatnonzero(side == each)
        index = facets[chances[facets].argmax()]
        yield _placed(surface, center, matrices[index][:3, :3], float(total[each]))


def _placed(
    surface: Surface, center: Float[np.ndarray, "3"], rotation: Float[np.ndarray, "3 3"], probability: float
) -> Pose:
    """Pose of a rotation, turned about z until its longest side is along x."""
    points = as_mesh(surface.whole).convex_hull.vertices @ rotation.T
    box = trimesh.bounds.oriented_bounds_2D(points[:, :2])
    turn = np.eye(3)
    turn[:2, :2] = box[0][:2, :2]
    turned = points @ turn.T
    if np.ptp(turned[:, 0]) < np.ptp(turned[:, 1]):
        turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]) @ turn
        turned = points @ turn.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    shift = -np.array([*(low + high)[:2] / 2, low[2]])
    matrix = np.column_stack([turn @ rotation, shift])
    middle = matrix[:2] @ np.append(center, 1.0)
    return Pose(matrix, probability, contact_points(turned + shift, middle))


def contact_points(vertices: Float[np.ndarray, "V 3"], middle: Float[np.ndarray, "2"]) -> Float[np.ndarray, "C 2"]:
    """Corners of the support polygon on z = 0 [m]: `MOST_CONTACTS` at most, those of the largest area.

    Corners that would lift off an even, soft table are left out.

    Args:
        vertices: of the body or its hull, m.
        middle: center of mass, m.

    Raises:
        InvalidValueError: fewer than three points touch, or all in one line.
    """
    flat = vertices[vertices[:, 2] < vertices[:, 2].min() + RESTING, :2]
    try:
        corners = flat[ConvexHull(flat).vertices]
    except (QhullError, ValueError):
        given = f"{len(flat)} points in contact, in one line"
        raise InvalidValueError("down", given, "a face of three points or more") from None
    while len(corners) > MOST_CONTACTS or (len(corners) > 3 and _lost(corners).min() < LEAST_LOSS * _area(corners)):
        corners = np.delete(corners, _lost(corners).argmin(), axis=0)
    # the least sum of squared loads >= 0 in balance is that of springs under the corners
    levers = (corners - middle) / np.ptp(corners, axis=0).max()
    balance = np.vstack([np.ones(len(corners)), levers.T]) * 1e4
    loads, _ = nnls(np.vstack([balance, np.eye(len(corners))]), np.append([1e4, 0, 0], np.zeros(len(corners))))
    kept = loads > LEAST_LOSS * loads.mean()
    return corners[kept] if kept.sum() >= 3 and _area(corners[kept]) > LEAST_LOSS * _area(corners) else corners


def _lost(corners: np.ndarray) -> np.ndarray:
    """Area that a polygon loses without each corner."""
    before, after = np.roll(corners, 1, axis=0), np.roll(corners, -1, axis=0)
    return np.abs(cross_2d(corners - before, after - before)) / 2


def _area(corners: np.ndarray) -> float:
    x, y = corners.T
    return float(abs(x @ np.roll(y, -1) - y @ np.roll(x, -1)) / 2)
