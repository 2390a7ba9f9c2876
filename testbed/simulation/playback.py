"""A recorded trial as poses of the bench's bodies: kinematics of what was measured, with no physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import lru_cache

import mujoco
import numpy as np
from jaxtyping import Float, UInt8
from scipy.spatial.transform import Rotation

from testbed.actions.base import Lift
from testbed.errors import InvalidValueError
from testbed.objects.gripper import STROKE
from testbed.objects.model import ObjectModel
from testbed.sensing.lift_windows import poses_in_space
from testbed.simulation.rendering import VIEWS, ViewName, camera, hide, light, offscreen_renderer
from testbed.simulation.scene import add_object, attach_arm, part
from testbed.trajectory import Phase, Trajectory
from testbed.trial import RIGID

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


MOST_LOOKS = 40
"""Samples of a motion at which the camera makes sure that everything is in the picture."""


@contextmanager
def drawing(
    playback: Playback, view: ViewName, width: int, height: int
) -> Iterator[Callable[[int], UInt8[np.ndarray, "H W 3"]]]:
    """What draws a record at a sample; its camera stands still and has the whole record's motion in the picture.

    Args:
        playback: the record on its bench.
        view: a name in `VIEWS`.
        width: px.
        height: px.

    Raises:
        NoGraphicsError: the machine cannot draw without a display.
    """
    model, data, chosen = copy(playback.model), playback.data, VIEWS[view]
    hide(model, chosen)
    shown = mujoco.MjvOption()
    shown.sitegroup[:] = 0
    looks = np.unique(np.linspace(0, len(playback.trajectory.time_s) - 1, MOST_LOOKS).astype(int))
    eye = camera(model, data, chosen, width / height, playback.show, looks.tolist())
    with offscreen_renderer(model, width, height) as renderer:

        def draw(sample: int) -> UInt8[np.ndarray, "H W 3"]:
            playback.show(sample)
            renderer.update_scene(data, eye, shown)
            return renderer.render()

        yield draw
