"""Rerun's viewer as a separate process: a new window, a page in a browser, or a window that is already open."""

from __future__ import annotations

import ctypes
import os
import signal
import socket
import subprocess
import sys
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

from testbed.errors import HeftError, InvalidValueError

HOST, PORT = "127.0.0.1", 9876
"""Address at which a viewer listens: local connections only."""
_NO_GRAPHICS = ("No graphics adapter", "No suitable", "wgpu", "NoSuitableAdapterFound")


class ViewerError(HeftError):
    """Viewer that is not installed, cannot open or did not start."""


def url_of(port: int) -> str:
    """Address at which a viewer of this machine receives recordings."""
    return f"rerun+http://{HOST}:{port}/proxy"


def listens(port: int = PORT) -> bool:
    """True if a process of this machine listens at a port."""
    with socket.socket() as probe:
        probe.settimeout(0.5)
        return probe.connect_ex((HOST, port)) == 0


def free_port() -> int:
    """Port of this machine that is not in use."""
    with socket.socket() as probe:
        probe.bind((HOST, 0))
        return probe.getsockname()[1]


def has_display() -> bool:
    """True if a window can open."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def check_display(*, web: bool) -> None:
    """Check that the viewer has a display, unless it is served to a browser.

    Raises:
        ViewerError: no display, and not `web`.
    """
    if not web and not has_display():
        raise ViewerError(
            "no display (neither DISPLAY nor WAYLAND_DISPLAY is set): --web serves the viewer to a browser, "
            "heft view DIR --record writes the file to be opened elsewhere, --film makes a film"
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


def open_viewer(port: int = PORT) -> str:
    """Address of a viewer that receives recordings: the open one, or a new one.

    Raises:
        ViewerError: no viewer is open, and none can be opened.
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
    """Command of the viewer that is installed beside this Python."""
    package = find_spec("rerun_cli")
    for folder in (package.submodule_search_locations or []) if package else []:
        for name in ("rerun", "rerun.exe"):  # the program itself: ending a wrapper would leave it running
            if (Path(folder) / name).is_file():
                return [str(Path(folder) / name)]
    raise ViewerError("the Rerun viewer is not installed: pip install 'rerun-sdk>=0.41,<0.42'")


def environment() -> dict[str, str]:
    """Environment of the viewer: as in continuous integration, where it sends no usage data."""
    own = {name: value for name, value in os.environ.items() if name != "FORCE_RERUN_ANALYTICS"}
    return own | {"CI": "true", "RUST_LOG": "warn"}


def reason(output: str) -> str:
    """Reason for a viewer's end, in one line, from its output."""
    lines = [line.strip() for line in output.splitlines() if line.strip()]
    if any(word in line for line in lines for word in _NO_GRAPHICS):
        return "the viewer found no graphics: install a driver, or Mesa's: apt install mesa-vulkan-drivers libegl1"
    return f"the viewer ended: {lines[-1] if lines else 'no reason given'}"


POLICY = (
    "default-src 'self' blob: data: 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; connect-src 'self' data: blob:; "
    "font-src 'self' data:; style-src 'self' 'unsafe-inline'; form-action 'none'; frame-ancestors 'none'"
)
RECORDING = "recording.rrd"
_STARTING_S = 20.0
_OWN_NAMES = (HOST, "localhost", "::1")
_PR_SET_PDEATHSIG = 1
"""linux/prctl.h"""
_LIBC = ctypes.CDLL(None)
_open = urllib.request.build_opener(urllib.request.ProxyHandler({})).open
"""Opener of addresses of this machine, without any proxy."""


@contextmanager
def served(recording: Path, port: int = 0) -> Iterator[str]:
    """Serve the viewer and a recording during the block; yields the address to open.

    Args:
        recording: file.
        port: of this machine, for both the page and the data; a free one if 0.

    Raises:
        ViewerError: the viewer did not start.
        InvalidValueError: the port is in use, or reserved.
    """
    source = free_port()
    try:
        server = ThreadingHTTPServer((HOST, port), partial(_Handler, recording, f"http://{HOST}:{source}"))
    except (OSError, OverflowError) as error:
        allowed = f"a free port of this machine, from 1024 to 65535 ({getattr(error, 'strerror', None) or error})"
        raise InvalidValueError("--port", port, allowed) from None
    with server, _rerun(source):
        thread = Thread(target=server.serve_forever, daemon=True)
        thread.start()
        address = f"http://{HOST}:{server.server_address[1]}"
        try:
            recorded = urllib.parse.quote(f"{address}/{RECORDING}", safe="")
            yield f"{address}/?url={recorded}&hide_welcome_screen&persist=0"
        finally:
            server.shutdown()


@contextmanager
def _rerun(source: int) -> Iterator[None]:
    """Run Rerun's own server of the viewer's files at a port during the block."""
    command = [*program(), "--serve-web", "--bind", HOST, "--port", str(free_port()), "--web-viewer-port", str(source)]
    quiet = subprocess.DEVNULL
    before = _end_with_heft if sys.platform == "linux" else None
    process = subprocess.Popen(command, env=environment(), stdout=quiet, stderr=quiet, preexec_fn=before)  # noqa: PLW1509  prctl alone
    try:
        _wait_for_answer(process, f"http://{HOST}:{source}/")
        yield
    finally:
        process.kill()
        process.wait()


def _end_with_heft() -> None:
    """Request, in a new process, that the kernel kills it when its parent ends."""
    _LIBC.prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)


class _Handler(BaseHTTPRequestHandler):
    """Handler of requests for the recording and for the files of Rerun's server."""

    def __init__(self, recording: Path, source: str, *rest):
        self._recording, self._source = recording, source
        super().__init__(*rest)

    def do_GET(self) -> None:
        """Send a file with the content policy; refuse host names other than this machine's (DNS rebinding)."""
        if urllib.parse.urlsplit(f"//{self.headers.get('Host', '')}").hostname not in _OWN_NAMES:
            self.send_error(403, "another host's name")
            return
        path = urllib.parse.urlsplit(self.path).path
        try:
            if path == f"/{RECORDING}":
                kind, content = "application/octet-stream", self._recording.read_bytes()
            else:
                with _open(self._source + path, timeout=_STARTING_S) as found:
                    kind, content = found.headers.get_content_type(), found.read()
        except (OSError, ValueError):
            self.send_error(404)
            return
        self.send_response(200)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(len(content)))
        self.send_header("Content-Security-Policy", POLICY)
        self.send_header("Cache-Control", "no-store")
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, format: str, *args: object) -> None:
        """Keep quiet."""


def _wait_for_answer(process: subprocess.Popen[bytes], address: str) -> None:
    """Wait until a server answers; raises ViewerError after _STARTING_S, or where its process ended."""
    until = time.monotonic() + _STARTING_S
    while process.poll() is None and time.monotonic() < until:
        try:
            _open(address, timeout=2).close()
            return
        except OSError:
            time.sleep(0.1)
    raise ViewerError("the web viewer did not start: `rerun --serve-web` says why")
