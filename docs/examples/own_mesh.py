"""An object from your own meshes: a paddle of two parts, its object file, one simulated turn, and an estimate."""

from pathlib import Path

import trimesh

import heft

PADDLE = """
name = "paddle"
mesh.cell_m = 0.01
mesh.friction = 0.4
mesh.grasps = [{ name = "neck", at_m = [0.10, 0.0], closing_deg = 90 }]

[[mesh.parts]]
name = "blade"
file = "blade.stl"
mass_kg = 0.35

[[mesh.parts]]
name = "handle"
file = "handle.stl"
mass_kg = 0.15
"""

# watertight meshes in meters, standing on z = 0
blade = trimesh.creation.cylinder(radius=0.06, height=0.03, sections=64)
handle = trimesh.creation.box((0.14, 0.04, 0.03))
blade.apply_translation((0.0, 0.0, 0.015)).export("blade.stl")
handle.apply_translation((0.13, 0.0, 0.015)).export("handle.stl")
Path("paddle.toml").write_text(PADDLE, encoding="utf-8")

paddle = heft.load_object("paddle.toml")
with heft.SimulationRunner() as simulation:
    trial = heft.Trial(paddle, heft.Rotate(grasp=0, duration=6.0, back=True), sensing="ft300s")
    trajectory = simulation.run(trial)
answer = heft.HiddenStates().estimate(paddle.shape, paddle.total_mass, [trajectory], seed=0)
nad = heft.normalized_absolute_difference(paddle.shape, answer.distribution, paddle.truth)
print(f"status {answer.status}, NAD {100 * nad:.1f} %", answer.table(paddle.shape), sep="\n")
