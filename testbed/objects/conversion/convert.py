"""Conversion of a mesh file to an object: pose, contacts, parts, cells and grasps, and the folder that holds them."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import trimesh
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.files import write_text, write_whole
from testbed.objects.conversion.parts import cut, labelled
from testbed.objects.conversion.pose import Pose, asked_pose, stable_poses
from testbed.objects.conversion.proposals import propose_grasps
from testbed.objects.conversion.surface import as_mesh, read_surface
from testbed.objects.grasps import GraspPlace
from testbed.objects.meshes import Part, joined, mesh_object
from testbed.objects.model import ObjectModel
from testbed.toml import toml_text
from testbed.validation import check_kilograms, check_positive

CELLS = 150
"""Approximate number of cells of an object."""
CELL = (0.001, 0.01)
"""Least and greatest cell of an object whose grid has at most `MOST` cells [m]."""
MOST = 3000
"""Greatest number of cells of the grid about an object."""


@dataclass(frozen=True, eq=False)
class Converted:
    """Object made of a mesh, without masses."""

    name: str
    parts: tuple[trimesh.Trimesh, ...]
    """Closed parts on the table z = 0 [m], from left to right."""
    pose: Pose
    """Orientation on the table."""
    grasps: tuple[GraspPlace, ...]
    """Grasps, the first nearest the middle."""
    cell: float
    """Side of a cell [m]."""
    notes: tuple[str, ...]
    """Unit, repairs, pose, parts, points of contact and missing grasps, in words."""

    def model(self, masses: Sequence[float] = (), friction: float = 0.5) -> ObjectModel:
        """Object with masses as in `masses`; without any, it has one kilogram, marked as not given."""
        given = self.masses(masses or (1.0,))
        parts = [Part(name, mesh, mass, 0) for name, mesh, mass in zip(self.part_names, self.parts, given, strict=True)]
        contacts = [(x, y) for x, y in self.pose.contacts.tolist()]
        made = mesh_object(
            self.name, parts, list(self.grasps), friction=[friction], cell=self.cell, grid=3, contacts=contacts
        )
        return made if masses else replace(made, masses_known=False)

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts."""
        return tuple(f"part_{index + 1}" for index in range(len(self.parts)))

    @property
    def volumes(self) -> Float[np.ndarray, "n"]:
        """Volume of each part [m^3]."""
        return np.array([part.volume for part in self.parts])

    def masses(self, given: Sequence[float]) -> tuple[float, ...]:
        """Mass of each part [kg]: as given, or one mass in all shared by volume.

        Raises:
            InvalidValueError: neither one mass nor one per part, or a mass that is not > 0 and < 100 kg.
        """
        for mass in given:
            check_kilograms("mass", mass)
        if len(given) not in (0, 1, len(self.parts)):
            allowed = f"one mass in all, or {len(self.parts)}, one per part from left to right, kg"
            raise InvalidValueError("mass", list(given), allowed)
        if len(given) != 1:
            return tuple(given)
        return tuple((given[0] * self.volumes / self.volumes.sum()).tolist())


def convert_mesh(
    path: Path,
    *,
    name: str | None = None,
    unit: str | None = None,
    parts: str = "auto",
    down: str = "auto",
    cell: float | None = None,
    most_grasps: int = 6,
    center_of_mass: Float[np.ndarray, "3"] | None = None,
) -> Converted:
    """Object from a mesh file.

    Args:
        path: STL, OBJ, PLY, OFF, GLB or 3MF.
        name: of the object; the file's, or its folder's where that is "mesh".
        unit: "m", "cm", "mm" or "in"; found if left out.
        parts: as `conversion.parts.cut` takes it, or a PLY file with labelled points.
        down: "auto" (the likeliest stable pose), an axis of the file ("x", "-z", ...), or the number of a stable pose.
        cell: side of a cell, m; if left out, one that gives about `CELLS` cells.
        most_grasps: grasps that are proposed, at most.
        center_of_mass: center of mass that decides the stable poses, m, axes of the file; of one density if left out.

    Raises:
        InvalidValueError: no mesh, no such pose or parts, or a cell that is not > 0 or too large for a part.
    """
    if cell is not None:
        check_positive("cell", cell)
    surface = read_surface(path, unit)
    notes = list(surface.notes)
    if parts.endswith(".ply"):
        surface, parts = labelled(surface, Path(parts)), "colours"
    if down == "auto" or down.isdecimal():
        poses = stable_poses(surface, center_of_mass)
        index = int(down) - 1 if down.isdecimal() else 0
        if not 0 <= index < len(poses):
            raise InvalidValueError("down", down, f"1 to {len(poses)}, a stable pose, the likeliest first")
        pose = poses[index]
        chances = ", ".join(f"{100 * each.probability:.0f} %" for each in poses)
        notes.append(f"stable poses {chances}; laid in number {index + 1}")
    else:
        pose = asked_pose(surface, down, center_of_mass)
        notes.append(f"{down} down")
    laid = surface.transformed(pose.matrix)
    whole = laid.whole
    pieces, how = cut(laid, parts)
    meshes = tuple(as_mesh(piece) for piece in pieces)
    way = "planes" if how[0].isdigit() else how
    single = "" if len(pieces) > 1 else ": no mass distribution to estimate, unless --parts 3 or 0.3,0.6 divides it"
    notes.append(f"{len(pieces)} part{'s' * (len(pieces) > 1)} by {way}{single}")
    notes.append(f"rests on {len(pose.contacts)} points")
    if cell is None:
        cell = float(np.clip(np.sqrt(whole.project().area() / CELLS), *CELL))
        low, high = np.reshape(whole.bounding_box(), (2, 3))
        cell = max(cell, math.sqrt(np.prod(high[:2] - low[:2]) / MOST))  # larger cells for a large object
        cell = round(cell * 2000) / 2000 or CELL[0]
    places, refused = propose_grasps(whole, joined(meshes), as_mesh(whole).center_mass[:2], most_grasps)
    if not places:
        notes.append(f"no grasp: {refused or 'no two faces across from each other'}")
    return Converted(object_name(path, name), meshes, pose, tuple(places), cell, tuple(notes))


def object_name(path: Path, name: str | None = None) -> str:
    """Name of an object: `name`, else the file's stem, or the folder's name if the stem is "mesh".

    Characters other than letters, digits, `_`, `.` and `-` are replaced.
    """
    stem = path.parent.name if path.stem.lower() == "mesh" else path.stem
    return re.sub(r"[^\w.-]+", "_", name or stem).lstrip(".")[:64] or "object"


def write_object(made: Converted, folder: Path, masses: Sequence[float] = (), friction: float = 0.5) -> Path:
    """Write the object file and the meshes of its parts; returns the file.

    Raises:
        InvalidValueError: masses that do not fit the parts.
    """
    given = made.masses(masses)
    files = [f"{made.name}_{part}.ply" for part in made.part_names]
    for file, part in zip(files, made.parts, strict=True):
        write_whole(folder / file, lambda path, mesh=part: path.write_bytes(mesh.export(file_type="ply")))
    rows = [f"# {line}" for line in made.notes]
    mesh = {"cell_m": made.cell, "friction": friction, "contacts_m": np.round(made.pose.contacts, 6).tolist()}
    rows.append(toml_text({"name": made.name, "mesh": mesh}))
    for index, (part, file) in enumerate(zip(made.part_names, files, strict=True)):
        table = {"name": part, "file": file, "mass_kg": given[index] if given else None}
        rows.append(f"[[mesh.parts]]\n{toml_text(table)}")
    for place in made.grasps:
        table = {"name": place.name, "at_m": list(place.at), "closing_deg": round(float(np.degrees(place.closing)), 1)}
        rows.append(f"[[mesh.grasps]]\n{toml_text(table)}")
    path = folder / f"{made.name}.toml"
    write_text(path, "\n".join(rows))
    return path
