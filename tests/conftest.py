"""dm_control looks for a display on import, and torch takes every core, unless told otherwise."""

import os

os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("OMP_NUM_THREADS", "1")
