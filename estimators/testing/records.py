"""Trajectories written by hand, so that neither the record nor what reads it needs physics."""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.actions.rotate import Rotate
from testbed.trajectory import Phase, Tool, Trajectory

RATE = 100.0
"""Samples a second."""
DOWN = Rotation.from_quat([0.0, 1.0, 0.0, 0.0], scalar_first=True)
"""Sensor z towards the table."""
TOOL = Tool(
    mass=0.9,
    com=np.array([0.01, -0.02, 0.06]),
    inertia=np.array([[2e-3, 1e-4, -2e-4], [1e-4, 3e-3, 3e-4], [-2e-4, 3e-4, 1e-3]]),
    tcp=np.array([0.002, -0.001, 0.17]),
)
"""A lopsided tool: nothing cancels by symmetry."""


def record(count: int = 400, *, tare: int = 100, orientation: Rotation = DOWN, **changes: Any) -> Trajectory:
    """A hand at rest: `tare` samples of tare, the rest one steady stretch. `changes` replaces fields."""
    steady = np.arange(count) >= tare
    values: dict[str, Any] = {
        "action": Rotate(0),
        "status": "ok",
        "reason": "",
        "time_s": np.arange(count) / RATE,
        "phase": np.where(steady, Phase.STEADY, Phase.TARE),
        "segment": np.where(steady, 0, -1),
        "object_pose": np.zeros((count, 3)),
        "object_velocity": np.zeros((count, 3)),
        "tcp_position": np.zeros((count, 3)),
        "tcp_velocity": np.zeros((count, 6)),
        "sensor_orientation": np.tile(orientation.as_quat(scalar_first=True), (count, 1)),
        "sensor_wrench": np.zeros((count, 6)),
        "wrench_on_object_world": np.zeros((count, 6)),
        "joint_position": np.zeros((count, 7)),
        "tool": TOOL,
        "sensor_bias_std": np.zeros(6),
    }
    return Trajectory(**values | changes)
