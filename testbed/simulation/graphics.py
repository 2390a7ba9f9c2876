"""Graphics of MuJoCo, offscreen or in a window: chosen before MuJoCo is imported; errors fit a line."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

from testbed.errors import HeftError

if TYPE_CHECKING:
    import mujoco

OFFSCREEN_PACKAGES = "libegl1 libegl-mesa0 libgl1 libgles2"
"""Packages of Debian and Ubuntu for drawing without a display."""
WINDOW_PACKAGES = "libgl1 libglx-mesa0 libx11-6 libxcursor1 libxi6 libxinerama1 libxrandr2"
"""Packages of Debian and Ubuntu for windows under X11."""


class NoGraphicsError(HeftError):
    """Machine that cannot draw, or has no display."""


def choose_offscreen() -> None:
    """Draw through EGL, unless MUJOCO_GL is set.

    Raises:
        NoGraphicsError: missing libraries.
    """
    os.environ.setdefault("MUJOCO_GL", "egl")
    with _errors_in_a_line():
        import mujoco  # noqa: PLC0415

        _ = mujoco.Renderer  # MuJoCo leaves it out if its libraries are missing


def choose_window() -> None:
    """Draw in windows on the display.

    Raises:
        NoGraphicsError: no display, or one that does not answer, or missing libraries.
    """
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if not display:
        raise NoGraphicsError(
            "cannot open a window: there is no display (neither DISPLAY nor WAYLAND_DISPLAY is set); "
            "heft view DIR TRIAL --film needs none"
        )
    os.environ["MUJOCO_GL"] = "glfw"
    os.environ.pop("PYOPENGL_PLATFORM", None)  # a process that draws without a display leaves "egl" to its children
    if (error := _glfw_error()) is not None:
        raise NoGraphicsError(
            f"cannot open a window on display {display} ({error}); start one there, or install what windows need "
            f"(Debian, Ubuntu: apt-get install {WINDOW_PACKAGES}); heft view DIR TRIAL --film needs no display"
        )


def _glfw_error() -> str | None:
    try:
        import glfw  # noqa: PLC0415
    except (ImportError, OSError) as error:
        return _first_line(error)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        if glfw.init():
            return None
    _, message = glfw.get_error()
    return _first_line(message.decode() if isinstance(message, bytes) else str(message))


@contextmanager
def offscreen_renderer(model: mujoco.MjModel, width: int, height: int) -> Iterator[mujoco.Renderer]:
    """Renderer of pictures of a width and height [px].

    Raises:
        NoGraphicsError: no driver.
    """
    import mujoco  # noqa: PLC0415  after `choose_offscreen`

    model.vis.global_.offwidth, model.vis.global_.offheight = width, height
    with _errors_in_a_line():
        renderer = mujoco.Renderer(model, height, width)
    with renderer:
        yield renderer


@contextmanager
def _errors_in_a_line() -> Iterator[None]:
    try:
        yield
    except Exception as error:  # its class depends on which library is missing and which module imports it
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
