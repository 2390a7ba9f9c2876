"""Rerun's web viewer for a browser on this machine, which is kept from talking to anybody else.

The viewer's page would send usage data and fetch fonts and examples. The page is passed on from Rerun's own server with
a Content-Security-Policy that lets the browser connect to this machine alone.
"""

from __future__ import annotations

import subprocess
import time
import urllib.parse
import urllib.request
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from threading import Thread

from viz.viewer import HOST, ViewerError, environment, free_port, program

POLICY = (
    "default-src 'self' blob: data: 'unsafe-inline' 'unsafe-eval' 'wasm-unsafe-eval'; connect-src 'self' data: blob:; "
    "font-src 'self' data:; style-src 'self' 'unsafe-inline'; form-action 'none'; frame-ancestors 'none'"
)
RECORDING = "recording.rrd"
_STARTING_S = 20.0


@contextmanager
def served(recording: Path) -> Iterator[str]:
    """Serve the viewer with a recording while the block lasts; gives the address to open.

    Raises:
        ViewerError: the viewer did not start.
    """
    source = free_port()
    command = [*program(), "--serve-web", "--bind", HOST, "--port", str(free_port()), "--web-viewer-port", str(source)]
    process = subprocess.Popen(command, env=environment(), stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        _wait(process, f"http://{HOST}:{source}/")
        server = ThreadingHTTPServer((HOST, 0), partial(_Handler, recording, f"http://{HOST}:{source}"))
        Thread(target=server.serve_forever, daemon=True).start()
        address = f"http://{HOST}:{server.server_address[1]}"
        try:
            recorded = urllib.parse.quote(f"{address}/{RECORDING}", safe="")
            yield f"{address}/?url={recorded}&hide_welcome_screen&persist=0"
        finally:
            server.shutdown()
            server.server_close()
    finally:
        process.kill()
        process.wait()


class _Handler(BaseHTTPRequestHandler):
    """The recording, and what Rerun's server has."""

    def __init__(self, recording: Path, source: str, *rest):
        self._recording, self._source = recording, source
        super().__init__(*rest)

    def do_GET(self) -> None:
        """Pass a file on, under the policy."""
        path = urllib.parse.urlsplit(self.path).path
        try:
            if path == f"/{RECORDING}":
                kind, content = "application/octet-stream", self._recording.read_bytes()
            else:
                with urllib.request.urlopen(self._source + path, timeout=_STARTING_S) as found:
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
        """Nobody reads it."""


def _wait(process: subprocess.Popen[bytes], address: str) -> None:
    until = time.monotonic() + _STARTING_S
    while process.poll() is None and time.monotonic() < until:
        try:
            urllib.request.urlopen(address, timeout=2).close()
            return
        except OSError:
            time.sleep(0.1)
    raise ViewerError("the web viewer did not start: `rerun --serve-web` says why")
