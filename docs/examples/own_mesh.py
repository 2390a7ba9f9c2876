"""An object from your own meshes: a paddle of two parts, its object file, one simulated turn, and an estimate."""

from pathlib import Path

import trimesh

import heft

PADDLE = """
name = "paddle"

[mesh]
cell_m = 0.01
friction = 0.4

[[mesh.parts]]
name = "blade"
file = "blade.stl"
mass_kg = 0.35

[[mesh.parts]]
name = "handle"
file = "handle.stl"
mass_kg = 0.15

[[mesh.grasps]]
name = "neck"
at_m = [0.10, 0.0]
closing_deg = 90
"""


def write_paddle(folder: Path) -> Path:
    """Write watertight meshes in metres, standing on z = 0, and beside them the object file; returns its path."""
    blade = trimesh.creation.cylinder(radius=0.06, height=0.03, sections=64)
    handle = trimesh.creation.box((0.14, 0.04, 0.03))
    for name, mesh, x in (("blade", blade, 0.0), ("handle", handle, 0.13)):
        mesh.apply_translation((x, 0.0, 0.015))
        mesh.export(folder / f"{name}.stl")
    path = folder / "paddle.toml"
    path.write_text(PADDLE, encoding="utf-8")
    return path


if __name__ == "__main__":
    paddle = heft.load_object(write_paddle(Path()))
    trial = heft.Trial(paddle, heft.Rotate(grasp=0, duration=6.0, back=True), sensing="ft300s")
    with heft.SimulationRunner() as simulation:
        trajectory = simulation.run(trial)
    answer = heft.HiddenStates().estimate(paddle.shape, paddle.total_mass, [trajectory], seed=0)
    print(len(paddle.shape.particles), "particles; status", answer.status, answer.message)
    masses = answer.group_mass(paddle.shape)
    for name, found, true in zip(paddle.shape.group_names, masses, paddle.group_mass, strict=True):
        print(f"{name}: {found:.3f} kg, in truth {true:.3f} kg")
    nad = heft.normalized_absolute_difference(paddle.shape, answer.distribution, paddle.truth)
    print(f"friction {answer.distribution.friction[0]:.3f}, NAD {100 * nad:.1f} %")
