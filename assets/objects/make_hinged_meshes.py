"""The meshes of the shears, the folding rule and the saw, written beside this file.

python assets/objects/make_hinged_meshes.py

Millimetres here and metres in the files, z up, lying on the table z = 0; each part is a plate or a few. Where two links
meet they overlap by half laps about the hinge: a round plate of one lies under that of the other.
"""

from __future__ import annotations

from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import CrossSection, Manifold

LAP_POINTS = 40
"""Corners of a round plate."""
PLAY = 0.2
"""Room about a lap."""
SHEARS_OPEN = 30.0
"""Angle of each half of the shears from the middle [deg]."""
SHEARS_HEIGHT, SHEARS_LAP = 12.0, 12.5
"""Height of the shears, and radius of their lap."""
BLADE, HANDLE = (100.0, 13.0, 9.0), (85.0, 12.0, 14.0)
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
    return {f"{name}.stl": _mesh(body) for name, body in (shears() | folding_rule() | saw()).items()}


def shears() -> dict[str, Manifold]:
    """Two halves that cross at the hinge in the origin, blades towards +x; the first one's lap is the lower."""
    high, radius = SHEARS_HEIGHT, SHEARS_LAP
    long, wide, narrow = HANDLE
    found = {}
    for name, turn, upper in (("a", SHEARS_OPEN, False), ("b", -SHEARS_OPEN, True)):
        blade = Manifold.extrude(bar(0.0, *BLADE) + disc(radius), high) - _lap(radius, high, upper)
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
