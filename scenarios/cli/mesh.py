"""heft mesh: from mesh files to objects, and a picture of them from above."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated, Literal

import tyro

from testbed.errors import InvalidValueError


def mesh(
    files: Annotated[tuple[Path, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FILE [FILE ...]")],
    *,
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/objects"),
    units: Literal["m", "cm", "mm", "in"] | None = None,
    parts: Annotated[str, tyro.conf.arg(metavar="HOW")] = "auto",
    down: Annotated[str, tyro.conf.arg(metavar="AXIS")] = "auto",
    cell: Annotated[float | None, tyro.conf.arg(metavar="MM")] = None,
    mass: Annotated[tuple[float, ...], tyro.conf.arg(metavar="[KG ...]")] = (),
    friction: Annotated[float, tyro.conf.arg(metavar="MU")] = 0.5,
    grasps: Annotated[int, tyro.conf.arg(metavar="N")] = 6,
) -> None:
    """Convert a mesh file to an object: repair it, lay it on a stable face, cut it into parts, find its grasps.

    Writes DIR/NAME.toml, the meshes of its parts, and a picture from above with parts, contact points and grasps; for
    several files also a picture of all. Repairs and findings are printed and stored in the object file. An object
    without masses can be used for measured trials only.

    Exit code: 1 if a file cannot be converted.

    Examples: heft mesh hammer.stl
              heft mesh hammer.ply --parts colours --mass 0.69 --down=-z
              heft mesh tools/*/mesh.ply --out results/tools --mass 0.5

    Args:
        files: STL, OBJ, PLY, OFF, GLB or 3MF files.
        out: output folder.
        units: units of the file; default: as stated in the file, otherwise inferred from its size.
        parts: 3 (equal lengths along the longest side), 0.3,0.6 (cut at these fractions), bodies, colours, clusters:3
            (where the width changes), or a PLY file of labelled points; auto uses colours if there are two, otherwise
            bodies, otherwise 3.
        down: axis of the file that points down (x, -x, y, ...), or index of a stable pose; auto: the most likely.
        cell: side of a cell, mm; default: about 150 cells per object.
        mass: total mass, shared by volume, or one mass per part from left to right, kg.
        friction: coefficient of friction with the table.
        grasps: maximum number of proposed grasps.
    """
    from testbed.objects.conversion.convert import convert_mesh, write_object
    from viz.figures.maps import save_figure
    from viz.figures.objects import object_page

    if grasps < 0:
        raise InvalidValueError("--grasps", grasps, "an integer >= 0")
    made = []
    for file in files:
        try:
            found = convert_mesh(
                file,
                unit=units,
                parts=parts,
                down=down,
                cell=None if cell is None else cell / 1e3,
                most_grasps=grasps,
            )
            if found.name in [model.name for model in made]:
                allowed = (
                    f"a file of another name: another one here is the object {found.name}; give this its own --out"
                )
                raise InvalidValueError("FILE", str(file), allowed)
            model = found.model(found.masses(mass), friction)
            path = write_object(found, out, mass, friction)
        except InvalidValueError as error:
            if len(files) == 1:
                raise
            print(f"{file}: {error}")
            continue
        made.append(model)
        save_figure(object_page([model]), out / found.name)
        print(f"{path}: {'; '.join(found.notes)}")
        count = len(found.grasps)
        print(
            f"    cells of {found.cell * 1e3:g} mm; {count} grasp{'s' * (count != 1)}; picture {out / found.name}.png"
        )
    if len(made) > 1:
        for path in save_figure(object_page(made), out / "objects"):
            print(path)
    if len(made) < len(files):
        sys.exit(1)
