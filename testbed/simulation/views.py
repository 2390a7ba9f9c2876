"""How the bench is looked at: its light, and cameras that have everything in the picture throughout a motion."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float

ViewName = Literal["bench", "object", "above"]


@dataclass(frozen=True)
class View:
    """A direction to look in, and what is to be in the picture."""

    azimuth: float
    """Direction of looking, seen from above, deg from the world's x axis."""
    elevation: float
    """Of the direction of looking over the horizon, deg; negative looks down."""
    frames: tuple[str, ...]
    """Beginnings of the names of the bodies that are to be in the picture."""
    hides: tuple[str, ...] = ()
    """Beginnings of the names of the bodies that are left out."""


VIEWS: dict[ViewName, View] = {
    "bench": View(137, -24, ("arm/", "ft/", "gripper/", "object")),
    "object": View(137, -38, ("object", "gripper/left_finger", "gripper/right_finger")),
    "above": View(90, -89.99, ("object",), hides=("arm/", "ft/", "gripper/base")),
}
FIELD_OF_VIEW = 30.0
"""Vertical, deg: a long lens bends little."""
MARGIN = 0.9
"""Part of the picture's width and height that what is framed may fill."""


def light(model: mujoco.MjModel) -> None:
    """Even light for pictures, a sun over the workspace and a headlight, and a lens that takes in the arm."""
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
    model.light_pos[:] = model.stat.center - 1.5 * sun  # the middle of the map of shadows
    model.light_diffuse[:] = 0.5
    model.light_specular[:] = 0.1
    model.vis.map.shadowclip = 1.0  # the map reaches so many extents from its middle


def camera(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    view: View,
    aspect: float,
    pose: Callable[[int], None],
    samples: Iterable[int],
) -> mujoco.MjvCamera:
    """A still camera that has all that the view frames in the picture at all of the samples.

    Args:
        model: the bench.
        data: whose positions `pose` sets.
        view: where to look from.
        aspect: width of the picture over its height.
        pose: puts the bench at a sample.
        samples: at which to look.
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
    """Make what the view leaves out invisible."""
    model.geom_rgba[bodies_named(model, view.hides)[model.geom_bodyid], 3] = 0.0


def bodies_named(model: mujoco.MjModel, beginnings: tuple[str, ...]) -> Bool[np.ndarray, "B"]:
    """Which bodies have a name with one of these beginnings."""
    return np.array([model.body(i).name.startswith(beginnings) for i in range(model.nbody)], dtype=bool)


def _corners(model: mujoco.MjModel, data: mujoco.MjData, geoms: np.ndarray) -> np.ndarray:
    """Corners of the boxes around some geoms, m, world, (8 G, 3)."""
    centre, half = np.split(model.geom_aabb[geoms], 2, axis=1)
    signs = np.stack(np.meshgrid(*[[-1.0, 1.0]] * 3), axis=-1).reshape(8, 3)
    local = centre[:, None] + signs * half[:, None]
    turn = data.geom_xmat[geoms].reshape(-1, 3, 3)
    return (data.geom_xpos[geoms][:, None] + np.einsum("gij,gcj->gci", turn, local)).reshape(-1, 3)


def _axes(view: View) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, right and up of a camera, as MuJoCo has them for a free one."""
    azimuth, elevation = math.radians(view.azimuth), math.radians(view.elevation)
    forward = np.array(
        [
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        ]
    )
    right = np.array([math.sin(azimuth), -math.cos(azimuth), 0.0])
    return forward, right, np.cross(right, forward)


def _fit(
    points: Float[np.ndarray, "N 3"], forward: np.ndarray, right: np.ndarray, up: np.ndarray, aspect: float
) -> tuple[Float[np.ndarray, "3"], float]:
    """Nearest place of a camera from which all points are within its pyramid, m, and its distance to their middle, m.

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
