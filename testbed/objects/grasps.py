"""Grasps of a mesh by a parallel gripper: the faces that its pads hold at a place."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Float, Int

from testbed.errors import InvalidValueError
from testbed.objects.model import FINGER_DEPTH, PAD_HEIGHT, PAD_WIDTH, SPARE_OPENING, STROKE, TOUCH, Grasp
from testbed.objects.rays import OFF_CENTER, RayGrid, grid_hits

if TYPE_CHECKING:
    import trimesh

_PATCH = 0.001
"""Distance between the rays that measure the gripped faces [m]."""


@dataclass(frozen=True)
class GraspPlace:
    """Place to grip the object; width and height of its faces follow from the mesh."""

    name: str
    at: tuple[float, float]
    """Point between the pads [m], x and y of the mesh."""
    closing: float
    """Direction along which the pads close [rad]."""


def grasp_at(mesh: trimesh.Trimesh, place: GraspPlace, field: str) -> Grasp:
    """Grasp at a place, in the mesh's x and y.

    Flat pads rest on the outermost points of the two faces, and touch all points within `TOUCH` of them.

    Args:
        mesh: the whole object on the table z = 0.
        place: point and closing direction of the pads.
        field: name of the place in errors.

    Raises:
        InvalidValueError: nothing to hold, or no room for the fingers.
    """
    closing = np.array([np.cos(place.closing), np.sin(place.closing), 0.0])
    side = np.array([-closing[1], closing[0], 0.0])
    along = np.arange(-PAD_WIDTH / 2 + _PATCH / 2, PAD_WIDTH / 2, _PATCH)
    up = np.arange(PAD_HEIGHT[0] + _PATCH / 2, min(PAD_HEIGHT[1], mesh.bounds[1, 2]), _PATCH)
    if not len(up):
        given = f"an object {mesh.bounds[1, 2] * 1e3:.1f} mm high"
        raise InvalidValueError(field, given, f"one above the pads' lower edge, {PAD_HEIGHT[0] * 1e3:g} mm")
    across = _PATCH * OFF_CENTER
    corner = np.array([*place.at, 0.0]) + (along[0] + across[0]) * side + [0.0, 0.0, up[0] + across[1]]
    # side x up is the closing direction
    grid = RayGrid(corner, _PATCH * side, np.array([0.0, 0.0, _PATCH]), (len(along), len(up)))
    hits, ray, out = grid_hits(mesh, grid)
    faces = _gripped_material(hits, ray, out, len(along) * len(up)).reshape(len(along), len(up), 4)
    middle = faces[len(along) // 2]
    if np.isnan(faces[:, :, 0]).all() or np.isnan(middle[:, 0]).all():
        (x0, y0), (x1, y1) = mesh.bounds[:, :2]
        if not (x0 <= place.at[0] <= x1 and y0 <= place.at[1] <= y1):
            allowed = f"a point of the mesh, which spans x {x0:.4g} to {x1:.4g} and y {y0:.4g} to {y1:.4g} m"
            raise InvalidValueError(field, list(place.at), allowed)
        allowed = f"a point of the object between {PAD_HEIGHT[0] * 1e3:g} and {PAD_HEIGHT[1] * 1e3:g} mm high"
        raise InvalidValueError(field, list(place.at), allowed)
    low, high = np.nanmin(faces[:, :, 0]), np.nanmax(faces[:, :, 1])
    if high - low > STROKE:
        raise InvalidValueError(
            field,
            f"{(high - low) * 1e3:.0f} mm across",
            f"a place that the gripper can take: it opens to {STROKE * 1e3:g} mm",
        )
    clear = np.nanmin([(low + high) / 2 - faces[:, :, 2], faces[:, :, 3] - (low + high) / 2])
    free, needed = 2 * (clear - FINGER_DEPTH), float(high - low) + SPARE_OPENING
    if free < min(needed, STROKE):
        given = f"the object again {max(clear, 0.0) * 1e3:.3g} mm beside the middle of {place.name}"
        raise InvalidValueError(field, given, f"{needed * 500 + FINGER_DEPTH * 1e3:.3g} mm free for the open fingers")
    touching = (faces[:, :, 0] < low + TOUCH) & (faces[:, :, 1] > high - TOUCH)
    rows, columns = along[touching.any(axis=1)], up[touching.any(axis=0)]
    if not len(rows):
        allowed = "two faces across from each other, at one height and parallel, for the pads to rest on"
        raise InvalidValueError(field, list(place.at), allowed)
    return Grasp(
        place.name,
        np.array(place.at) + closing[:2] * (low + high) / 2,
        angle=place.closing,
        width=float(high - low),
        length=float(rows[-1] - rows[0] + _PATCH),
        bottom=float(columns[0] - _PATCH / 2),
        top=float(columns[-1] + _PATCH / 2),
        # midway between the least opening and the obstacle
        opening=None if free >= STROKE else float(free + needed) / 2,
    )


def _gripped_material(
    hits: Float[np.ndarray, "H"], ray: Int[np.ndarray, "H"], out: Int[np.ndarray, "H"], rays: int
) -> Float[np.ndarray, "rays 4"]:
    """Ends of the material about 0 on each ray, then the end of that before it and the begin of that after it [m].

    NaN without material at 0. Bodies that overlap or touch count as one, and a slot too narrow for a finger as filled.
    """
    order = np.lexsort((out, hits, ray))
    hits, ray, out = hits[order], ray[order], out[order]
    depth = -np.cumsum(out)  # 0 again after each ray: the surface is closed
    begins, ends = (depth == 1) & (out == -1), (depth == 0) & (out == 1)
    begin, end, own = hits[begins], hits[ends], ray[begins]
    apart = (begin[1:] - end[:-1] > FINGER_DEPTH) | (own[1:] != own[:-1])
    first, last = np.append(True, apart)[: len(own)], np.append(apart, True)[: len(own)]
    begin, end, own = begin[first], end[last], own[first]
    inside = np.flatnonzero((begin <= 0) & (end >= 0))
    before, after = np.append(-1, own[:-1])[inside] == own[inside], np.append(own[1:], -1)[inside] == own[inside]
    found = np.full((rays, 4), np.nan)
    found[own[inside]] = np.column_stack(
        [
            begin[inside],
            end[inside],
            np.where(before, np.roll(end, 1)[inside], -np.inf),
            np.where(after, np.roll(begin, -1)[inside], np.inf),
        ]
    )
    return found
