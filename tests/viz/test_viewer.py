"""Rerun's viewer in a window and in a browser, and the reasons where it cannot open."""

import http.client
import os
import re
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scenarios.cli.main import main
from scenarios.cli.terminal import orderly_end
from scenarios.views.pages import Recorder, page_of
from testbed.errors import InvalidValueError
from tests.helpers.viewer_windows import browser, has_color, is_blank, needs_browser, needs_vulkan, picture, viewer
from tests.helpers.waiting import until
from viz.recordings import viewer as viewers
from viz.recordings.page import save
from viz.recordings.viewer import ViewerError, served
from viz.style import AXIS_COLORS, NORMAL_FORCE, rgb


@pytest.fixture(scope="module")
def trial(turn_folder, turn_key, tmp_path_factory) -> Path:
    """The recording of a short turn."""
    path = tmp_path_factory.mktemp("trial") / "trial.rrd"
    save(page_of(turn_folder, turn_key), path)
    return path


def key_of(folder: Path, method: str) -> str:
    found = [p for p in folder.glob("estimates/*/result.json") if f'"{method}"' in p.read_text(encoding="utf-8")]
    return found[0].parent.name


@pytest.mark.slow
@needs_vulkan
def test_a_trial_is_drawn(trial, tmp_path):
    with viewer(trial, tmp_path) as client:
        client.set_time("sim_time", duration=4.5, play_state="paused")
        pixels, state = picture(client), client.get_state()
    check_views(pixels, state)
    assert {view.view_class for view in state.views} == {"3D", "TimeSeries", "StateTimeline", "TextDocument"}
    assert [t.name for t in state.recordings[0].timelines] == ["sim_time"]
    half = pixels.shape[1] * 11 // 20
    assert has_color(pixels[:, half:], rgb(AXIS_COLORS[0])), "the force along x is drawn"
    assert has_color(pixels[:, :half], rgb(NORMAL_FORCE), least=5, within=60), "loads stand at the feet"
    assert not list(tmp_path.rglob("analytics*")), "nothing is kept to be sent"


ESTIMATE_VIEWS = (
    "true mass, estimated mass, absolute difference, mass of each group, log10 of the loss, velocities, facts"
)


@pytest.mark.slow
@needs_vulkan
@pytest.mark.parametrize(
    ("method", "views"), [("explicit_state", ESTIMATE_VIEWS), (None, "hidden_states: NAD, explicit_state: NAD")]
)
def test_an_estimate_and_a_comparison_are_drawn(finished_run, tmp_path, method, views):
    save(page_of(finished_run, key_of(finished_run, method) if method else "I2"), tmp_path / "x.rrd")
    with viewer(tmp_path / "x.rrd", tmp_path) as client:
        pixels, state = picture(client), client.get_state()
    check_views(pixels, state)
    names = " | ".join(view.name for view in state.views)
    assert [name for name in views.split(", ") if name not in names] == []


def check_views(pixels: np.ndarray, state) -> None:
    """Raises where the window is blank, or a view reports a fault."""
    assert not is_blank(pixels)
    assert not [(view.name, report.summary) for view in state.views for report in view.reports]


@pytest.mark.slow
@needs_browser
def test_a_browser_draws_it_and_talks_to_nobody_else(trial, tmp_path):
    with served(trial) as address, browser(address, tmp_path) as look:
        end = time.monotonic() + 120
        while not has_color(pixels := look(), rgb(AXIS_COLORS[0])):
            assert time.monotonic() < end, "the force along x is not drawn"
            time.sleep(1)
    log = (tmp_path / "net.json").read_text(encoding="utf-8", errors="replace")
    assert not is_blank(pixels)
    hosts = set(re.findall(r'"url":"(https?://[^/"]+)', log))
    foreign = {host for host in hosts if "127.0.0.1" not in host and not re.search(r"google|gvt1", host)}
    assert not foreign, "the browser's own maker aside"


@pytest.mark.slow
@needs_vulkan
def test_an_open_viewer_receives_trials_and_estimates(finished_run, tmp_path):
    port = viewers.free_port()
    turn = next(path.parent.name for path in finished_run.glob("trials/*/foot_forces.parquet"))
    with viewer(None, tmp_path, port) as client:
        recorder = Recorder(finished_run, url=viewers.open_viewer(port))
        recorder("trial", turn)
        recorder("estimate", key_of(finished_run, "hidden_states"))

        def stores() -> str:
            return " ".join(recording.store_id for recording in client.get_state().recordings)

        assert until(lambda: f"trial {turn}" in stores() and "estimate" in stores(), 10), stores()


@pytest.fixture
def no_display(monkeypatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(sys, "platform", "linux")


@pytest.mark.usefixtures("no_display")
def test_without_a_display_the_command_names_the_other_ways(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        main(["view", str(tmp_path)])
    output = capsys.readouterr().err
    assert (ended.value.code, output.count("\n")) == (2, 1)
    assert "--web" in output
    with pytest.raises(viewers.ViewerError, match="no viewer listens"):
        viewers.open_viewer(viewers.free_port())


def test_an_open_viewer_is_used():
    with socket.create_server((viewers.HOST, 0)) as server:
        port = server.getsockname()[1]
        assert viewers.open_viewer(port) == f"rerun+http://127.0.0.1:{port}/proxy"


SERVING = """
import sys
from pathlib import Path
from threading import Event
from scenarios.cli.terminal import orderly_end
from viz.recordings.viewer import served
with orderly_end(), served(Path(sys.argv[1]), int(sys.argv[2])) as address:
    print(address, flush=True)
    Event().wait()
"""


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGHUP])
def test_a_signal_ends_a_block_in_order_and_once(end):
    closed = []
    signal.signal(end, signal.SIG_DFL)  # these tests may run under nohup
    with pytest.raises(SystemExit) as ended, orderly_end():
        try:
            os.kill(os.getpid(), end)
            time.sleep(10)
        finally:
            os.kill(os.getpid(), end)
            closed.append(end)
    assert (ended.value.code, closed) == (128 + end, [end])
    assert signal.getsignal(end) is signal.SIG_DFL


def test_an_ignored_signal_stays_ignored():
    earlier = signal.signal(signal.SIGHUP, signal.SIG_IGN)  # as nohup does
    try:
        with orderly_end():
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, earlier)


@pytest.mark.slow
@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL])
def test_a_server_that_is_ended_leaves_nothing_running(tmp_path, monkeypatch, end):
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")  # nobody is there
    port, recording = viewers.free_port(), tmp_path / "page.rrd"
    recording.write_bytes(b"all that was measured")
    command = [sys.executable, "-c", SERVING, str(recording), str(port)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process, ExitStack() as ending:
        ending.callback(process.kill)  # else a failure waits for it for ever
        assert process.stdout is not None
        address = process.stdout.readline().strip()
        assert address.startswith(f"http://127.0.0.1:{port}/?url=http%3A%2F%2F127.0.0.1%3A{port}%2Frecording.rrd")
        served = {}
        for host in (f"127.0.0.1:{port}", "localhost:9090", "stranger.example"):
            request = http.client.HTTPConnection("127.0.0.1", port)
            request.request("GET", "/recording.rrd", headers={"Host": host})
            response = request.getresponse()
            served[host] = response.status, response.read() == recording.read_bytes()
        assert [*served.values()] == [(200, True), (200, True), (403, False)], "the data come from the page's own port"
        children = Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        assert children
        process.send_signal(end)
        assert process.wait(10) == (-end if end == signal.SIGKILL else 128 + end)
        until(lambda: not any(Path(f"/proc/{child}").exists() for child in children))
    assert not [child for child in children if Path(f"/proc/{child}").exists()]


def test_a_port_is_free_and_of_the_web_page(tmp_path, capsys):
    with socket.create_server((viewers.HOST, 0)) as taken:
        for port, why in ((taken.getsockname()[1], "in use"), (-1, "1024 to 65535"), (65536, "1024 to 65535")):
            with (
                pytest.raises(InvalidValueError, match=rf"--port: got {port}; allowed: .*{why}"),
                served(tmp_path, port),
            ):
                pass
    with pytest.raises(SystemExit):
        main(["view", str(tmp_path), "--port", "9090"])
    assert "--port: got 9090; allowed: only with --web" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("output", "part"),
    [
        ("thread 'main' panicked\nNo graphics adapter was found", "mesa-vulkan-drivers"),
        ("one\n\nthe last line\n", "the last line"),
        ("", "no reason given"),
    ],
)
def test_the_reason_why_a_viewer_ended_is_one_line(output, part):
    assert part in viewers.reason(output)
    assert "\n" not in viewers.reason(output)


@pytest.mark.parametrize("platform", ["linux", "darwin"])
def test_the_viewer_ends_with_heft_by_prctl_on_linux_alone(monkeypatch, tmp_path, platform):
    given: dict[str, Any] = {}

    def start(*_: object, **options: Any) -> None:
        given.update(options)
        raise ViewerError("not started")

    monkeypatch.setattr(sys, "platform", platform)
    monkeypatch.setattr(subprocess, "Popen", start)
    with pytest.raises(ViewerError, match="not started"), served(tmp_path):
        pass
    assert (given["preexec_fn"] is not None) == (platform == "linux")


def test_the_viewer_sends_no_usage_data(monkeypatch):
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    environment = viewers.environment()
    assert environment["CI"] == "true"
    assert "FORCE_RERUN_ANALYTICS" not in environment
