"""The Rerun viewer as a process of its own: on the screen, in a browser, or one that is already open."""

from __future__ import annotations

import os
import socket
import subprocess
import sys
import time
from collections.abc import Mapping
from importlib.util import find_spec
from pathlib import Path

from testbed.errors import HeftError

HOST, PORT = "127.0.0.1", 9876
"""Where a viewer listens: on this machine alone."""
_NO_GRAPHICS = ("No graphics adapter", "No suitable", "wgpu", "NoSuitableAdapterFound")


class ViewerError(HeftError):
    """The viewer cannot open here, or there is none."""


def url_of(port: int = PORT) -> str:
    """Address at which a viewer of this machine takes what is sent."""
    return f"rerun+http://{HOST}:{port}/proxy"


def listens(port: int = PORT) -> bool:
    """Whether something on this machine listens at a port."""
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex((HOST, port)) == 0


def free_port() -> int:
    """A port of this machine that nobody listens at."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def has_display(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether a window can open."""
    return sys.platform != "linux" or bool(environment.get("DISPLAY") or environment.get("WAYLAND_DISPLAY"))


def check_display(*, web: bool) -> None:
    """Whether there is something to show it on.

    Raises:
        ViewerError: no display, and no browser asked for.
    """
    if not web and not has_display():
        raise ViewerError(
            "no display (neither DISPLAY nor WAYLAND_DISPLAY is set): --web serves the viewer to a browser, "
            "heft record writes the file to be opened elsewhere, heft render makes a film"
        )


def open_file(path: Path) -> None:
    """Open a recording in the viewer, and wait until it is closed.

    Raises:
        ViewerError: no display, no graphics, or the viewer did not start.
    """
    check_display(web=False)
    command = [*program(), str(path), "--bind", HOST, "--port", str(free_port())]
    run = subprocess.run(command, env=environment(), stderr=subprocess.PIPE, text=True, check=False)
    if run.returncode:
        raise ViewerError(reason(run.stderr))


def waiting(port: int = PORT) -> str:
    """Address of a viewer that takes what is sent: the one that is open, or a new one.

    Raises:
        ViewerError: none is open, and none can be opened.
    """
    if listens(port):
        return url_of(port)
    if not has_display():
        raise ViewerError(
            f"no viewer listens at {HOST}:{port}, and there is no display to open one on (neither DISPLAY nor "
            "WAYLAND_DISPLAY is set): --record writes files, which `heft view --web` shows in a browser"
        )
    command = [*program(), "--bind", HOST, "--port", str(port), "--hide-welcome-screen", "--expect-data-soon"]
    process = subprocess.Popen(command, env=environment(), stderr=subprocess.DEVNULL, start_new_session=True)
    while process.poll() is None:
        if listens(port):
            return url_of(port)
        time.sleep(0.1)
    raise ViewerError("the viewer did not start: `rerun` says why")


def program() -> list[str]:
    """The viewer that is installed beside this Python, else the one on the path."""
    package = find_spec("rerun_cli")
    for folder in (package.submodule_search_locations or []) if package else []:
        for name in ("rerun", "rerun.exe"):  # the program itself: ending a wrapper would leave it running
            if (Path(folder) / name).is_file():
                return [str(Path(folder) / name)]
    raise ViewerError("the Rerun viewer is not installed: pip install 'rerun-sdk>=0.41,<0.42'")


def environment() -> dict[str, str]:
    """For the viewer: it sends no usage data where it takes itself to run in continuous integration."""
    said = {name: value for name, value in os.environ.items() if name != "FORCE_RERUN_ANALYTICS"}
    return said | {"CI": "true", "RUST_LOG": "warn"}


def reason(said: str) -> str:
    """One line on why a viewer ended, from what it wrote."""
    lines = [line.strip() for line in said.splitlines() if line.strip()]
    if any(word in line for line in lines for word in _NO_GRAPHICS):
        return "the viewer found no graphics: install a driver, or Mesa's: apt install mesa-vulkan-drivers libegl1"
    return f"the viewer ended: {lines[-1] if lines else 'no reason given'}"
