"""How MuJoCo draws: without a display or in a window. Chosen before MuJoCo is imported; one line where it cannot."""

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
