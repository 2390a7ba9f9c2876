"""Mesh objects: a closed surface for each mass group, cut into particles by a square grid."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from jaxtyping import Bool, Float, Int
from manifold3d import Error, JoinType, Manifold, Mesh64
from scipy.spatial.distance import cdist

from testbed.errors import InvalidValueError, short
from testbed.files import read_file
from testbed.objects.chain import Chain
from testbed.objects.grasps import GraspPlace, grasp_at
from testbed.objects.model import TOUCH, MassDistribution, ObjectModel, ObjectShape, Solid
from testbed.objects.rays import OFF_CENTER, RayGrid, grid_hits
from testbed.validation import check_integer

if TYPE_CHECKING:
    import trimesh

logging.getLogger("trimesh").addHandler(logging.NullHandler())  # heft reports its errors
FORMATS = ("stl", "obj", "ply", "off")
"""Formats of a mesh: single files that hold a surface and nothing else."""
MOST_FACES = 100_000
"""Largest number of triangles of a part."""
MOST_MESH_BYTES = 8 * 2**20
"""Largest mesh file: of `MOST_FACES` binary STL takes 5 MB."""
LARGEST = 10.0
"""Largest coordinate of a mesh [m]."""
TIP_REACH = 0.016
"""Height over the table below which an upright fingertip meets an object [m]."""
_GAP, _FINE = 3e-4, 1e-4
"""Widest gap between parts that an outline closes, and greatest error of its simplification [m]."""
_RAYS = 7
"""Rays along a cell's side."""
_MOST_CELLS = 5000


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


@np.errstate(all="ignore")
def read_mesh(path: Path) -> trimesh.Trimesh:
    """Mesh from a file [m].

    Raises:
        InvalidValueError: no such file, not a mesh, or not watertight.
    """
    import trimesh  # noqa: PLC0415  slow to import, and only mesh objects need it

    kind = path.suffix.lower().removeprefix(".")
    if kind not in FORMATS:
        raise InvalidValueError("file", path.name, f"a mesh file: {', '.join(FORMATS)}")
    if not path.is_file():
        raise InvalidValueError("file", path.name, f"a mesh file beside the object's; there is none in {path.parent}")
    try:
        # from its bytes: a reader then opens no other file, and unpacks none
        mesh = trimesh.load_mesh(BytesIO(read_file(path, MOST_MESH_BYTES)), file_type=kind, process=False)
        if not isinstance(mesh, trimesh.Trimesh) or len(mesh.faces) == 0:
            raise ValueError("no triangles in it")
        check_triangles(mesh)
    except OSError as error:
        raise InvalidValueError("file", path.name, f"a mesh file that can be read: {error.strerror}") from None
    except Exception as error:  # each of trimesh's readers raises its own
        raise InvalidValueError("file", path.name, f"a mesh that trimesh reads; it says: {short(error, str)}") from None
    if len(mesh.faces) > MOST_FACES:
        raise InvalidValueError("file", f"{path.name} of {len(mesh.faces)} triangles", f"at most {MOST_FACES}")
    if not (np.abs(mesh.bounds) < LARGEST).all():
        given = f"{path.name} with a coordinate of {np.abs(mesh.bounds).max():.3g} m"
        raise InvalidValueError("file", given, f"meters, below {LARGEST:g}")
    if not mesh.is_volume:  # corners of its own for every triangle, as in STL
        mesh.merge_vertices()
    if not mesh.is_volume:
        raise InvalidValueError(
            "file", path.name, "a watertight mesh: every edge between two triangles, all facing outwards"
        )
    return mesh


def check_triangles(mesh: trimesh.Trimesh) -> None:
    """Raise ValueError for triangles of vertices that do not exist or are not finite."""
    faces = np.asarray(mesh.faces)
    if faces.shape[1:] != (3,) or mesh.vertices.shape[1:] != (3,):
        raise ValueError(f"corners of {mesh.vertices.shape[-1]} coordinates, faces of {faces.shape[-1]} corners")
    if faces.min() < 0 or faces.max() >= len(mesh.vertices):
        raise ValueError(f"a triangle of vertex {faces.max() if faces.min() >= 0 else faces.min()}")
    if not np.isfinite(mesh.vertices).all():
        raise ValueError("coordinates that are not finite")


def mesh_object(
    name: str,
    parts: list[Part],
    places: list[GraspPlace],
    *,
    friction: list[float],
    cell: float,
    grid: int,
    contacts: Sequence[tuple[float, float]] = (),
    chain: Chain | None = None,
) -> ObjectModel:
    """An object of meshes as particles, solids and grasps.

    A cell is a particle if the parts cover half of it or more; it belongs to the part with most material in it. A part
    too thin for that has the cells that it covers best. A cell touches if the underside of its part is within `TOUCH`
    of the table over half of it or more. With `contacts` no cell touches: a particle without material lies at each,
    and the cells of each part are shifted until they have its center of mass. Every link has cells of its own, also
    where two links overlap.

    Args:
        name: the object's name.
        parts: its mass groups.
        places: grasps of a gripper.
        friction: friction coefficient of each friction group.
        cell: side of a particle's cell at the default grid, m.
        grid: fineness: the cell's side is cell * 3 / grid. The origin is the mean of the cells of the default grid, so
            that an object has the same frame at every grid.
        contacts: points on which one rigid body rests, x and y of the mesh, m; empty where it rests on cells.
        chain: links of the parts, with hinges in x and y of the mesh; None of a rigid object.

    Raises:
        InvalidValueError: grid < 1, too many cells, not resting on the table, a part without a particle, a friction
            group without a foot, a contact beside the object, a grasp without opposite faces or without room for the
            fingers.
    """
    check_integer("grid", grid, most=1000)
    lowest = min(part.mesh.bounds[0, 2] for part in parts)
    if abs(lowest) > TOUCH:
        raise InvalidValueError(
            "mesh.parts", f"lowest point at z = {lowest:.4g} m", f"resting on z = 0, to {TOUCH * 1e3:g} mm"
        )
    link = np.zeros(len(parts), dtype=int) if chain is None else chain.link
    centers, group, touches, fill = cells = _partition(parts, link, cell * 3 / grid)
    default_cells = cells if grid == 3 else _partition(parts, link, cell)
    origin = default_cells[0].mean(axis=0)
    if len(contacts):
        points = _checked_contacts(contacts, parts)
        nearest = group[cdist(points, centers).argmin(axis=1)]
        # no foot is under a cell: cells may leave the grid
        centers, origin = _centered(parts, cells), _centered(parts, default_cells).mean(axis=0)
        centers, group = np.vstack([centers, points]), np.append(group, nearest)
        touches = np.append(np.zeros(len(touches), dtype=bool), np.ones(len(points), dtype=bool))
        fill = np.append(fill, np.zeros(len(points)))
    per_group = np.bincount(group, minlength=len(parts))
    friction_group = np.where(touches, np.array([part.friction_group for part in parts])[group], -1)
    if missing := set(range(len(friction))) - set(friction_group.tolist()):
        raise InvalidValueError(
            "mesh.parts.friction_group", f"{sorted(missing)} without a foot", "a part that touches the table in each"
        )
    whole = joined([part.mesh for part in parts])
    sides = _sides([part.mesh for part in parts])
    shape = ObjectShape(
        particles=centers - origin,
        mass_group=group,
        friction_group=friction_group,
        cell=cell * 3 / grid,
        height=float(whole.bounds[1, 2]),
        grasps=tuple(
            grasp_at(whole, place, f"mesh.grasps.{index}.at_m").moved(-origin) for index, place in enumerate(places)
        ),
        group_names=tuple(part.name for part in parts),
        fill=fill * per_group[group],
        chain=None if chain is None else replace(chain, hinges=chain.hinges - origin),
        sides=sides - origin,
    )
    mass = np.array([part.mass for part in parts])
    solids = tuple(Solid(part.mesh.vertices - [*origin, 0.0], part.mesh.faces, part.mass) for part in parts)
    return ObjectModel(name, shape, MassDistribution(mass / per_group, np.asarray(friction)), solids)


def manifold(vertices: Float[np.ndarray, "V 3"], faces: Int[np.ndarray, "F 3"]) -> Manifold | None:
    """Closed body of triangles; None if an edge has unequal numbers of triangles in its two directions."""
    made = Manifold(Mesh64(np.array(vertices, dtype=float, order="C"), np.array(faces, dtype=np.uint64, order="C")))
    return made if made.status() == Error.NoError and not made.is_empty() else None


def joined(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Several surfaces as one, without merging their vertices."""
    import trimesh  # noqa: PLC0415

    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=True)]
    return trimesh.Trimesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces), process=False)


def _sides(meshes: Sequence[trimesh.Trimesh]) -> Float[np.ndarray, "K 2 2"]:
    """Sides of the outline below `TIP_REACH`, projected on the table; empty for a self-intersecting surface."""
    projections = []
    for mesh in meshes:
        body = manifold(mesh.vertices, mesh.faces)
        if body is None:
            return np.ones((0, 2, 2))
        projections.append(body.trim_by_plane((0, 0, -1), -TIP_REACH).project())
    outline = sum(projections[1:], projections[0])
    for offset in (_GAP, -_GAP):
        outline = outline.offset(offset, JoinType.Round)
    loops = [np.asarray(loop) for loop in outline.simplify(_FINE).to_polygons()]
    return np.concatenate([np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in loops])


def _checked_contacts(contacts: Sequence[tuple[float, float]], parts: list[Part]) -> Float[np.ndarray, "C 2"]:
    points = np.array(contacts, dtype=float)
    low = np.min([part.mesh.bounds[0, :2] for part in parts], axis=0) - TOUCH
    high = np.max([part.mesh.bounds[1, :2] for part in parts], axis=0) + TOUCH
    for index, point in enumerate(points):
        if not ((low <= point) & (point <= high)).all():
            allowed = f"a point under the mesh: x {low[0]:.4g} to {high[0]:.4g}, y {low[1]:.4g} to {high[1]:.4g} m"
            raise InvalidValueError(f"mesh.contacts_m.{index}", point.tolist(), allowed)
    return points


Cells = tuple[Float[np.ndarray, "P 2"], Int[np.ndarray, "P"], Bool[np.ndarray, "P"], Float[np.ndarray, "P"]]
"""Centers of particles in the mesh's x and y [m], the part of each, True for contact, and its share of the part."""


def _centered(parts: list[Part], cells: Cells) -> Float[np.ndarray, "n 2"]:
    """Centers of cells, those of each part shifted to its center of mass [m]."""
    centers, group, _, fill = cells
    shifts = [part.mesh.center_mass[:2] - fill[group == g] @ centers[group == g] for g, part in enumerate(parts)]
    return centers + np.array(shifts)[group]


def _partition(parts: list[Part], link: Int[np.ndarray, "n_m"], cell: float) -> Cells:
    """Particles of all parts on one grid, computed for each link separately."""
    low = np.min([part.mesh.bounds[0, :2] for part in parts], axis=0)
    high = np.max([part.mesh.bounds[1, :2] for part in parts], axis=0)
    found = []
    for index in range(int(link.max()) + 1):
        own = np.flatnonzero(link == index)
        centers, group, touches, fill = _cells([parts[part] for part in own], cell, low, high)
        found.append((centers, own[group], touches, fill))
    centers, group, touches, fill = (np.concatenate(each) for each in zip(*found, strict=True))
    return centers, group, touches, fill


def _cells(parts: list[Part], cell: float, low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"]) -> Cells:
    """Particles of parts that do not move against each other, on a grid between two corners.

    Material of a part in a cell of another part is added to its own nearest cell.
    """
    count = np.ceil((high - low) / cell - 1e-3).astype(int)  # a length of whole cells needs no cell more
    if count.prod() > _MOST_CELLS:
        allowed = f"at most {_MOST_CELLS} cells; take larger ones, and check the unit of the mesh"
        raise InvalidValueError("mesh.cell_m", f"{count[0]} x {count[1]} cells of {cell:g} m", allowed)
    ticks = [(high[k] + low[k]) / 2 + (np.arange(count[k]) - (count[k] - 1) / 2) * cell for k in (0, 1)]
    centers = np.stack(np.meshgrid(*ticks, indexing="ij"), axis=-1).reshape(-1, 2)
    step, rays = cell / _RAYS, count * _RAYS
    first = [ticks[k][0] + ((0.5 / _RAYS - 0.5) + OFF_CENTER[k]) * cell for k in (0, 1)]
    grid = RayGrid(np.array([*first, 0.0]), np.array([step, 0, 0]), np.array([0, step, 0]), (rays[0], rays[1]))
    material = np.zeros((len(parts), rays.prod()))
    underside = np.full((len(parts), rays.prod()), np.inf)
    for index, part in enumerate(parts):
        height, ray, out = grid_hits(part.mesh, grid)
        np.add.at(material[index], ray, out * height)
        np.minimum.at(underside[index], ray, height)
    # (part, ray) to (part, cell, ray)
    material, underside = (
        each.reshape(len(parts), count[0], _RAYS, count[1], _RAYS).swapaxes(2, 3).reshape(len(parts), len(centers), -1)
        for each in (material, underside)
    )
    material = np.maximum(material, 0.0)  # negative for some rays through a self-intersecting surface
    covered = (material > 0).any(axis=0).mean(axis=1)
    columns = material.sum(axis=2)
    owner = columns.argmax(axis=0)
    touching = (underside < TOUCH).mean(axis=2)[owner, np.arange(len(centers))]
    kept = covered >= 0.5
    for index, held in enumerate(columns):
        if not held.any():
            allowed = f"a part that is wider than the rays' distance, {step * 1e3:.2g} mm, or a smaller cell_m"
            raise InvalidValueError(f"mesh.parts.{index}", f"{parts[index].name} without a particle", allowed)
        if not (owner == index)[held > 0].any():  # within cells of others: assign the one with most of its material
            spare = np.bincount(owner[held > 0], minlength=len(parts))[owner] > 1
            owner[np.where(spare, held, 0).argmax()] = index
        own = (owner == index) & (held > 0)
        if held[own & kept].sum() < held.sum() / 2:
            kept |= own & (covered >= covered[own].max() / 2)
    fill = np.zeros(len(centers))
    for index, held in enumerate(columns):
        own, full = np.flatnonzero(kept & (owner == index)), np.flatnonzero(held > 0)
        if not len(own):
            allowed = f"a cell of each part; take a smaller cell_m than {cell:g}"
            raise InvalidValueError(f"mesh.parts.{index}", f"{parts[index].name} without a particle", allowed)
        nearest = own[cdist(centers[full], centers[own]).argmin(axis=1)]
        fill += np.bincount(nearest, held[full] / held.sum(), len(centers))
    touches = touching >= np.where(covered >= 0.5, 0.5, covered / 2)
    return centers[kept], owner[kept], touches[kept], fill[kept]
