"""dm_control looks for a display on import unless it is told how to draw."""

import os

os.environ.setdefault("MUJOCO_GL", "disable")
