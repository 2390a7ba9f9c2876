"""Draw docs/bench.png: the arm holding an object on the table. Needs EGL (Debian: libegl1 libegl-mesa0)."""

from __future__ import annotations

import os
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "egl")

import mujoco
from PIL import Image

from testbed.actions import Rotate
from testbed.object_files import load_object
from testbed.simulation.motion import plan_motion
from testbed.simulation.runner import place
from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase
from testbed.trial import OWN_WEIGHT

settings = SimulationSettings()
model = load_object("L2")
motion = plan_motion(Rotate(3), model.shape, settings)
scene = build_scene(model, OWN_WEIGHT, model.shape.grasps[3], settings, meshes=True)
data = mujoco.MjData(scene.model)
place(scene.model, data, motion)
held = int((motion.phase == Phase.SETTLE).argmax())
data.qpos[:7] = motion.q[held]
data.qpos[7:9] = (0.085 - 0.05) / 2
mujoco.mj_forward(scene.model, data)
with mujoco.Renderer(scene.model, 720, 1080) as renderer:
    renderer.update_scene(data, camera="bench")
    Image.fromarray(renderer.render()).save(Path(__file__).parent / "bench.png", optimize=True)
