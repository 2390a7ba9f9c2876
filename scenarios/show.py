"""Objects on a terminal."""

from __future__ import annotations

import numpy as np
from rich.console import Console
from rich.table import Table

from testbed.object_files import load_object, object_names
from testbed.objects import ObjectModel


def list_objects(console: Console) -> None:
    """A line an object."""
    table = Table(title="Objects", title_justify="left")
    for column, justify in (("name", "left"), ("groups", "right"), ("mass, kg", "right"), ("grasps", "left")):
        table.add_column(column, justify=justify)  # pyright: ignore[reportArgumentType]
    for name in object_names():
        model = load_object(name)
        grasps = " ".join(grasp.name for grasp in model.shape.grasps)
        table.add_row(name, str(model.shape.n_m), f"{model.total_mass:.3f}", grasps)
    console.print(table)


def show_object(console: Console, name: str) -> None:
    """One object, drawn, with what is to be estimated."""
    model = load_object(name)
    shape, com = model.shape, model.center_of_mass
    console.print(
        f"[bold]{model.name}[/bold]: {model.total_mass:.3f} kg, centre of mass ({com[0] * 1e3:.1f}, "
        f"{com[1] * 1e3:.1f}) mm from the middle, I_cm {model.inertia_cm:.5f} kg m^2, {shape.height * 1e3:.0f} mm high",
        highlight=False,
    )
    console.print(drawing(model), highlight=False)
    table = Table()
    for column in ("block", "mass, kg", "friction", "gripped across"):
        table.add_column(column, justify="right")
    grasps = {grasp.name: "x" if abs(np.cos(grasp.angle)) > 0.5 else "y" for grasp in shape.grasps}
    for group, label in enumerate(shape.group_names):
        touching = np.unique(shape.friction_group[shape.mass_group == group])
        friction = " ".join(f"{model.truth.friction[k]:g}" for k in touching if k >= 0) or "no contact"
        table.add_row(label, f"{model.group_mass[group]:.3f}", friction, grasps.get(label, "-"))
    console.print(table)


def drawing(model: ObjectModel) -> str:
    """Groups as a map of their masses, in grams, top row first."""
    shape = model.shape
    centres = np.array([shape.particles[shape.mass_group == g].mean(axis=0) for g in range(shape.n_m)])
    side = shape.cell * np.sqrt(shape.particles_per_group.max())
    column, row = np.round((centres - centres.min(axis=0)) / side).astype(int).T
    lines = []
    for r in range(row.max(), -1, -1):
        cells = ["     "] * (column.max() + 1)
        for group in np.flatnonzero(row == r):
            cells[column[group]] = f"[{model.group_mass[group] * 1e3:3.0f}]".replace("[", "\\[")
        lines.append("  " + "".join(cells))
    return "\n".join(lines)
