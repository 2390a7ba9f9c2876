"""Objects of a scenario from mesh files in a user's folder, with masses from a file beside each."""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from estimators.inertial import InertialParameters
from estimators.inertial.body import shift_map
from scenarios.config import Meshes, Scenario
from scenarios.results.store import key_of
from scenarios.study.experiment import Progress
from testbed.errors import InvalidValueError, nearest
from testbed.objects.conversion.convert import Converted, convert_mesh, object_name, write_object

LIGHTEST = 0.1
"""Least density of a part, relative to the mean density of the object: rubber beside steel."""


def with_meshes(scenario: Scenario, data: Path | None, folder: Path, progress: Progress) -> tuple[Scenario, list[str]]:
    """Scenario with objects from the mesh files in `data`, and a line on each; existing object files are kept.

    Args:
        scenario: a scenario with a [meshes] table, whose `objects` are names of meshes, or none for all.
        data: folder of the mesh files; None is refused for a scenario with a [meshes] table.
        folder: results folder; the objects go to its objects/.
        progress: receives how far it is.

    Raises:
        InvalidValueError: no folder, no mesh file in it, a name that is none of them, or a mesh without a mass.
    """
    meshes = scenario.meshes
    if meshes is None:
        if data is not None:
            raise InvalidValueError("--data", str(data), "none: the objects of this scenario need no data")
        return scenario, []
    files = {} if data is None else {object_name(file): file for file in sorted(data.glob(meshes.files))}
    if not files:
        allowed = f"a folder with files {meshes.files}: {meshes.source}"
        raise InvalidValueError("--data", data and str(data), allowed)
    wanted = scenario.objects or list(files)
    if unknown := [name for name in wanted if name not in files]:
        raise InvalidValueError("objects", unknown, f"some of {', '.join(files)}{nearest(unknown[0], files)}")
    paths, lines = [], []
    for done, name in enumerate(wanted):
        path, line = _object_file(files[name], name, meshes, folder)
        progress("objects", done + 1, len(wanted))
        lines.append(line)
        paths.append(str(path))
    return scenario.model_copy(update={"objects": paths}), lines


def _object_file(file: Path, name: str, meshes: Meshes, folder: Path) -> tuple[Path, str]:
    """Object file of a mesh, written if it does not exist, and a line on it."""
    digest, notes = hashlib.sha256(file.read_bytes()).hexdigest(), file.with_name(meshes.notes)
    known = meshes.sha256.get(name, "")
    other = "" if digest.startswith(known) else f"{name}: another file than that of the documentation's figures; "
    text = notes.read_text(encoding="utf-8") if notes.is_file() else ""
    key = key_of({"mesh": digest, "notes": text, "meshes": meshes.model_dump(include={"mass_kg", "friction"})})
    path = folder / "objects" / key / f"{name}.toml"
    if path.is_file():
        return path, other + f"{name}: {path}"
    if text:
        truth = stated_inertia(text, notes)
        made = convert_mesh(file, name=name, center_of_mass=truth.center_of_mass)
        masses, fit = part_masses(made, truth)
    elif meshes.mass_kg is not None:
        made, fit = convert_mesh(file, name=name), ""
        masses = made.masses((meshes.mass_kg,))
    else:
        raise InvalidValueError("mass_kg", None, f"a mass in [meshes], or a file {meshes.notes} beside", file=file)
    write_object(made, path.parent, masses, meshes.friction)
    return path, other + f"{name}: {path}: {'; '.join([*made.notes, *filter(None, [fit])])}"


def part_masses(made: Converted, truth: InertialParameters) -> tuple[tuple[float, ...], str]:
    """Masses of parts of uniform density, fitted to a body's M, c and inertia, and the errors of the fit in words.

    Args:
        made: the object.
        truth: parameters of the whole, in the axes of the mesh file.
    """
    turn, shift = made.pose.matrix[:, :3], made.pose.matrix[:, 3]
    body = truth.moved(turn.T, -turn.T @ shift)
    parts = [InertialParameters(part.volume, part.center_mass, part.moment_inertia).vector for part in made.parts]
    unit = np.column_stack([part / part[0] for part in parts])  # trimesh takes 1 kg/m^3
    about = shift_map(body.center_of_mass)
    size = float(np.sqrt(np.trace(body.inertia) / body.mass))
    scale = np.array([1.0] + [size] * 3 + [size**2] * 6) * body.mass
    share = body.mass * made.volumes / made.volumes.sum()
    found = lsq_linear(about @ unit / scale[:, None], about @ body.vector / scale, (LIGHTEST * share, 2 * body.mass)).x
    masses = found * body.mass / found.sum()
    whole = InertialParameters.of_vector(unit @ masses)
    off = 1e3 * float(np.linalg.norm(whole.center_of_mass - body.center_of_mass))
    inertia = 100 * float(np.linalg.norm(whole.inertia - body.inertia) / np.linalg.norm(body.inertia))
    return tuple(
        masses.tolist()
    ), f"masses of parts from M, c and inertia, which they have to {off:.2g} mm, {inertia:.2g} %"


def stated_inertia(text: str, path: Path) -> InertialParameters:
    """Parameters that the notes beside a mesh state (MASS, COM_WRT_MESH, INERTIA_WRT_COM), in the mesh's axes [kg, m].

    Raises:
        InvalidValueError: a number is missing.
    """

    def numbers(name: str, count: int) -> Float[np.ndarray, "n"]:
        found = re.search(rf"\b{name}:(.*?)(?=\n\s*[A-Z]|\Z)", text, re.DOTALL)
        values = re.findall(r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?", found[1]) if found else []
        if len(values) != count:
            raise InvalidValueError(name, f"{len(values)} numbers", f"{count} numbers, kg and m", file=path)
        return np.array([float(value) for value in values])

    inertia = numbers("INERTIA_WRT_COM", 9).reshape(3, 3)
    return InertialParameters(float(numbers("MASS", 1)[0]), numbers("COM_WRT_MESH", 3), inertia)
