"""Pictures of trials: still cameras, and playback of a record by the measured kinematics, without physics."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from copy import copy
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float, UInt8
from scipy.spatial.transform import Rotation

from testbed.errors import InvalidValueError
from testbed.objects.model import STROKE, ObjectModel
from testbed.sensing.lift_windows import poses_in_space
from testbed.simulation.contacts import add_tip
from testbed.simulation.graphics import offscreen_renderer
from testbed.simulation.scene import add_object, attach_arm, part
from testbed.simulation.settings import GripSettings
from testbed.trajectory import Phase, Trajectory
from testbed.trial import RIGID

ViewName = Literal["bench", "object", "above"]


@dataclass(frozen=True)
class View:
    """Viewing direction, and the bodies in the picture."""

    azimuth: float
    """Azimuth of the viewing direction [deg], from the world's x axis."""
    elevation: float
    """Elevation of the viewing direction over the horizon [deg]; negative looks down."""
    frames: tuple[str, ...]
    """Name prefixes of the bodies in the picture."""
    hides: tuple[str, ...] = ()
    """Name prefixes of the bodies left out."""


VIEWS: dict[ViewName, View] = {
    "bench": View(137, -24, ("arm/", "ft/", "gripper/", "object")),
    "object": View(137, -38, ("object", "gripper/left_finger", "gripper/right_finger")),
    "above": View(90, -89.99, ("object",), hides=("arm/", "ft/", "gripper/base")),
}
FIELD_OF_VIEW = 30.0
"""Vertical field of view [deg], narrow for little perspective."""
MARGIN = 0.9
"""Share of the picture's width and height that the framed bodies may fill."""
CAMERA_SAMPLES = 40
"""Number of samples of a motion at which the camera keeps the framed bodies in the picture."""
_OPEN = (Phase.TARE, Phase.APPROACH)
_HELD = (Phase.SETTLE, Phase.RAMP, Phase.STEADY)


def light(model: mujoco.MjModel) -> None:
    """Set a sun over the workspace, a headlight, the field of view, and the default view of the bench."""
    model.vis.global_.fovy = FIELD_OF_VIEW
    model.vis.global_.azimuth, model.vis.global_.elevation = VIEWS["bench"].azimuth, VIEWS["bench"].elevation
    model.stat.center[:] = (0.3, 0.0, 0.25)
    model.stat.extent = 1.4
    model.vis.headlight.ambient[:] = 0.39
    model.vis.headlight.diffuse[:] = 0.22
    model.vis.headlight.specular[:] = 0.0
    sun = np.array([-0.35, 0.35, -1.0])
    model.light_type[:] = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    model.light_dir[:] = sun / np.linalg.norm(sun)
    model.light_pos[:] = model.stat.center - 1.5 * sun  # center of the shadow map
    model.light_diffuse[:] = 0.5
    model.light_specular[:] = 0.1
    model.vis.map.shadowclip = 1.0  # reach of the shadow map [extent]


def camera(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    view: View,
    aspect: float,
    pose: Callable[[int], None],
    samples: Iterable[int],
) -> mujoco.MjvCamera:
    """Still camera that keeps the bodies of a view in the picture at all samples.

    Args:
        model: the scene.
        data: positions, set by `pose`.
        view: viewing direction and bodies.
        aspect: width of the picture over its height.
        pose: puts the scene at a sample.
        samples: samples to consider.
    """
    geoms = bodies_named(model, view.frames)[model.geom_bodyid]
    points = []
    for sample in samples:
        pose(sample)
        points.append(_corners(model, data, geoms))
    forward, right, up = _axes(view)
    position, depth = _fit(np.concatenate(points), forward, right, up, aspect)
    eye = mujoco.MjvCamera()
    eye.type = mujoco.mjtCamera.mjCAMERA_FREE
    eye.azimuth, eye.elevation, eye.distance = view.azimuth, view.elevation, depth
    eye.lookat[:] = position + depth * forward
    return eye


def hide(model: mujoco.MjModel, view: View) -> None:
    """Hide the bodies that the view leaves out."""
    model.geom_rgba[bodies_named(model, view.hides)[model.geom_bodyid], 3] = 0.0


def bodies_named(model: mujoco.MjModel, prefixes: tuple[str, ...]) -> Bool[np.ndarray, "B"]:
    """True for bodies whose name has one of the prefixes."""
    return np.array([model.body(i).name.startswith(prefixes) for i in range(model.nbody)], dtype=bool)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Corners of the boxes around G geoms, world [m], shape (8 G, 3)."""
    center, half = np.split(model.geom_aabb[geoms], 2, axis=1)
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 3)
    local = center[:, None] + signs * half[:, None]
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gij,gcj->gci", turn, local)).reshape(-1, 3)


def _axes(view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, right and up of a free camera in MuJoCo."""
    azimuth, elevation = math.radians(view.azimuth), math.radians(view.elevation)
    level = math.cos(elevation)
    forward = np.array([level * math.cos(azimuth), level * math.sin(azimuth), math.sin(elevation)])
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return forward, right, np.cross(right, forward)


def _fit(
    points: Float[np.ndarray, "N 3"], forward: np.ndarray, right: np.ndarray, up: np.ndarray, aspect: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Nearest camera position with all points in its pyramid [m], and its distance to their middle [m].

    Where |x - x_c| <= a (z - z_c) holds for all points, x_c - a z_c >= max(x - a z) and x_c + a z_c <= min(x + a z);
    likewise up. The nearer of the two limits on z_c would cut points off.
    """
    slope_up = MARGIN * math.tan(math.radians(FIELD_OF_VIEW) / 2)
    depth = points @ forward
    middles, limits = [], []
    for axis, slope in ((right, slope_up * aspect), (up, slope_up)):
        low, high = (points @ axis - slope * depth).max(), (points @ axis + slope * depth).min()
        limits.append((high - low) / (2 * slope))
        middles.append((low + high) / 2)
    back = min(limits)
    position = back * forward + middles[0] * right + middles[1] * up
    return position, float((depth.min() + depth.max()) / 2 - back)


@lru_cache(maxsize=2)
def bench_model(*, meshes: bool = True) -> mujoco.MjModel:
    """Table, arm, sensor and gripper without an object, compiled once a process; see `build_scene` for `meshes`."""
    spec = part("table")
    attach_arm(spec, meshes=meshes)
    return spec.compile()


def opening(trajectory: Trajectory, pads: tuple[float, float]) -> Float[np.ndarray, "T"]:
    """Distance between the pads from the phases [m], shape (T,); 0 in a push.

    `pads` are the distances while they hold the object, and before and after.
    """
    phase, count = trajectory.phase, len(trajectory.phase)
    if trajectory.action.pushes:
        return np.zeros(count)
    closed = np.where(np.isin(phase, _OPEN), 0.0, 1.0)
    for moving, ends in ((Phase.GRASP, (0.0, 1.0)), (Phase.RELEASE, (1.0, 0.0))):
        inside = np.flatnonzero(phase == moving)
        closed[inside] = np.linspace(*ends, len(inside))
    if trajectory.tool is None:
        closed = np.zeros(count)
    return pads[1] + (pads[0] - pads[1]) * closed


def pose_bench(model: mujoco.MjModel, data: mujoco.MjData, trajectory: Trajectory, sample: int, opened: float) -> None:
    """Put arm and fingers at a sample of the record; `opened` is the distance between the pads [m]."""
    data.qpos[:7] = trajectory.joint_position[sample]
    for finger in ("gripper/left_finger", "gripper/right_finger"):
        data.qpos[model.joint(finger).qposadr[0]] = (STROKE - opened) / 2


@dataclass(frozen=True, eq=False)
class BodyPoses:
    """Poses of B bodies of the scene at T samples."""

    model: mujoco.MjModel
    """Model with the bodies, in order."""
    position: Float[np.ndarray, "T B 3"]
    """Position, world frame [m]."""
    orientation: Float[np.ndarray, "T B 4"]
    """Orientation, world frame, wxyz."""


def body_poses(trajectory: Trajectory, pads: tuple[float, float], *, meshes: bool = True, every: int = 1) -> BodyPoses:
    """Forward kinematics of a record.

    Args:
        trajectory: record of a trial with the arm.
        pads: distance between the pads while they hold, and before and after [m].
        meshes: see `build_scene`.
        every: take every `every`-th sample.
    """
    model = bench_model(meshes=meshes)
    data = mujoco.MjData(model)
    samples, opened = range(0, len(trajectory.time_s), every), opening(trajectory, pads)
    position = np.empty((len(samples), model.nbody, 3))
    orientation = np.empty((len(samples), model.nbody, 4))
    for row, sample in enumerate(samples):
        pose_bench(model, data, trajectory, sample, float(opened[sample]))
        mujoco.mj_kinematics(model, data)
        position[row], orientation[row] = data.xpos, data.xquat
    return BodyPoses(model, position, orientation)


class Playback:
    """Scene with the object of a record, at any of its samples."""

    def __init__(self, trajectory: Trajectory, obj: ObjectModel, pads: tuple[float, float], *, meshes: bool = True):
        """Compile the scene and show the first sample.

        Args:
            trajectory: the record.
            obj: the object; its masses and frictions are not used.
            pads: distance between the pads while they hold it, and before and after [m].
            meshes: see `build_scene`.

        Raises:
            InvalidValueError: a weighing, which has no motion.
        """
        if trajectory.tool is None:
            raise InvalidValueError("trial", "a weighing, where nothing moves", "a slide or a turn")
        spec = part("table")
        attach_arm(spec, meshes=meshes)
        if (tip := trajectory.action.fingertip(obj.shape)) is not None:
            add_tip(spec, tip, GripSettings().tcp_height)
        add_object(spec, obj, RIGID)
        self.model = spec.compile()
        light(self.model)
        self.data = mujoco.MjData(self.model)
        self.trajectory = trajectory
        self._opening = opening(trajectory, pads)
        self._object = object_pose(trajectory)
        self._in_space = _in_space(trajectory, obj.shape.height / 2)
        self._address = self.model.joint("object").qposadr[0]
        camera = trajectory.camera if obj.shape.chain is not None else None
        links = None if camera is None else camera.at(trajectory.time_s)
        self._links = None if links is None or np.isnan(links).any() else links  # a camera may miss a link
        if self._links is not None:  # the first link has the free joint, each other one a hinge on the one before
            self._object = self._links[:, 0]
        self.show(0)

    def show(self, sample: int) -> None:
        """Put arm, fingers and object at a sample of the record."""
        model, data, address = self.model, self.data, self._address
        pose_bench(model, data, self.trajectory, sample, float(self._opening[sample]))
        if self._in_space is not None:
            data.qpos[address : address + 7] = self._in_space[sample]
        else:
            x, y, yaw = self._object[sample]
            data.qpos[address : address + 2] = x, y  # the height and the upright axis are the model's own
            data.qpos[address + 3 : address + 7] = math.cos(yaw / 2), 0.0, 0.0, math.sin(yaw / 2)
        if self._links is not None:
            for hinge, angle in enumerate(np.diff(self._links[sample, :, 2])):
                data.qpos[model.joint(f"hinge_{hinge}").qposadr[0]] = angle
        data.time = self.trajectory.time_s[sample]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_camlight(model, data)


def object_pose(trajectory: Trajectory) -> Float[np.ndarray, "T 3"]:
    """Planar pose of the object, world frame [m, m, rad], from the hand while it holds the object; else at rest."""
    held = np.flatnonzero(trajectory.mask(*_HELD))
    first, last = (held[0], held[-1]) if len(held) else (-1, -1)
    count = len(trajectory.time_s)
    return trajectory.object_pose[np.clip(np.arange(count), first % count, last % count)]


def _in_space(trajectory: Trajectory, middle: float) -> Float[np.ndarray, "T 7"] | None:
    """Pose of the object's body in a lift [m, wxyz], at a height `middle` over its bottom [m]; None otherwise."""
    if not (trajectory.action.in_air and trajectory.mask(Phase.SETTLE).any()):
        return None
    origin, axes = poses_in_space(trajectory)
    orientation = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    return np.hstack([origin + middle * axes[:, :, 2], orientation])


@contextmanager
def drawing(
    playback: Playback, view: ViewName, width: int, height: int
) -> Iterator[Callable[[int], UInt8[np.ndarray, "H W 3"]]]:
    """Function that draws a sample of a record, by a still camera with the whole motion in the picture.

    Args:
        playback: the record in its scene.
        view: name in `VIEWS`.
        width: width of the picture [px].
        height: height of the picture [px].

    Raises:
        NoGraphicsError: a machine that cannot draw without a display.
    """
    model, data, chosen = copy(playback.model), playback.data, VIEWS[view]
    hide(model, chosen)
    options = mujoco.MjvOption()
    options.sitegroup[:] = 0
    samples = np.unique(np.linspace(0, len(playback.trajectory.time_s) - 1, CAMERA_SAMPLES).astype(int))
    eye = camera(model, data, chosen, width / height, playback.show, samples.tolist())
    with offscreen_renderer(model, width, height) as renderer:

        def draw(sample: int) -> UInt8[np.ndarray, "H W 3"]:
            playback.show(sample)
            renderer.update_scene(data, eye, options)
            return renderer.render()

        yield draw
