"""Weighing: the object alone on the table; the scale reads the sum of what its feet press."""

from __future__ import annotations

import mujoco
import numpy as np

from testbed.simulation.scene import build_scene
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase, Trajectory
from testbed.trial import Trial

_SETTLE_TIME, _READ_TIME = 1.0, 0.5


def weigh(trial: Trial, settings: SimulationSettings) -> Trajectory:
    """Let the object come to rest and read its weight at the record rate: wrench_on_object_world, z."""
    scene = build_scene(trial.object, trial.support, None, settings)
    model, data = scene.model, mujoco.MjData(scene.model)
    mujoco.mj_step(model, data, round(_SETTLE_TIME / settings.timestep))
    count = round(_READ_TIME * settings.rate)
    weight = np.empty(count)
    force = np.zeros(6)
    for tick in range(count):
        mujoco.mj_step(model, data, round(1 / settings.rate / settings.timestep))
        weight[tick] = 0.0
        for contact in range(data.ncon):
            mujoco.mj_contactForce(model, data, contact, force)
            weight[tick] += force[0]
    pose = np.tile([0.0, 0.0, 0.0], (count, 1))
    wrench = np.zeros((count, 6))
    wrench[:, 2] = weight
    orientation = np.tile([1.0, 0.0, 0.0, 0.0], (count, 1))
    return Trajectory(
        action=trial.action,
        status="ok",
        reason="",
        time_s=np.arange(count) / settings.rate,
        phase=np.full(count, Phase.STEADY),
        segment=np.zeros(count, dtype=int),
        object_pose=pose,
        object_velocity=np.zeros((count, 3)),
        tcp_position=np.zeros((count, 3)),
        tcp_velocity=np.zeros((count, 6)),
        sensor_orientation=orientation,
        sensor_wrench=wrench,
        wrench_on_object_world=wrench,
        joint_position=np.zeros((count, 7)),
        tool=None,
        sensor_bias_std=np.zeros(6),
        provenance={"runner": "simulation", "mujoco": mujoco.__version__, "support": trial.support.name},
    )
