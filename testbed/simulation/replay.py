"""A recorded trial as poses of the bench's bodies: kinematics of what was measured, with no physics."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from jaxtyping import Float

from testbed.gripper import STROKE
from testbed.simulation.scene import attach_arm, part
from testbed.trajectory import Phase, Trajectory

_OPEN = (Phase.TARE, Phase.APPROACH)


@lru_cache(maxsize=2)
def bench_model(*, meshes: bool = True) -> mujoco.MjModel:
    """Table, arm, sensor and gripper, with nothing on the table; compiled once a process.

    Args:
        meshes: dress the arm in its own meshes where the extra "meshes" is installed; capsules otherwise.
    """
    spec = part("table")
    attach_arm(spec, meshes=meshes)
    return spec.compile()


def opening(trajectory: Trajectory, width: float) -> Float[np.ndarray, "T"]:
    """Distance between the pads, m, (T,): open, closing on `width` (m) while it grasps, opening as it lets go.

    A record has no fingers in it; the phases tell what they did.
    """
    phase, count = trajectory.phase, len(trajectory.phase)
    closed = np.where(np.isin(phase, _OPEN), 0.0, 1.0)
    for moving, ends in ((Phase.GRASP, (0.0, 1.0)), (Phase.RELEASE, (1.0, 0.0))):
        inside = np.flatnonzero(phase == moving)
        closed[inside] = np.linspace(*ends, len(inside))
    if trajectory.tool is None:
        closed = np.zeros(count)
    return STROKE + (width - STROKE) * closed


def pose_bench(model: mujoco.MjModel, data: mujoco.MjData, trajectory: Trajectory, sample: int, opened: float) -> None:
    """Put arm and fingers where the record has them at a sample; `opened` is the distance between the pads, m."""
    data.qpos[:7] = trajectory.joint_position[sample]
    for finger in ("gripper/left_finger", "gripper/right_finger"):
        data.qpos[model.joint(finger).qposadr[0]] = (STROKE - opened) / 2


@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Where the bodies of the bench are at each sample: T samples, B bodies."""

    model: mujoco.MjModel
    """Whose bodies they are, in order."""
    position: Float[np.ndarray, "T B 3"]
    """m, world."""
    orientation: Float[np.ndarray, "T B 4"]
    """wxyz."""


def body_poses(trajectory: Trajectory, width: float, *, meshes: bool = True, every: int = 1) -> BodyPoses:
    """Forward kinematics of a record.

    Args:
        trajectory: of a trial with the arm.
        width: between the faces that were gripped, m.
        meshes: as `bench_model`.
        every: take one sample in so many.
    """
    model = bench_model(meshes=meshes)
    data = mujoco.MjData(model)
    samples, opened = range(0, len(trajectory.time_s), every), opening(trajectory, width)
    position = np.empty((len(samples), model.nbody, 3))
    orientation = np.empty((len(samples), model.nbody, 4))
    for row, sample in enumerate(samples):
        pose_bench(model, data, trajectory, sample, float(opened[sample]))
        mujoco.mj_kinematics(model, data)
        position[row], orientation[row] = data.xpos, data.xquat
    return BodyPoses(model, position, orientation)
