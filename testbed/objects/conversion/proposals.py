"""Grasps proposed for a body on the table: pairs of opposite faces that fit between the pads of the gripper."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh
from jaxtyping import Float
from manifold3d import Manifold

from testbed.errors import InvalidValueError
from testbed.objects.grasps import GraspPlace, grasp_at
from testbed.objects.model import FINGER_DEPTH, LEAST_FACE, PAD_HEIGHT, SPARE_OPENING, STROKE

SPACING = 0.004
"""Distance between the points of an outline at which candidates begin [m]."""
LEVELS = 7
"""Heights at which an outline is taken."""
PARALLEL = np.cos(np.radians(12))
"""Cosine of the greatest angle between two gripped faces."""
MOST_TRIED = 150
"""Candidates that are tried, at most."""
APART = 0.012
"""Least distance between two proposed grasps [m]."""
ALIKE = 0.006, np.pi / 9
"""Widths of the bins in position [m] and angle [rad] of which one candidate is tried."""
LEAST_LENGTH = 0.004
"""Least length of a gripped face [m]."""


def propose_grasps(
    whole: Manifold, mesh: trimesh.Trimesh, middle: Float[np.ndarray, "2"], most: int
) -> tuple[list[GraspPlace], str]:
    """Grasps spread over a body, the first nearest its middle; and the reason why the last refused candidate failed.

    Args:
        whole: the body on the table z = 0.
        mesh: its parts as triangles.
        middle: near the center of mass, m.
        most: number of places.
    """
    if mesh.bounds[1, 2] < PAD_HEIGHT[0] + LEAST_FACE:
        given, least = mesh.bounds[1, 2] * 1e3, (PAD_HEIGHT[0] + LEAST_FACE) * 1e3
        return [], f"{given:.1f} mm high, and the pads need {least:g} mm: another side down, or no grasp"
    pairs: dict[tuple[int, ...], tuple[np.ndarray, float]] = {}  # the most parallel pair of each bin
    for center, angle, _ in sorted(_pairs(whole, mesh), key=lambda pair: pair[2]):
        pairs[*np.round(center / ALIKE[0]).astype(int).tolist(), round(angle / ALIKE[1])] = center, angle
    centers = np.array([center for center, _ in pairs.values()]).reshape(-1, 2)
    angles = [angle for _, angle in pairs.values()]
    places: list[GraspPlace] = []
    refused = ""
    left = np.ones(len(centers), dtype=bool)
    while left.any() and len(places) < most and (~left).sum() < MOST_TRIED:
        chosen = np.array([place.at for place in places])
        away = np.linalg.norm(centers - middle, axis=1)
        score = -away if not places else np.linalg.norm(centers[:, None] - chosen, axis=2).min(axis=1)
        best = int(np.where(left, score, -np.inf).argmax())
        left[best] = False
        if places and score[best] < APART:
            break
        (x, y), degrees = np.round(centers[best], 4).tolist(), round(float(np.degrees(angles[best])), 1) % 180
        place = GraspPlace(f"grasp_{len(places) + 1}", (x, y), float(np.radians(degrees)))
        try:
            grasp = grasp_at(mesh, place, "grasp")
        except InvalidValueError as error:
            refused = f"{error.given}; the gripper needs {error.allowed}"
            continue
        top = mesh.bounds[1, 2] if grasp.top is None else grasp.top
        if top < max(grasp.bottom, PAD_HEIGHT[0]) + LEAST_FACE - 1e-9:
            refused = f"faces {(top - grasp.bottom) * 1e3:.1f} mm high"
        elif grasp.width > STROKE - SPARE_OPENING or grasp.length < LEAST_LENGTH:
            refused = f"faces {grasp.width * 1e3:.0f} mm apart and {grasp.length * 1e3:.0f} mm long"
        else:
            places.append(place)
    return places, refused


def _pairs(whole: Manifold, mesh: trimesh.Trimesh) -> Iterator[tuple[np.ndarray, float, float]]:
    """Midpoints between two faces of an outline [m], their closing direction [rad], and the cosine of their angle."""
    top = min(PAD_HEIGHT[1], float(mesh.bounds[1, 2]))
    for height in PAD_HEIGHT[0] + (top - PAD_HEIGHT[0]) * (np.arange(LEVELS) + 0.5) / LEVELS:
        loops = [np.asarray(loop) for loop in whole.slice(float(height)).to_polygons()]
        if not loops:
            continue
        start, end = (np.vstack([np.roll(loop, -k, axis=0) for loop in loops]) for k in (0, 1))
        length = np.linalg.norm(end - start, axis=1)
        start, end, length = start[length > 1e-7], end[length > 1e-7], length[length > 1e-7]
        along = (end - start) / length[:, None]
        normal = np.column_stack([along[:, 1], -along[:, 0]])  # outlines run anticlockwise, holes clockwise
        ticks = np.arange(SPACING / 2, length.sum(), SPACING)
        which = np.searchsorted(np.cumsum(length), ticks)
        points = start[which] + (ticks - (np.cumsum(length) - length)[which])[:, None] * along[which]
        for point, own in zip(points, which, strict=True):
            inward = -normal[own]
            across = along @ [-inward[1], inward[0]]
            with np.errstate(divide="ignore", invalid="ignore"):
                offset = (point - start) @ [-inward[1], inward[0]]
                part = offset / across  # m along each segment
            reach = (start + np.nan_to_num(part)[:, None] * along - point) @ inward
            met = (part >= 0) & (part < length) & (np.arange(len(start)) != own)
            order = np.flatnonzero(met)[np.argsort(reach[met])]
            ahead = order[reach[order] > 0][::2], order[reach[order] > 0][1::2]  # out of material, into more
            if not len(ahead[0]) or (reach[order] > -FINGER_DEPTH).sum() > 2 * len(ahead[0]) - 1:
                continue
            gaps = reach[ahead[1]] - reach[ahead[0][: len(ahead[1])]]
            last = int(np.append(gaps > FINGER_DEPTH, True).argmax())  # no finger fits into the slots before it
            other = ahead[0][last]
            met[[*ahead[0][: last + 1], *ahead[1][:last]]] = False
            needed = (reach[other] + SPARE_OPENING) / 2 + FINGER_DEPTH
            free = np.abs(reach[met] - reach[other] / 2).min(initial=np.inf) > needed
            if free and reach[other] < STROKE - SPARE_OPENING and normal[other] @ inward > PARALLEL:
                closing = inward + normal[other]
                angle = np.arctan2(closing[1], closing[0]) % np.pi
                yield point + inward * reach[other] / 2, float(angle), float(normal[other] @ inward)
