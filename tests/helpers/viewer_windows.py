"""Rerun's viewer without a window, and pictures of it."""

import base64
import io
import itertools
import json
import shutil
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

import numpy as np
import pytest
from PIL import Image
from rerun.experimental import ViewerClient
from websockets.sync.client import connect

from viz.recordings.viewer import HOST, environment, free_port, program, url_of

needs_vulkan = pytest.mark.skipif(
    not any(
        Path(folder).glob("*.json")
        for folder in ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d")
        if Path(folder).is_dir()
    ),
    reason="no Vulkan driver for the viewer: apt install mesa-vulkan-drivers",
)
needs_browser = pytest.mark.skipif(shutil.which("chromium") is None, reason="no browser: apt install chromium")


@contextmanager
def viewer(path: Path | None, home: Path, port: int | None = None) -> Iterator[ViewerClient]:
    """The native viewer with a recording open, or without one, and `home` as its home directory."""
    port = port or free_port()
    opened = [] if path is None else [str(path)]
    command = [*program(), *opened, "--headless", "--bind", HOST, "--port", str(port), "--window-size", "1600x1000"]
    process = subprocess.Popen(command, env=environment() | {"HOME": str(home)}, stderr=subprocess.DEVNULL)
    try:
        client = _connected(process, port, empty=path is None)
        yield client
    finally:
        process.kill()
        process.wait()


def _connected(process: subprocess.Popen[bytes], port: int, *, empty: bool) -> ViewerClient:
    until = time.monotonic() + 60
    while process.poll() is None and time.monotonic() < until:
        try:
            client = ViewerClient.connect(url_of(port))
            state = client.get_state()
            if empty or (state.recordings and not state.loading and state.views):
                return client
        except Exception:  # it does not answer yet; the errors are of many types
            pass
        time.sleep(0.1)
    raise AssertionError(f"the viewer did not show the recording; it ended with {process.poll()}")


def picture(client: ViewerClient) -> np.ndarray:
    """Picture of the window, (H, W, 3), once two consecutive screenshots agree."""
    last = np.zeros(0)
    for _ in range(40):
        time.sleep(0.25)
        now = np.asarray(Image.open(io.BytesIO(client.take_screenshot())).convert("RGB")).astype(int)
        if last.shape == now.shape and np.abs(now - last).mean() < 0.5 and not is_blank(now):
            return now
        last = now
    return last


def is_blank(pixels: np.ndarray) -> bool:
    """True if a picture is nearly empty: few colors, or nearly all of one."""
    colors, counts = np.unique(pixels.reshape(-1, 3) // 8, axis=0, return_counts=True)
    return len(colors) < 40 or counts.max() > 0.97 * counts.sum()


def has_color(pixels: np.ndarray, color: tuple[int, int, int], least: int = 30, within: int = 24) -> bool:
    """True if at least `least` pixels differ from a color by less than `within` in every channel."""
    return int((np.abs(pixels - np.array(color)).max(axis=-1) < within).sum()) >= least


@contextmanager
def browser(address: str, folder: Path) -> Iterator[Callable[[], np.ndarray]]:
    """A headless browser with a page open; yields a function that returns the current picture, (H, W, 3).

    The picture comes over the debugging port: the browser's own screenshot comes too early on a busy machine. The log
    of connections is net.json.
    """
    profile = folder / "profile"
    command = ["chromium", "--headless=new", "--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader",
               "--ignore-gpu-blocklist", f"--user-data-dir={profile}", "--window-size=1400,900",
               "--remote-debugging-port=0", f"--log-net-log={folder / 'net.json'}", address]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        with connect(_debugged(profile / "DevToolsActivePort"), max_size=None) as page:
            numbers = itertools.count(1)

            def look() -> np.ndarray:
                number = next(numbers)
                page.send(json.dumps({"id": number, "method": "Page.captureScreenshot"}))
                while (reply := json.loads(page.recv(timeout=60))).get("id") != number:
                    pass
                png = base64.b64decode(reply["result"]["data"])
                return np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(int)

            yield look
    finally:
        process.terminate()  # not killed, so that its log is complete
        process.wait(30)


def _debugged(port_file: Path) -> str:
    """Debugging address of the only page of a browser that has just been started."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        time.sleep(0.2)
        try:
            port = port_file.read_text(encoding="utf-8").split()[0]
            with urlopen(f"http://{HOST}:{port}/json", timeout=10) as reply:
                pages = [target for target in json.load(reply) if target["type"] == "page"]
        except (OSError, IndexError, ValueError):  # it does not listen yet
            continue
        if pages:
            return pages[0]["webSocketDebuggerUrl"]
    raise AssertionError("the browser did not start")
