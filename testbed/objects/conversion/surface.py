"""Surfaces of mesh files: their unit, closed bodies and labels."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float, Int
from manifold3d import Manifold, OpType
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from testbed.errors import InvalidValueError
from testbed.files import refuse_pointer
from testbed.objects.meshes import manifold
from testbed.objects.model import TOUCH
from testbed.parsing.process import ParserError, parsed

FORMATS = ("stl", "obj", "ply", "off", "glb", "3mf")
"""Formats that are read."""
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254}
"""Length of each unit [m]."""
LONGEST, SHORTEST = 2.0, 0.005
"""Greatest and least length of an object [m]."""
SMALL = 0.005
"""Part of the volume below which loose bodies are left out, and of the surface below which a color is no part."""
MOST_LOST = 0.05
"""Part of the surface, in pieces that enclose nothing, from which a mesh is refused. Ours."""
FINENESS = 5e-5
"""Greatest deviation of a simplified surface [m]."""
SAMPLE = 20_000
"""Points of a surface whose labels are kept."""
_NAMES = {"millimeter": "mm", "millimetre": "mm", "centimeter": "cm", "inch": "in", "meter": "m", "metre": "m"}


@dataclass(frozen=True, eq=False)
class Surface:
    """Closed bodies of one object [m], and labelled points on its surface."""

    bodies: tuple[Manifold, ...]
    """Bodies, largest first; they may overlap or touch."""
    points: Float[np.ndarray, "S 3"]
    """Points of the surface that have a label [m]."""
    labels: Int[np.ndarray, "S"]
    """Label of each point, from 0: its color, or its piece of the file; all 0 without any."""
    of_body: Int[np.ndarray, "S"]
    """Body of each point; -1 of none."""
    notes: tuple[str, ...]
    """Unit and repairs, in words."""

    @cached_property
    def whole(self) -> Manifold:
        """All bodies as one."""
        return Manifold.batch_boolean(list(self.bodies), OpType.Add)

    def transformed(self, matrix: Float[np.ndarray, "3 4"]) -> Surface:
        """The surface after a rotation and a shift."""
        bodies = tuple(body.transform(matrix) for body in self.bodies)
        return replace(self, bodies=bodies, points=self.points @ matrix[:, :3].T + matrix[:, 3])


def read_surface(path: Path, unit: str | None = None) -> Surface:
    """Surface from a file, repaired where it is open.

    Args:
        path: STL, OBJ, PLY, OFF, GLB or 3MF.
        unit: "m", "cm", "mm" or "in"; if left out, as the file states, or else by the size.

    Raises:
        InvalidValueError: no mesh, too large, of no likely size, or so open that it encloses nothing.
    """
    vertices, faces, labels, stated = _load(path)
    scale, notes = _unit(np.ptp(vertices, axis=0).max(), unit, stated)
    vertices = vertices * scale
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    points, face = trimesh.sample.sample_surface(mesh, SAMPLE, seed=0)[:2]
    bodies, owner, mended = _closed(vertices, faces, path.name)
    notes = f"{notes}; {len(bodies)} bod{'ies' if len(bodies) > 1 else 'y'}"
    large = np.bincount(labels[face])[labels] > 4 * SMALL * SAMPLE  # not a print or a mark
    points, face = points[large[face]], face[large[face]]
    return Surface(
        tuple(bodies), points, np.unique(labels[face], return_inverse=True)[1], owner[face], (notes, *mended)
    )


def as_mesh(body: Manifold) -> trimesh.Trimesh:
    """A closed body as vertices and triangles."""
    mesh = body.to_mesh64()
    return trimesh.Trimesh(
        np.asarray(mesh.vert_properties)[:, :3], np.asarray(mesh.tri_verts, dtype=int), process=False
    )


def _load(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, str | None]:
    """Vertices in the file's unit, triangles, their labels, and the unit if the file states it."""
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise InvalidValueError("file", path.name, f"a mesh file: {', '.join(FORMATS)}")
    if not path.is_file():
        raise InvalidValueError("file", str(path), "a mesh file; there is none")
    refuse_pointer(path, "file")
    try:
        with parsed("testbed.parsing.meshes", path.absolute()) as result, np.load(result) as found:
            vertices, faces, labels, unit = (found[name] for name in ("vertices", "faces", "labels", "unit"))
    except ParserError as error:
        raise InvalidValueError("file", path.name, f"a mesh that trimesh reads; {error}") from None
    return vertices, faces, labels, _unit_name(str(unit))


def _unit_name(text: str | None) -> str | None:
    word = (text or "").lower().rstrip("s")
    return next((unit for name, unit in _NAMES.items() if word and name.startswith(word)), text)


def _unit(length: float, unit: str | None, stated: str | None) -> tuple[float, str]:
    """Length of the file's unit [m], and its source in words."""
    if unit is not None and unit not in UNITS:
        raise InvalidValueError("units", unit, ", ".join(UNITS))
    if unit is None and stated in UNITS and SHORTEST <= length * UNITS[stated] <= LONGEST:
        unit, why = stated, "as the file says"
    elif unit is None:
        likely = [name for name in ("m", "mm") if 0.02 <= length * UNITS[name] <= LONGEST]
        if not likely:
            allowed = f"meters or millimeters of an object of 0.02 to {LONGEST:g} m, or --units"
            raise InvalidValueError("file", f"a longest side of {length:.4g}", allowed)
        unit, why = likely[0], f"taken from its longest side of {length:.4g}"
    else:
        why = "as asked"
    if not SHORTEST <= length * UNITS[unit] <= LONGEST:
        given = f"{length * UNITS[unit]:.4g} m long in {unit}"
        raise InvalidValueError("units", given, f"a length of {SHORTEST:g} to {LONGEST:g} m")
    return UNITS[unit], f"unit {unit}, {why}; {length * UNITS[unit] * 1e3:.0f} mm long"


def _closed(
    vertices: np.ndarray, faces: np.ndarray, name: str
) -> tuple[list[Manifold], Int[np.ndarray, "F"], list[str]]:
    """Closed bodies, the largest first, the body of each triangle (-1 of none), and the repairs in words."""
    notes: list[str] = []
    merged, index = np.unique(np.round(vertices, 8), axis=0, return_inverse=True)
    shells: list[tuple[Manifold, np.ndarray]] = []
    component, faces = _stitched(faces, index.ravel()), index.ravel()[faces]
    area, enclosing = trimesh.triangles.area(merged[faces]), np.zeros(len(faces), dtype=bool)
    order = np.argsort(component, kind="stable")
    for part in np.split(order, np.flatnonzero(np.diff(component[order])) + 1):
        shell, mended = _shell(merged, faces[part])
        notes += [mended] if mended else []
        enclosing[part] = shell is not None
        pieces = shell.decompose() if shell is not None else []
        middles = merged[faces[part]].mean(axis=1)
        near = [KDTree(as_mesh(piece).triangles_center).query(middles)[0] for piece in pieces]
        shells += [(piece, part[np.argmin(near, axis=0) == k]) for k, piece in enumerate(pieces)]
    bodies = sorted(_without_cavities(shells, notes), key=lambda body: -body[0].volume())
    if not bodies:
        raise InvalidValueError("file", name, "a mesh that encloses a volume, or nearly does")
    if (lost_part := area[~enclosing].sum() / area.sum()) > MOST_LOST:
        given = f"{name}, of which {100 * lost_part:.0f} % of the surface encloses nothing"
        raise InvalidValueError("file", given, f"at most {100 * MOST_LOST:g} %; close its pieces, or join their seams")
    volumes = np.array([body.volume() for body, _ in bodies])
    hull = Manifold.batch_hull([body for body, _ in bodies[: int((volumes >= SMALL * volumes.sum()).sum())]])
    # the object may rest on a small body that protrudes
    small = [
        v < SMALL * volumes.sum() and _protrusion(body, hull) < TOUCH
        for (body, _), v in zip(bodies, volumes, strict=True)
    ]
    if lost := sum(small):
        part = 100 * volumes[small].sum() / volumes.sum()
        notes.append(f"{lost} small bod{'ies' if lost > 1 else 'y'} left out, {part:.2g} % of the volume")
    bodies = [body for body, left_out in zip(bodies, small, strict=True) if not left_out]
    owner = np.full(len(faces), -1)
    for k, (_, part) in enumerate(bodies):
        owner[part] = k
    counts = [f"{n} times {what}" if n > 1 else what for what, n in Counter(notes).items()]
    return [body.simplify(FINENESS) for body, _ in bodies], owner, counts


def _stitched(faces: Int[np.ndarray, "F 3"], index: Int[np.ndarray, "V"]) -> Int[np.ndarray, "F"]:
    """Connected piece of each triangle; pieces with open edges at the same place are one.

    Files split corners at hard edges and seams, or give every triangle its own. Closed bodies that touch stay apart.

    Args:
        faces: vertices of each triangle.
        index: place of each vertex; equal where vertices lie at the same place.
    """
    links = np.vstack([faces[:, [0, 1]], faces[:, [1, 2]]])
    graph = coo_array((np.ones(len(links)), links.T), shape=(len(index), len(index)))
    piece = connected_components(graph, directed=False)[1]
    edges = np.column_stack([np.tile(piece[faces[:, 0]], 3), np.sort(index[_halves(faces)], axis=1)])
    found, copies = np.unique(edges, axis=0, return_counts=True)
    open_ = found[copies == 1]
    pieces, places = int(piece.max()) + 1, int(index.max()) + 1
    owner, at = np.repeat(open_[:, 0], 2), pieces + open_[:, 1:].ravel()
    seams = coo_array((np.ones(len(owner)), (owner, at)), shape=(pieces + places,) * 2)
    return connected_components(seams, directed=False)[1][piece[faces[:, 0]]]


def _protrusion(body: Manifold, hull: Manifold) -> float:
    """Greatest distance of a body beyond a convex one [m]."""
    planes, corners = as_mesh(hull), as_mesh(body.hull()).vertices
    beyond = corners @ planes.face_normals.T - (planes.triangles[:, 0] * planes.face_normals).sum(axis=1)
    return float(beyond.max())


def _shell(vertices: np.ndarray, faces: np.ndarray) -> tuple[Manifold | None, str]:
    """A connected surface as a closed body, or None if it encloses nothing; and the repairs in words."""
    used, faces = np.unique(faces, return_inverse=True)
    vertices, faces = vertices[used], faces.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    found = manifold(vertices, faces)
    if found is not None:
        return found, ""
    mended: list[str] = []
    _, place, copies = np.unique(np.sort(faces, axis=1), axis=0, return_index=True, return_counts=True)
    if (copies > 1).any():  # a copy, or an inner wall of two triangles back to back
        mended.append(f"{int((copies - 1).sum())} doubled triangles taken out")
        for kept in (faces[place[copies % 2 == 1]], faces[place]):
            if (found := manifold(vertices, kept)) is not None:
                return found, mended[0]
        faces = faces[place]
    if len(faces) < 4:
        return None, f"a piece of {len(a)} triangles left out"
    if len(np.unique(halves := _halves(faces), axis=0)) < len(halves):
        mesh = trimesh.Trimesh(vertices, faces, process=False)
        trimesh.repair.fix_winding(mesh)
        faces = np.asarray(mesh.faces)
        mended.append("triangles turned to face one way")
    vertices, faces, holes = _filled(vertices, faces)
    if holes:
        mended.append(f"{holes} hole{'s' * (holes > 1)} filled")
    found = manifold(vertices, faces)
    if found is None:
        return None, f"a piece of {len(a)} triangles that encloses nothing left out"
    return found, ", ".join(mended)


def _halves(faces: np.ndarray) -> Int[np.ndarray, "E 2"]:
    return np.vstack([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])


def _filled(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """Vertices and triangles with every hole covered by a fan about its middle, and the number of holes."""
    halves = _halves(faces)
    code = halves @ [len(vertices), 1]
    kinds, counts = np.unique(code, return_counts=True)
    back = (kinds % len(vertices)) * len(vertices) + kinds // len(vertices)
    at = np.minimum(np.searchsorted(kinds, back), len(kinds) - 1)
    against = np.where(kinds[at] == back, counts[at], 0)
    open_ = np.repeat(kinds, np.maximum(counts - against, 0))
    if not len(open_):
        return vertices, faces, 0
    start, end = (np.asarray(each, dtype=int) for each in np.divmod(open_, len(vertices)))
    links = coo_array((np.ones(len(start)), (start, end)), shape=(len(vertices), len(vertices)))
    of_vertex = np.asarray(connected_components(links, directed=False)[1], dtype=int)
    hole = np.unique(of_vertex[start], return_inverse=True)[1]
    middles = np.array([vertices[start[hole == k]].mean(axis=0) for k in range(hole.max() + 1)])
    fans = np.column_stack([end, start, len(vertices) + hole])
    return np.vstack([vertices, middles]), np.vstack([faces, fans]), len(middles)


def _without_cavities(shells: list[tuple[Manifold, np.ndarray]], notes: list[str]) -> list[tuple[Manifold, np.ndarray]]:
    """Bodies of shells: one that faces inwards is a cavity of the body around it, or else was inside out."""
    bodies = [(shell, part) for shell, part in shells if shell.volume() > 0]
    for shell, part in shells:
        if shell.volume() >= 0:
            continue
        mesh = as_mesh(shell)
        turned = manifold(mesh.vertices, mesh.faces[:, ::-1])
        if turned is None:
            continue
        held = [k for k, (body, _) in enumerate(bodies) if (body ^ turned).volume() > 0.99 * turned.volume()]
        if held:
            body, faces = bodies[held[0]]
            bodies[held[0]] = body - turned, np.append(faces, part)
        else:
            notes.append("a body turned inside out")
            bodies.append((turned, part))
    return bodies
