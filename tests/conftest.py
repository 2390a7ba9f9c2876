"""dm_control looks for a display on import, torch takes every core, hypothesis times its examples, and every run draws
anew, by default."""

import os

from hypothesis import settings

from testbed.worlds import seeds

os.environ.setdefault("MUJOCO_GL", "disable")
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("busy", deadline=None)
settings.load_profile("busy")
seeds.token_hex = lambda _: "tests"
