"""The meshes of the library's tools, written beside this file: python assets/objects/make_meshes.py

Metres in the files, z up, lying on the table z = 0. The hammer and the wrench are lofts: rings of points, joined one to
the next. Bodies of one part abut in flat faces, the smaller inside the larger, so that no two share an edge and the
volume counts once. Each part of the shears, the folding rule and the saw is a plate or a few, in millimetres here.
Where two links meet they overlap by half laps about the hinge: a round plate of one lies under that of the other.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold
from scipy.interpolate import PchipInterpolator

HEAD = (0.040, 0.110, 0.038)
"""The hammer's head: along the handle, across it, high, m."""
HEAD_CHAMFER = 0.004
# The hammer's handle, mm: from the head's face; half width, half height and height of the axis of its section. Where
# the ellipse would reach below the table it is cut flat. The flat is short and narrow, and not at the very end: the
# handle's centre of mass is beside it, and with more feet, further off, the tilt would lift some of them.
HANDLE = np.array(
    [
        (0, 11.0, 10.5, 19.0),
        (50, 13.0, 12.5, 18.5),
        (100, 16.5, 15.8, 18.8),
        (115, 17.6, 16.8, 18.4),
        (128, 18.2, 17.3, 17.7),
        (134, 18.4, 17.5, 17.3),
        (156, 18.6, 17.7, 17.5),
        (164, 18.6, 17.7, 18.0),
        (180, 18.4, 17.4, 18.8),
        (195, 18.0, 17.0, 20.0),
        (205, 15.5, 14.5, 20.0),
        (210, 10.0, 9.5, 20.0),
    ]
)
HANDLE_POINTS, HANDLE_SECTIONS = 28, 22
THICK, CHAMFER = 0.014, 0.001
"""The wrench's heads: thickness and chamfer, m."""
RING_AT, RING_OUTER, RING_INNER = 0.198, 0.022, 0.0115
JAW_OUTER, JAW_HALF_OPENING, JAW_DEPTH, JAW_TURN = 0.0285, 0.0115, 0.017, np.radians(15)
"""The open jaw about the origin: outer radius, half its mouth, how far the prongs reach, turn of the mouth."""
SHANK_MIDDLE, SHANK_Z = 0.100, (0.002, 0.012)
SHANK_WIDTH = (0.020, 0.019, 0.018)
"""Width at the jaw, in the middle and at the ring, m."""

LAP_POINTS = 40
"""Corners of a round plate."""
PLAY = 0.2
"""Room about a lap."""
SHEARS_OPEN = 30.0
"""Angle of each half of the shears from the middle [deg]."""
SHEARS_HEIGHT, SHEARS_LAP = 12.0, 12.5
"""Height of the shears, and radius of their lap."""
SHEARS_BLADE, SHEARS_HANDLE = (100.0, 13.0, 9.0), (85.0, 12.0, 14.0)
"""Blade and handle of the shears: length from the hinge, and width there and at the end."""
RULE_TURN = 55.0
"""Angle of each leg of the rule from the line through all, to either side by turns [deg]."""
LEG = (105.0, 18.0, 10.0)
"""Leg of the rule: length between its ends, width, height."""
SAW_TURN = 25.0
"""Angle of the saw's blade against the handle's axis [deg]."""
SAW_HANDLE, SAW_BOLSTER = (125.0, 24.0, 24.0), 45.0
"""The saw's handle: length from the hinge, width, height; and the end of its bolster."""
SAW_BLADE = (135.0, 30.0, 18.0, 4.0)
"""The saw's blade: length from the hinge, width there and at its tip, height."""


def meshes() -> dict[str, trimesh.Trimesh]:
    """Every part by the name of its file."""
    parts = {"hammer_head": hammer_head(), "hammer_handle": hammer_handle()} | wrench()
    parts |= {name: _mesh(body) for name, body in (shears() | folding_rule() | saw()).items()}
    return {f"{name}.stl": mesh for name, mesh in parts.items()}


def hammer_head() -> trimesh.Trimesh:
    """A block with chamfered edges; x from 0, y about 0."""
    long, wide, high = HEAD
    c = HEAD_CHAMFER
    levels = ((c, 0.0), (0.0, c), (0.0, high - c), (c, high))
    rings = []
    for inset, z in levels:
        a, b = long / 2 - inset, wide / 2 - inset
        corners = [(a, b - c), (a - c, b), (c - a, b), (-a, b - c), (-a, c - b), (c - a, -b), (a - c, -b), (a, c - b)]
        rings.append([(x + long / 2, y, z) for x, y in corners])
    return loft(np.array(rings))


def hammer_handle() -> trimesh.Trimesh:
    """Ellipses along x, from the head's face on, cut flat by the table."""
    section = PchipInterpolator(HANDLE[:, 0], HANDLE[:, 1:])
    ends = np.sin(np.linspace(0, np.pi / 2, HANDLE_SECTIONS))  # closer together where the end is round
    along = np.unique(np.concatenate([HANDLE[-1, 0] * ends, HANDLE[1:-1, 0]]))
    angle = 2 * np.pi * np.arange(HANDLE_POINTS) / HANDLE_POINTS
    rings = []
    for x, (a, b, axis) in zip(along, section(along), strict=True):
        z = np.maximum(axis + b * np.sin(angle), 0.0)
        rings.append(np.column_stack([np.full_like(angle, x), a * np.cos(angle), z]))
    return loft(np.array(rings) / 1e3 + [HEAD[0], 0, 0])


def wrench() -> dict[str, trimesh.Trimesh]:
    """The wrench's two halves, the shank along x cut in its middle."""
    # Directions from a head's centre; the shank meets a flat on the outer side, towards +x at the jaw, -x at the ring
    start, end = np.arctan2(JAW_HALF_OPENING, JAW_DEPTH), 2 * np.pi - np.arctan2(JAW_HALF_OPENING, JAW_DEPTH)
    mouth = np.pi + JAW_TURN
    jaw_flat = np.arcsin((SHANK_WIDTH[0] / 2 + 2 * CHAMFER) / JAW_OUTER)
    ring_flat = np.arcsin((SHANK_WIDTH[2] / 2 + 2 * CHAMFER) / RING_OUTER)
    from_mouth = _angles(start, end, np.pi - JAW_TURN, jaw_flat)
    jaw_inner = np.where(np.cos(from_mouth) > 0, JAW_HALF_OPENING / np.abs(np.sin(from_mouth)), JAW_HALF_OPENING)
    jaw_outer = _with_flat(JAW_OUTER, from_mouth - (np.pi - JAW_TURN), jaw_flat)
    around = _angles(0.0, 2 * np.pi, np.pi, ring_flat)[:-1]
    ring_outer = _with_flat(RING_OUTER, around - np.pi, ring_flat)
    jaw = loft(_sections(from_mouth + mouth, jaw_inner, jaw_outer))
    ring = loft(_sections(around, np.full_like(around, RING_INNER), ring_outer), closed=True)
    ring.apply_translation([RING_AT, 0, 0])
    begin, stop = JAW_OUTER * np.cos(jaw_flat), RING_AT - RING_OUTER * np.cos(ring_flat)
    jaw_shank = loft(np.array([_bar(begin, SHANK_WIDTH[0]), _bar(SHANK_MIDDLE, SHANK_WIDTH[1])]))
    ring_shank = loft(np.array([_bar(SHANK_MIDDLE, SHANK_WIDTH[1]), _bar(stop, SHANK_WIDTH[2])]))
    return {
        "wrench_jaw": trimesh.util.concatenate([jaw, jaw_shank]),
        "wrench_ring": trimesh.util.concatenate([ring, ring_shank]),
    }


def loft(rings: np.ndarray, *, closed: bool = False) -> trimesh.Trimesh:
    """A watertight body through rings of points, (sections, points, 3), capped at both ends or closed into a loop."""
    count, points = rings.shape[:2]
    vertices = rings.reshape(-1, 3)
    faces = []
    for i in range(count if closed else count - 1):
        for j in range(points):
            a, b = i * points + j, i * points + (j + 1) % points
            c, d = ((i + 1) % count) * points + j, ((i + 1) % count) * points + (j + 1) % points
            faces += [(a, b, d), (a, d, c)]
    if not closed:
        for first, centre, turn in ((0, len(vertices), -1), ((count - 1) * points, len(vertices) + 1, 1)):
            faces += [(centre, first + j, first + (j + 1) % points)[::turn] for j in range(points)]
        vertices = np.vstack([vertices, rings[0].mean(axis=0), rings[-1].mean(axis=0)])
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    if mesh.volume < 0:
        mesh.invert()
    return mesh


def _angles(start: float, end: float, flat: float, half: float) -> np.ndarray:
    """Angles from start to end, some 7 degrees apart, with the edges of the flat at `flat` +- `half` among them."""
    knots = [start, flat - half, flat + half, end]
    spans = [np.linspace(a, b, max(round((b - a) / 0.12), 2) + 1) for a, b in pairwise(knots)]
    return np.unique(np.round(np.concatenate(spans), 12))


def _with_flat(radius: float, angle: np.ndarray, half: float) -> np.ndarray:
    """Radius of a circle with a flat of half angle `half` about angle 0."""
    return np.where(np.abs(angle) < half + 1e-9, radius * np.cos(half) / np.cos(angle), radius)


def _sections(angle: np.ndarray, inner: np.ndarray, outer: np.ndarray) -> np.ndarray:
    """Sections of a head, in planes through the z axis: rectangles with chamfered edges, (sections, 8, 3)."""
    c, t = CHAMFER, THICK
    radial = [inner + c, outer - c, outer, outer, outer - c, inner + c, inner, inner]
    height = [0, 0, c, t - c, t, t, t - c, c]
    points = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full_like(angle, z)])
              for r, z in zip(radial, height, strict=True)]  # fmt: skip
    return np.stack(points, axis=1)


def _bar(x: float, width: float) -> list[tuple[float, float, float]]:
    """Section of the shank."""
    a, (low, high), c = width / 2, SHANK_Z, CHAMFER
    corners = [(a - c, low), (a, low + c), (a, high - c), (a - c, high), (c - a, high), (-a, high - c), (-a, low + c)]
    return [(x, y, z) for y, z in [*corners, (c - a, low)]]


def shears() -> dict[str, Manifold]:
    """Two halves that cross at the hinge in the origin, blades towards +x; the first one's lap is the lower."""
    high, radius = SHEARS_HEIGHT, SHEARS_LAP
    long, wide, narrow = SHEARS_HANDLE
    found = {}
    for name, turn, upper in (("a", SHEARS_OPEN, False), ("b", -SHEARS_OPEN, True)):
        blade = Manifold.extrude(bar(0.0, *SHEARS_BLADE) + disc(radius), high) - _lap(radius, high, upper)
        handle = Manifold.extrude(bar(-long, 0.0, narrow, wide) - disc(radius + PLAY), high)
        found |= {f"shears_blade_{name}": blade.rotate((0, 0, turn))}
        found |= {f"shears_handle_{name}": handle.rotate((0, 0, turn))}
    return found


def folding_rule() -> dict[str, Manifold]:
    """Three legs in a zigzag, each with its lower lap towards the next."""
    long, wide, high = LEG
    found = {}
    for index, (begin, end) in enumerate(pairwise(rule_points())):
        flat = bar(0.0, long, wide, wide) + disc(wide / 2) + disc(wide / 2).translate((long, 0))
        body = Manifold.extrude(flat, high)
        if index > 0:
            body -= _lap(wide / 2, high, True)
        if index < 2:
            body -= _lap(wide / 2, high, False).translate((long, 0, 0))
        turn = np.degrees(np.arctan2(*(end - begin)[::-1]))
        found[f"rule_leg_{index + 1}"] = body.rotate((0, 0, float(turn))).translate((*begin, 0))
    return found


def rule_points() -> np.ndarray:
    """Ends and hinges of the rule, shape (4, 2), about their middle."""
    turns = np.radians(RULE_TURN) * np.array([1, -1, 1])
    steps = LEG[0] * np.column_stack([np.cos(turns), np.sin(turns)])
    points = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    return points - points.mean(axis=0)


def saw() -> dict[str, Manifold]:
    """A handle with a bolster along -x, and a thin blade on the table along +x, hinged in the origin."""
    long, wide, high = SAW_HANDLE
    reach, broad, tip, thin = SAW_BLADE
    radius = broad / 2
    bolster = Manifold.extrude(bar(-SAW_BOLSTER, 0.0, wide, wide) + disc(radius), high)
    for low, top in ((-thin, thin), (3 * thin, 2 * high)):  # a tongue of it lies on the blade
        bolster -= Manifold.extrude(disc(radius + PLAY), top - low).translate((0, 0, low))
    grip = Manifold.extrude(bar(-long, -SAW_BOLSTER, wide, wide), high)
    blade = Manifold.extrude(bar(0.0, reach, broad, tip) + disc(radius), thin).rotate((0, 0, SAW_TURN))
    return {"saw_bolster": bolster, "saw_grip": grip, "saw_blade": blade}


def bar(begin: float, end: float, wide: float, narrow: float) -> CrossSection:
    """A bar along x from `begin` to `end`, of two widths there."""
    corners = [(begin, -wide / 2), (end, -narrow / 2), (end, narrow / 2), (begin, wide / 2)]
    return CrossSection([np.array(corners)])


def disc(radius: float) -> CrossSection:
    """A round plate about the origin."""
    return CrossSection.circle(radius, LAP_POINTS)


def _lap(radius: float, high: float, upper: bool) -> Manifold:
    """Room for the other link's lap in a plate: the lower half of its height where this one has the upper."""
    return Manifold.extrude(disc(radius + PLAY), high).translate((0, 0, -high / 2 if upper else high / 2))


def _mesh(body: Manifold) -> trimesh.Trimesh:
    found = body.simplify(1e-3).to_mesh64()  # without slivers, which a file's single precision would tear
    return trimesh.Trimesh(found.vert_properties[:, :3] / 1e3, found.tri_verts, process=False)


if __name__ == "__main__":
    for file, mesh in meshes().items():
        (Path(__file__).parent / file).write_bytes(mesh.export(file_type="stl"))
