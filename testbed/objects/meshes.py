"""Mesh objects: a closed surface for each mass group, cut into particles by a square grid."""

from __future__ import annotations

from dataclasses import dataclass
from io import BytesIO
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Bool, Float, Int
from scipy.spatial.distance import cdist

from testbed.errors import InvalidValueError, short
from testbed.files import read_file
from testbed.objects.model import (
    FINGER_DEPTH,
    PAD_HEIGHT,
    PAD_WIDTH,
    STROKE,
    Grasp,
    MassDistribution,
    ObjectModel,
    ObjectShape,
    Solid,
)
from testbed.validation import check_integer

TOUCH = 0.001
"""Distance within which a surface touches the table, and a soft pad a face [m]."""
FORMATS = ("stl", "obj", "ply", "off")
"""Formats of a mesh: single files that hold a surface and nothing else."""
MOST_FACES = 100_000
"""Largest number of triangles of a part."""
MOST_MESH_BYTES = 8 * 2**20
"""Largest mesh file: of `MOST_FACES` binary STL takes 5 MB."""
LARGEST = 10.0
"""Largest coordinate of a mesh [m]."""
_RAYS = 7
"""Rays along a cell's side."""
_MOST_CELLS = 5000
_ASIDE = np.array([0.00137, 0.00071])
"""Shift of the rays in cells, so that none runs along an edge of a mesh that is symmetric about the grid."""
_PATCH = 0.001
"""Distance of the rays that find a grasp's faces [m]."""


@dataclass(frozen=True, eq=False)
class Part:
    """Mass group of an object that rests on the table z = 0."""

    name: str
    mesh: trimesh.Trimesh
    """Watertight surface [m]."""
    mass: float
    """Mass [kg]."""
    friction_group: int
    """Friction group of its feet."""


@dataclass(frozen=True)
class GraspPlace:
    """Place to grip the object; width and height of its faces follow from the mesh."""

    name: str
    at: tuple[float, float]
    """Point between the pads [m], x and y of the mesh."""
    closing: float
    """Direction along which the pads close [rad]."""


def read_mesh(path: Path) -> trimesh.Trimesh:
    """Mesh from a file [m].

    Raises:
        InvalidValueError: no such file, not a mesh, or not watertight.
    """
    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise InvalidValueError("file", path.name, f"a mesh file: {', '.join(FORMATS)}")
    if not path.is_file():
        raise InvalidValueError("file", path.name, f"a mesh file beside the object's; there is none in {path.parent}")
    try:
        # from its bytes: a reader then opens no other file, and unpacks none
        mesh = trimesh.load_mesh(BytesIO(read_file(path, MOST_MESH_BYTES)), file_type=kind)
    except OSError as error:
        raise InvalidValueError("file", path.name, f"a mesh file that can be read: {error.strerror}") from None
    except Exception as error:  # each of trimesh's readers raises its own
        raise InvalidValueError("file", path.name, f"a mesh that trimesh reads; it says: {short(error, str)}") from None
    if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
        raise InvalidValueError("file", path.name, "a mesh with triangles")
    if len(mesh.faces) > MOST_FACES:
        raise InvalidValueError("file", f"{path.name} of {len(mesh.faces)} triangles", f"at most {MOST_FACES}")
    if not (np.abs(mesh.bounds) < LARGEST).all():
        given = f"{path.name} with a coordinate of {np.abs(mesh.bounds).max():.3g} m"
        raise InvalidValueError("file", given, f"metres, below {LARGEST:g}")
    if not mesh.is_volume:
        raise InvalidValueError(
            "file", path.name, "a watertight mesh: every edge between two triangles, all facing outwards"
        )
    return mesh


def mesh_object(
    name: str, parts: list[Part], places: list[GraspPlace], *, friction: list[float], cell: float, grid: int
) -> ObjectModel:
    """An object of meshes as particles, solids and grasps.

    A cell is a particle where the parts fill half of it or more, of the part with most material in it; it touches where
    that part's underside is within `TOUCH` of the table over half of it or more.

    Args:
        name: the object's name.
        parts: its mass groups.
        places: where a gripper may take it.
        friction: friction coefficient of each friction group.
        cell: side of a particle's cell at the default grid, m.
        grid: how fine: the cell's side is cell * 3 / grid. The origin stays that of the default grid, the mean of its
            particles, so that one object cut twice has one frame.

    Raises:
        InvalidValueError: grid < 1, too many cells, not resting on the table, a part without a particle or a foot, a
            grasp where there is nothing to hold or no room for the fingers.
    """
    check_integer("grid", grid, most=1000)
    lowest = min(part.mesh.bounds[0, 2] for part in parts)
    if abs(lowest) > TOUCH:
        raise InvalidValueError(
            "mesh.parts", f"lowest point at z = {lowest:.4g} m", f"resting on z = 0, to {TOUCH * 1e3:g} mm"
        )
    centres, group, touches, fill = _partition(parts, cell * 3 / grid)
    per_group = np.bincount(group, minlength=len(parts))
    for index, part in enumerate(parts):
        for what, found in (("particle", per_group[index]), ("foot", (touches & (group == index)).sum())):
            if not found:
                allowed = f"a part that fills and touches at least one cell of {cell * 3 / grid * 1e3:g} mm"
                raise InvalidValueError(f"mesh.parts.{index}", f"{part.name} without a {what}", allowed)
    coarse = centres if grid == 3 else _partition(parts, cell)[0]
    if not len(coarse):
        raise InvalidValueError("mesh.cell_m", cell, "a cell that the parts fill somewhere")
    origin = coarse.mean(axis=0)
    whole = _joined([part.mesh for part in parts])
    shape = ObjectShape(
        particles=centres - origin,
        mass_group=group,
        friction_group=np.where(touches, np.array([part.friction_group for part in parts])[group], -1),
        cell=cell * 3 / grid,
        height=float(whole.bounds[1, 2]),
        grasps=tuple(_grasp(whole, place, origin, index) for index, place in enumerate(places)),
        group_names=tuple(part.name for part in parts),
        fill=fill * per_group[group],
    )
    mass = np.array([part.mass for part in parts])
    solids = tuple(Solid(part.mesh.vertices - [*origin, 0.0], part.mesh.faces, part.mass) for part in parts)
    return ObjectModel(name, shape, MassDistribution(mass / per_group, np.asarray(friction)), solids)


def _joined(meshes: list[trimesh.Trimesh]) -> trimesh.Trimesh:
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return trimesh.Trimesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces), process=False)


def _partition(
    parts: list[Part], cell: float
) -> tuple[Float[np.ndarray, "P 2"], Int[np.ndarray, "P"], Bool[np.ndarray, "P"], Float[np.ndarray, "P"]]:
    """Centres of the particles in the mesh's x and y, the part of each, whether it touches, and how much of it it is.

    What a part has in cells that are not its own is counted to the nearest that is.
    """
    low = np.min([part.mesh.bounds[0, :2] for part in parts], axis=0)
    high = np.max([part.mesh.bounds[1, :2] for part in parts], axis=0)
    count = np.ceil((high - low) / cell - 1e-3).astype(int)  # a length of whole cells needs no cell more
    if count.prod() > _MOST_CELLS:
        allowed = f"at most {_MOST_CELLS} cells; take a larger cell_m, and meshes in metres"
        raise InvalidValueError("mesh.cell_m", f"{count[0]} x {count[1]} cells of {cell:g} m", allowed)
    ticks = [(high[k] + low[k]) / 2 + (np.arange(count[k]) - (count[k] - 1) / 2) * cell for k in (0, 1)]
    centres = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    steps = (np.arange(_RAYS) + 0.5) / _RAYS - 0.5
    offsets = (np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1).reshape(-1, 2) + _ASIDE) * cell
    points = (centres[:, None] + offsets).reshape(-1, 2)
    below = min(part.mesh.bounds[0, 2] for part in parts) - 1.0
    material = np.zeros((len(parts), len(points)))
    underside = np.full((len(parts), len(points)), np.inf)
    for index, part in enumerate(parts):
        bounds = part.mesh.bounds[:, :2]
        over = np.flatnonzero(((points >= bounds[0]) & (points <= bounds[1])).all(axis=1))
        origins = np.column_stack([points[over], np.full(len(over), below)])
        hits, ray, out = _hits(part.mesh, origins, np.array([0.0, 0.0, 1.0]))
        whole = np.bincount(ray, out, len(over)) == 0  # a ray along an edge may miss one side of it
        np.add.at(material[index], over[ray], out * hits * whole[ray])
        np.minimum.at(underside[index], over[ray], hits + below)
    per_cell = (len(parts), len(centres), -1)
    covered = (material > 0).any(axis=0).reshape(per_cell[1:]).mean(axis=1)
    columns = material.reshape(per_cell).sum(axis=2)
    owner = columns.argmax(axis=0)
    touching = (underside < TOUCH).reshape(per_cell).mean(axis=2)[owner, np.arange(len(centres))]
    kept = covered >= 0.5
    fill = np.zeros(len(centres))
    for index, held in enumerate(columns):
        own, full = np.flatnonzero(kept & (owner == index)), np.flatnonzero(held > 0)
        if len(own):
            nearest = own[cdist(centres[full], centres[own]).argmin(axis=1)]
            fill += np.bincount(nearest, held[full] / held.sum(), len(centres))
    return centres[kept], owner[kept], (touching >= 0.5)[kept], fill[kept]


def _hits(
    mesh: trimesh.Trimesh, origins: Float[np.ndarray, "N 3"], along: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "H"], Int[np.ndarray, "H"], Int[np.ndarray, "H"]]:
    """Hits of parallel rays with the surface: distance, index of the ray, and 1 out of the body or -1 into it."""
    places, ray, face = mesh.ray.intersects_location(origins, np.tile(along, (len(origins), 1)), multiple_hits=True)
    if not len(ray):
        return np.zeros(0), np.zeros(0, dtype=int), np.zeros(0, dtype=int)
    out = np.sign(mesh.face_normals[face] @ along).astype(int)
    return (places - origins[ray]) @ along, ray, out


def _grasp(mesh: trimesh.Trimesh, place: GraspPlace, origin: Float[np.ndarray, "2"], index: int) -> Grasp:
    """The grasp that the pads find: flat pads rest on what stands out most, and touch what is within `TOUCH` of it."""
    closing = np.array([np.cos(place.closing), np.sin(place.closing), 0.0])
    side = np.array([-closing[1], closing[0], 0.0])
    reach = float(np.abs(mesh.bounds).max()) * 4 + STROKE
    along = np.arange(-PAD_WIDTH / 2 + _PATCH / 2, PAD_WIDTH / 2, _PATCH)
    up = np.arange(PAD_HEIGHT[0] + _PATCH / 2, min(PAD_HEIGHT[1], mesh.bounds[1, 2]), _PATCH)
    s, z = along + _ASIDE[0] * _PATCH, up + _ASIDE[1] * _PATCH
    start = np.array([*place.at, 0.0]) - reach * closing
    origins = start + (s[:, None, None] * side + z[:, None] * [0.0, 0.0, 1.0]).reshape(-1, 3)
    hits, ray, out = _hits(mesh, origins, closing)
    faces = np.array([_held(hits[ray == i] - reach, out[ray == i]) for i in range(len(origins))])
    faces = faces.reshape(len(along), len(up), 4)
    field = f"mesh.grasps.{index}.at_m"
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
    if clear < STROKE / 2 + FINGER_DEPTH:
        given = f"the object again {clear * 1e3:.0f} mm beside the middle of {place.name}"
        raise InvalidValueError(field, given, f"{(STROKE / 2 + FINGER_DEPTH) * 1e3:g} mm free for the open fingers")
    touching = (faces[:, :, 0] < low + TOUCH) & (faces[:, :, 1] > high - TOUCH)
    rows, columns = along[touching.any(axis=1)], up[touching.any(axis=0)]
    if not len(rows):
        allowed = "two faces across from each other, at one height and parallel, for the pads to rest on"
        raise InvalidValueError(field, list(place.at), allowed)
    return Grasp(
        place.name,
        np.array(place.at) - origin + closing[:2] * (low + high) / 2,
        angle=place.closing,
        width=float(high - low),
        length=float(rows[-1] - rows[0] + _PATCH),
        bottom=float(columns[0] - _PATCH / 2),
        top=float(columns[-1] + _PATCH / 2),
    )


_NOTHING = (np.nan, np.nan, np.nan, np.nan)


def _held(hits: Float[np.ndarray, "H"], out: Int[np.ndarray, "H"]) -> tuple[float, float, float, float]:
    """The stretch of material about 0 on one ray: its ends, and where material ends before it and begins after it.

    NaN without material at 0.
    """
    order = np.lexsort((out, hits))
    hits, out = hits[order], out[order]
    depth = -np.cumsum(out)
    begin, end = hits[(depth == 1) & (out == -1)], hits[(depth == 0) & (out == 1)]
    if not len(begin) or len(begin) != len(end):  # unequal: a ray along an edge
        return _NOTHING
    apart = begin[1:] - end[:-1] > 1e-6
    begin, end = begin[np.append(True, apart)], end[np.append(apart, True)]
    inside = np.flatnonzero((begin <= 0) & (end >= 0))
    if not len(inside):
        return _NOTHING
    i = int(inside[0])
    return begin[i], end[i], (end[i - 1] if i else -np.inf), (begin[i + 1] if i + 1 < len(begin) else np.inf)
