"""A recorded trial on the bench, sample by sample: arm, fingers and object where the record has them, no physics."""

from __future__ import annotations

import math

import mujoco
import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions import Lift
from testbed.errors import InvalidValueError
from testbed.lift_reduction import poses_in_space
from testbed.objects import ObjectModel
from testbed.simulation.object_scene import add_object
from testbed.simulation.replay import opening, pose_bench
from testbed.simulation.scene import attach_arm, part
from testbed.simulation.views import light
from testbed.trajectory import Phase, Trajectory
from testbed.trial import RIGID

_HELD = (Phase.SETTLE, Phase.RAMP, Phase.STEADY)


class Playback:
    """The bench with the object of a record on it."""

    def __init__(self, trajectory: Trajectory, obj: ObjectModel, width: float, *, meshes: bool = True):
        """Compile the bench, and show the first sample.

        Args:
            trajectory: the record.
            obj: the object that was moved; only its looks count.
            width: between the pads while they hold it, m.
            meshes: dress the arm in its own meshes where the extra "meshes" is installed; capsules otherwise.

        Raises:
            InvalidValueError: a record of a scale, where nothing moves.
        """
        if trajectory.tool is None:
            raise InvalidValueError("trial", "a weighing, where nothing moves", "a slide or a turn")
        spec = part("table")
        attach_arm(spec, meshes=meshes)
        add_object(spec, obj, RIGID)
        self.model = spec.compile()
        light(self.model)
        self.data = mujoco.MjData(self.model)
        self.trajectory = trajectory
        self._opening = opening(trajectory, width)
        self._object = object_pose(trajectory)
        self._in_space = _in_space(trajectory, obj.shape.height / 2)
        self._address = self.model.joint("object").qposadr[0]
        self.show(0)

    def show(self, sample: int) -> None:
        """Put everything where the record has it at a sample."""
        model, data, address = self.model, self.data, self._address
        pose_bench(model, data, self.trajectory, sample, float(self._opening[sample]))
        if self._in_space is not None:
            data.qpos[address : address + 7] = self._in_space[sample]
        else:
            x, y, yaw = self._object[sample]
            data.qpos[address : address + 2] = x, y  # the height and the upright axis are the model's own
            data.qpos[address + 3 : address + 7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        data.time = self.trajectory.time_s[sample]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)


def object_pose(trajectory: Trajectory) -> Float[np.ndarray, "T 3"]:
    """Planar pose of the object in the world, m, m, rad: as the hand has it while it holds, else at rest."""
    held = np.flatnonzero(trajectory.mask(*_HELD))
    first, last = (held[0], held[-1]) if len(held) else (-1, -1)
    count = len(trajectory.time_s)
    return trajectory.object_pose[np.clip(np.arange(count), first % count, last % count)]


def _in_space(trajectory: Trajectory, middle: float) -> Float[np.ndarray, "T 7"] | None:
    """Place, m, and orientation, wxyz, of the object's body in a lift, `middle` (m) over its bottom; None of others."""
    if not (isinstance(trajectory.action, Lift) and trajectory.mask(Phase.SETTLE).any()):
        return None
    origin, axes = poses_in_space(trajectory)
    turned = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return np.hstack([origin + middle * axes[:, :, 2], turned])
