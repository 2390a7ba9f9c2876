"""How MuJoCo draws: without a display or in a window. Chosen before MuJoCo is imported; one line where it cannot."""

from __future__ import annotations

import math
import os
import warnings
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import mujoco
import numpy as np
from jaxtyping import Bool, Float

from testbed.errors import HeftError

if TYPE_CHECKING:
    import mujoco


OFFSCREEN_PACKAGES = "libegl1 libegl-mesa0 libgl1 libgles2"
"""What Debian and Ubuntu need to draw without a display."""
WINDOW_PACKAGES = "libgl1 libglx-mesa0 libx11-6 libxcursor1 libxi6 libxinerama1 libxrandr2"
"""What Debian and Ubuntu need to open a window under X11."""


class NoGraphicsError(HeftError):
    """A machine that cannot draw, or has nowhere to show it."""


def choose_offscreen() -> None:
    """Draw through EGL, unless MUJOCO_GL says otherwise.

    Raises:
        NoGraphicsError: its libraries are missing.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    with _told_in_a_line():
        import mujoco  # noqa: PLC0415

        _ = mujoco.Renderer  # left out where its libraries are missing


def choose_window() -> None:
    """Draw in windows on the display.

    Raises:
        NoGraphicsError: there is no display, it does not answer, or the libraries for windows are missing.
    """
    if not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise NoGraphicsError(
            "cannot open a window: there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "heft render makes a film without one; see also heft view"
        )
    os.environ["MUJOCO_GL"] = "glfw"
    os.environ.pop("PYOPENGL_PLATFORM", None)  # a process that draws without a display leaves "egl" to its children
    said = _why_no_window()
    if said is not None:
        where = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
        raise NoGraphicsError(
            f"cannot open a window on display {where} ({said}); start one there, or install what windows need "
            f"(Debian, Ubuntu: apt-get install {WINDOW_PACKAGES}); heft render makes a film without a display"
        )


def _why_no_window() -> str | None:
    """What GLFW complains of, in a line; None where it can open windows."""
    try:
        import glfw  # noqa: PLC0415
    except (ImportError, OSError) as error:
        return _first_line(error)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if glfw.init():
            return None
    _, said = glfw.get_error()
    return _first_line(said.decode() if isinstance(said, bytes) else str(said))


@contextmanager
def offscreen_renderer(model: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.Renderer]:
    """A renderer of pictures of a size, px.

    Raises:
        NoGraphicsError: there is no driver for it.
    """
    import mujoco  # noqa: PLC0415  with the choice made

    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    with _told_in_a_line():
        renderer = mujoco.Renderer(model, height, width)
    with renderer:
        yield renderer


@contextmanager
def _told_in_a_line() -> Iterator[None]:
    try:
        yield
    except Exception as error:  # which one depends on the library that is missing, and on who misses it
        chosen = os.environ.get("MUJOCO_GL", "")
        advice = (
            f"install EGL (Debian, Ubuntu: apt-get install {OFFSCREEN_PACKAGES})"
            if chosen == "egl"
            else "leave MUJOCO_GL unset, or set it to egl"
        )
        raise NoGraphicsError(
            f"cannot draw without a display: MUJOCO_GL={chosen} does not work here ({_first_line(error)}); {advice}"
        ) from None


def _first_line(error: BaseException | Warning | str) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")


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
