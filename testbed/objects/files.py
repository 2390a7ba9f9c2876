"""Object files: their schema, the library of objects, and the folders of heft's own data."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Self

import numpy as np
from jaxtyping import Float
from pydantic import BaseModel, ConfigDict, Field, model_validator

from testbed.errors import InvalidValueError
from testbed.files import find_file, library_names
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.bodies import boxes_of
from testbed.objects.chain import MOST_LINKS, Chain
from testbed.objects.grasps import GraspPlace
from testbed.objects.meshes import Part, mesh_object, read_mesh
from testbed.objects.model import ROBOTIQ_2F85, Hand, ObjectModel, ObjectShape
from testbed.toml import Finite, NonNegative, Positive, load_toml


def asset_folder(kind: str) -> Path:
    """Folder of assets of one kind: "mjcf" or "objects"."""
    package = Path(__file__).parents[1]
    for root in (package / "assets", package.parent / "assets"):
        if (root / kind).is_dir():
            return root / kind
    raise FileNotFoundError(f"heft's assets/{kind} is neither in {package} nor beside it: reinstall heft")


_PLACEHOLDER_KG = 0.1
"""Placeholder of a mass that is not given [kg]."""
NEAR, NEAR_CELLS = 0.01, 1.5
"""Greatest distance of a hinge from the nearest particle of a link that it joins [m], or so many cells if more."""
Name = Annotated[str, Field(min_length=1, max_length=64, pattern=r"^[\w.-]+$")]
Side = Annotated[float, Field(ge=0.001, le=1, allow_inf_nan=False)]


class _Table(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


DENSEST = 2e5
"""Density of a block above which its mass is refused as one in grams, nine times that of osmium [kg/m^3]. Ours."""


class Blocks(_Table):
    """The [blocks] table of an object file."""

    layout: list[str]
    mass_kg: Positive | list[NonNegative] | None = None
    friction: NonNegative | list[NonNegative] = 0.5
    friction_group: list[int] | None = None
    size_m: Side = 0.05
    height_m: Side = 0.03

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        parse_layout(self.layout)
        heaviest = max(self.mass_kg, default=0.0) if isinstance(self.mass_kg, list) else self.mass_kg or 0.0
        most = DENSEST * self.size_m**2 * self.height_m
        if heaviest > most:
            allowed = f"at most {most:.3g} kg in a block of {self.size_m:g} x {self.size_m:g} x {self.height_m:g} m"
            raise InvalidValueError("mass_kg", heaviest, f"{allowed}: kilograms, not grams")
        return self


class HingeTable(_Table):
    """A [[hinges]] table of an object file: the hinge between `link` and the link before, or the rest of the object."""

    at_m: Annotated[list[Finite], Field(min_length=2, max_length=2)]
    link: Annotated[list[Name], Field(min_length=1)]
    friction_Nm: Annotated[float, Field(ge=0, lt=100)] = 0.0


class MeshPart(_Table):
    """A [[mesh.parts]] table of an object file."""

    name: Name
    file: Annotated[str, Field(min_length=1)]
    mass_kg: Positive | None = None
    friction_group: Annotated[int, Field(ge=0)] | None = None


class MeshGrasp(_Table):
    """A [[mesh.grasps]] table of an object file."""

    name: Name
    at_m: Annotated[list[Finite], Field(min_length=2, max_length=2)]
    closing_deg: Finite


Points = Annotated[list[Annotated[list[Finite], Field(min_length=2, max_length=2)]], Field(max_length=64)]
LEAST_FEET = 3
"""Feet of a mass group, at least."""


class FeetTable(_Table):
    """The [feet] table of an object file."""

    under_each_m: Points | None = None
    under_m: dict[Name, Points] | None = None

    @model_validator(mode="after")
    def _one_way(self) -> Self:
        if (self.under_each_m is None) == (self.under_m is None):
            given = "neither" if self.under_m is None else "both"
            raise InvalidValueError("feet", given, "exactly one of under_each_m, of blocks, and under_m, by name")
        return self

    def places(self, model: ObjectModel, origin: Float[np.ndarray, "2"] | None = None) -> list[np.ndarray]:
        """Feet of each mass group [m], object frame.

        Args:
            model: the object in contact at its cells.
            origin: origin of the object in the frame of its mesh [m]; None for blocks.
        """
        shape, found = model.shape, []
        names = set(shape.group_names)
        if self.under_m is not None and set(self.under_m) != names:
            raise InvalidValueError("feet.under_m", sorted(self.under_m), f"feet of {', '.join(shape.group_names)}")
        if self.under_m is None and origin is not None:
            raise InvalidValueError("feet.under_each_m", self.under_each_m, "under_m, by the names of the mesh's parts")
        for group, name in enumerate(shape.group_names):
            cells = shape.particles[shape.mass_group == group]
            if self.under_m is None:
                field, places = "feet.under_each_m", np.array(self.under_each_m).reshape(-1, 2) + cells.mean(axis=0)
            else:
                field, places = f"feet.under_m.{name}", np.array(self.under_m[name]).reshape(-1, 2)
                places = places if origin is None else places - origin
            apart = np.linalg.svd(places - places.mean(axis=0), compute_uv=False) if len(places) else np.zeros(2)
            if len(places) < LEAST_FEET or apart[-1] < 1e-3:
                raise InvalidValueError(field, f"{len(places)} feet", f"{LEAST_FEET} or more, not in a row")
            beside = np.abs(places[:, None] - cells).max(axis=2).min(axis=1) > shape.cell / 2 + 1e-9
            if beside.any():
                off = (places[beside][0] * 1e3).round(1).tolist()
                raise InvalidValueError(field, f"{off} mm in the object's frame", f"places under {name}")
            found.append(places)
        return found


class Mesh(_Table):
    """The [mesh] table of an object file."""

    cell_m: Annotated[float, Field(ge=0.001, le=0.1, allow_inf_nan=False)]
    friction: NonNegative | list[NonNegative] = 0.5
    parts: Annotated[list[MeshPart], Field(min_length=1, max_length=64)]
    grasps: Annotated[list[MeshGrasp], Field(max_length=64)] = []
    contacts_m: Points = []

    @model_validator(mode="after")
    def _fits_together(self) -> Self:
        for field, names in (("parts", [p.name for p in self.parts]), ("grasps", [g.name for g in self.grasps])):
            if len(set(names)) < len(names):
                raise InvalidValueError(field, names, "names that differ")
        if len({part.mass_kg is None for part in self.parts}) > 1:
            raise InvalidValueError(
                "parts.mass_kg", [part.mass_kg for part in self.parts], "a mass of each, or of none"
            )
        if 0 < len(self.contacts_m) < 3:
            raise InvalidValueError("contacts_m", self.contacts_m, "three points or more, or none: then cells touch")
        return self


class ObjectFile(_Table):
    """A whole object file: blocks or a mesh."""

    name: Name
    blocks: Blocks | None = None
    mesh: Mesh | None = None
    feet: FeetTable | None = None
    hinges: Annotated[list[HingeTable], Field(max_length=MOST_LINKS - 1)] = []

    @model_validator(mode="after")
    def _one_kind(self) -> Self:
        if (self.blocks is None) == (self.mesh is None):
            given = "neither" if self.blocks is None else "both"
            raise InvalidValueError("blocks or mesh", given, "exactly one of [blocks] and [mesh]")
        if self.feet and self.mesh and self.mesh.contacts_m:
            allowed = "one of them: contacts_m are of one rigid body, feet of parts on their own weight"
            raise InvalidValueError("feet", "[feet] and mesh.contacts_m", allowed)
        return self

    def build(self, grid: int, folder: Path, hand: Hand = ROBOTIQ_2F85) -> ObjectModel:
        """Object of this file, with `grid` particles along a block's side; mesh files are in `folder`."""
        if self.blocks:
            model = _build_blocks(self.name, self.blocks, grid, hand)
            model = replace(model, shape=replace(model.shape, chain=self._chain(model.shape.group_names)))
            if self.feet:
                model = model.on_feet(self.feet.places(model))
        else:
            model = self._build_mesh(grid, folder)
        if model.shape.chain is not None:
            self._check_joined(model.shape, model.shape.chain)
        self._check_names(model)
        friction = tuple(hinge.friction_Nm for hinge in self.hinges)
        return replace(model, hinge_friction=friction, masses_known=self.has_masses)

    @property
    def has_masses(self) -> bool:
        """True if the file gives the masses."""
        if self.blocks:
            return self.blocks.mass_kg is not None
        assert self.mesh is not None
        return self.mesh.parts[0].mass_kg is not None

    def _chain(self, names: tuple[str, ...]) -> Chain | None:
        """Chain of links, the first of all blocks or parts that no hinge names; None for a rigid object."""
        if not self.hinges:
            return None
        link = np.zeros(len(names), dtype=int)
        for index, hinge in enumerate(self.hinges):
            if unknown := [name for name in hinge.link if name not in names]:
                raise InvalidValueError(f"hinges.{index}.link", unknown, f"some of {', '.join(names)}")
            named = [names.index(name) for name in hinge.link]
            if twice := [names[group] for group in named if link[group]]:
                raise InvalidValueError(
                    f"hinges.{index}.link", twice, "those up to the next hinge: a block or part is in one link"
                )
            link[named] = index + 1
        if not (link == 0).any():
            given = f"every block or part in a link: {', '.join(names)}"
            raise InvalidValueError("hinges", given, "one or more that no hinge names, the first link")
        return Chain(link, np.array([hinge.at_m for hinge in self.hinges]))

    def _check_joined(self, shape: ObjectShape, chain: Chain) -> None:
        """Refuse hinges away from a link that they join, and links that do not touch the table."""
        if not shape.stands_in_groups:
            allowed = "parts that touch the table, on their cells: links rest on their own weight"
            feet = shape.mass_group[(shape.friction_group >= 0) & ~(shape.is_contact & ~shape.stands_on_feet)]
            raise InvalidValueError("hinges", [n for g, n in enumerate(shape.group_names) if g not in feet], allowed)
        for index, place in enumerate(chain.hinges):
            for link in (index, index + 1):
                own = chain.link[shape.mass_group] == link
                away = float(np.linalg.norm(shape.particles[own] - place, axis=1).min())
                if away > max(NEAR_CELLS * shape.cell, NEAR):
                    names = ", ".join(np.array(shape.group_names)[chain.link == link])
                    joins = "hinges go along the chain: the first from the blocks or parts that none names"
                    allowed = f"a place at both its links; {names} is {away * 1e3:.0f} mm away, and {joins}"
                    raise InvalidValueError(f"hinges.{index}.at_m", self.hinges[index].at_m, allowed)

    def _check_names(self, model: ObjectModel) -> None:
        """Refuse names that an exported model would have twice."""
        links = [f"link_{index}" for index in range(len(self.hinges) + 1)] if self.hinges else []
        boxes = Counter(box.name for box in boxes_of(model.shape, model.truth))
        twice = {name for name in boxes if boxes[name] > 1} | ({self.name, *model.shape.group_names} & set(links))
        if twice:
            allowed = "names of parts that differ, also from cells (part_0, ...) and links (link_0, ...)"
            raise InvalidValueError("name", sorted(twice), allowed)

    def _build_mesh(self, grid: int, folder: Path) -> ObjectModel:
        assert self.mesh is not None
        m = self.mesh
        friction = _friction_list("mesh.friction", m.friction)
        groups = [0 if p.friction_group is None and len(friction) == 1 else p.friction_group for p in m.parts]
        if set(groups) != set(range(len(friction))):
            allowed = f"an integer for each part, that use every friction from 0 to {len(friction) - 1}"
            raise InvalidValueError("mesh.parts.friction_group", groups, allowed)
        parts = []
        for index, (part, group) in enumerate(zip(m.parts, groups, strict=True)):
            assert group is not None
            try:
                parts.append(Part(part.name, read_mesh(folder / part.file), part.mass_kg or _PLACEHOLDER_KG, group))
            except InvalidValueError as error:
                raise InvalidValueError(f"mesh.parts.{index}.{error.field}", error.given, error.allowed) from None
        places = [GraspPlace(g.name, (g.at_m[0], g.at_m[1]), math.radians(g.closing_deg)) for g in m.grasps]
        contacts = [(x, y) for x, y in m.contacts_m]
        chain = self._chain(tuple(part.name for part in parts))
        model = mesh_object(
            self.name, parts, places, friction=friction, cell=m.cell_m, grid=grid, contacts=contacts, chain=chain
        )
        if self.feet is None:
            return model
        origin = parts[0].mesh.vertices[0, :2] - model.solids[0].vertices[0, :2]
        return model.on_feet(self.feet.places(model, origin))


def _build_blocks(name: str, b: Blocks, grid: int, hand: Hand) -> ObjectModel:
    cells = parse_layout(b.layout)
    friction = _friction_list("blocks.friction", b.friction)
    groups = b.friction_group
    if groups is None and len(friction) == 1:
        groups = [0] * len(cells)
    if groups is None or len(groups) != len(cells) or set(groups) - {-1} != set(range(len(friction))):
        allowed = f"{len(cells)} integers, one per block, that use every friction from 0 to {len(friction) - 1}, or -1"
        raise InvalidValueError("blocks.friction_group", groups, allowed)
    mass: list[float] = list(b.mass_kg) if isinstance(b.mass_kg, list) else [b.mass_kg or _PLACEHOLDER_KG] * len(cells)
    if len(mass) != len(cells) or sum(mass) <= 0:
        allowed = f"{len(cells)} numbers >= 0, one per block, bottom row first, left to right, with a sum > 0"
        raise InvalidValueError("blocks.mass_kg", mass, allowed)
    return block_object(
        name,
        cells,
        size=b.size_m,
        height=b.height_m,
        mass=mass,
        friction=friction,
        friction_group=groups,
        grid=grid,
        hand=hand,
    )


def _friction_list(field: str, friction: float | list[float]) -> list[float]:
    if friction == []:
        raise InvalidValueError(field, friction, "a number >= 0, or a list of one or more")
    return list(friction) if isinstance(friction, list) else [friction]


def load_object(
    name_or_path: str | Path, grid: int = 3, *, measured: bool = False, hand: Hand = ROBOTIQ_2F85
) -> ObjectModel:
    """Object of the library by name, or of a TOML file by path.

    Args:
        name_or_path: "L2", or "my/object.toml".
        grid: particles along a block's side. A mesh's cells have a side of cell_m * 3 / grid: the default keeps the
            file's, a larger grid cuts finer.
        measured: accept a file without masses too, for trials of a real robot.
        hand: the gripper, whose opening limits the rows of blocks that it grasps.

    Raises:
        InvalidValueError: no such object, or values out of range.
        InvalidFileError: a file that is not TOML or does not fit the schema.
    """
    path = find_file(name_or_path, asset_folder("objects"), "object")
    parsed = load_toml(path, ObjectFile)
    if not (measured or parsed.has_masses):
        allowed = "masses: only what a real robot measures, or heft plan with --weight, is made without them"
        raise InvalidValueError("mass_kg", None, allowed, file=path)
    files = [path.parent / part.file for part in parsed.mesh.parts] if parsed.mesh else []
    stamps = tuple(file.stat().st_mtime_ns for file in files if file.is_file())
    try:
        return _built(parsed.model_dump_json(), grid, path.parent, stamps, hand)
    except InvalidValueError as error:
        raise InvalidValueError(error.field, error.given, error.allowed, file=path) from None


@lru_cache(maxsize=64, typed=True)  # True and 1 differ
def _built(content: str, grid: int, folder: Path, stamps: tuple[int, ...], hand: Hand) -> ObjectModel:
    """Object of a file's content, cached since a mesh takes long; `stamps` are the times of the mesh files."""
    return ObjectFile.model_validate_json(content).build(grid, folder, hand)


def object_names() -> list[str]:
    """Names of the objects in the library."""
    return library_names(asset_folder("objects"))
