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
    """Make an object of a mesh file: mended, laid on a stable face, cut into parts, with contact points and grasps.

    Writes DIR/NAME.toml, the meshes of its parts beside it, and its picture from above: parts, points of contact, and
    grasps. Of several files there is a picture of all besides. What was found and mended is printed, and stands in the
    object file. Without masses an object is for measured trials.

    Exit code: 1 where a file makes no object.

    Examples: heft mesh hammer.stl
              heft mesh hammer.ply --parts colours --mass 0.69 --down=-z
              heft mesh tools/*/mesh.ply --out results/tools --mass 0.5

    Args:
        files: STL, OBJ, PLY, OFF, GLB or 3MF.
        out: folder to write to.
        units: of the file; found if left out: as the file says, else from the size.
        parts: 3 (equal lengths along the longest side), 0.3,0.6 (planes there), bodies, colours, clusters:3 (where its
            width changes), or a PLY file of labelled points; auto takes colours if there are two, else bodies, else 3.
        down: axis of the file that points down (x, -x, y, ...), or the number of a stable pose; auto is the likeliest.
        cell: side of a cell; for about 150 cells if left out.
        mass: one in all, shared by volume, or one a part, from left to right.
        friction: coefficient of friction with the table.
        grasps: grasps to propose, at most.
    """
    from testbed.objects.conversion import convert_mesh, write_object
    from viz.figures.maps import save_figure
    from viz.figures.objects import object_page

    if grasps < 0:
        raise InvalidValueError("grasps", grasps, "an integer >= 0")
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
