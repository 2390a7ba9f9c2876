"""Pushes of a rectangle that no hand can grip, by a closed fingertip, under a camera; and its masses."""

from pathlib import Path

import heft

RECTANGLE = """
name = "rectangle"

[blocks]
layout = ["11", "11", "11"]
mass_kg = [0.4, 0.1, 0.2, 0.2, 0.1, 0.4]
friction = 0.4
"""
PARTS = (0.2, 0.8)
"""Places of the pushes on each face, as a part of its length."""


def main() -> None:
    """Push every side of the rectangle twice, straight and along an arc, and print each block's mass."""
    Path("rectangle.toml").write_text(RECTANGLE)
    obj = heft.load_object("rectangle.toml")
    pushes = [heft.Push.into(face, part, curvature=2.0) for face in heft.faces(obj.shape) for part in PARTS]
    with heft.SimulationRunner() as simulation:
        trials = [heft.Trial(obj, push, sensing="ft300s:camera=exact") for push in pushes]
        trajectories = [simulation.run(trial) for trial in trials]
    answer = heft.HiddenStates().estimate(obj.shape, obj.total_mass, trajectories, seed=0)
    print(f"{len(pushes)} pushes: {answer.status}")
    masses = answer.group_mass(obj.shape)
    assert masses is not None
    for name, found, true in zip(obj.shape.group_names, masses, obj.group_mass, strict=True):
        print(f"{name}: {found:.3f} kg, in truth {true:.3f} kg")


if __name__ == "__main__":
    main()
