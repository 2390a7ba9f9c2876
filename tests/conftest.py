"""dm_control looks for a display on import, torch takes every core, and hypothesis times its examples, by default."""

import os

from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("busy", deadline=None)
settings.load_profile("busy")
