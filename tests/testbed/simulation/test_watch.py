"""The interactive viewer: a live trial is the runner's, a replay the record's; without a display a line says so."""

import ctypes
import ctypes.util
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from PIL import ImageGrab

from scenarios.cli.film import grasp_index
from scenarios.results.trials import read_trial
from testbed import InvalidValueError, Rotate, SimulationRunner, Slide, Trial, Weigh, load_object
from testbed.simulation import feasibility
from testbed.simulation.rendering import Playback
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.simulation.watch import LiveTrial, Replay
from tests.helpers.commands import ended
from tests.helpers.simulated import put_trial

ROOT = Path(__file__).parents[3]
NO_ACTION = np.zeros(0)
TURN = Trial(load_object("L2"), Rotate(2, duration=0.5))
NO_DISPLAY = {name: value for name, value in os.environ.items() if name not in ("DISPLAY", "WAYLAND_DISPLAY")}


def run(*words: str, display: str) -> subprocess.CompletedProcess[str]:
    """Python on a display."""
    command, env = [sys.executable, *words], NO_DISPLAY | {"DISPLAY": display}
    return subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=60)


def steps(shown: LiveTrial | Replay) -> int:
    """Run it to its end."""
    assert shown.reset().first()
    for count in range(1, 100_000):
        if shown.step(NO_ACTION).last():
            return count
    raise AssertionError("it never ends")


@pytest.mark.slow
def test_a_live_trial_is_the_runners_each_time():
    trajectory, live = SimulationRunner().run_clean(TURN), LiveTrial(TURN)
    ends = []
    for _ in range(2):
        assert steps(live) == len(trajectory.time_s) == round(live.duration * 100)
        assert live.outcome().figures == trajectory.figures
        assert live.outcome().status == "ok"
        assert_allclose(live.physics.time(), live.duration)
        ends.append(np.array(live.physics.data.qpos))
    assert_array_equal(ends[0], ends[1])


@pytest.mark.slow
def test_a_live_trial_ends_where_the_object_slips(monkeypatch):
    monkeypatch.setattr(feasibility, "MARGIN", 100.0)
    weak = SimulationSettings(grip=GripSettings(force=20.0, friction=0.1))
    trial = Trial(load_object("L2"), Slide(1, duration=2.0))
    trajectory, live = SimulationRunner(weak).run_clean(trial), LiveTrial(trial, weak)
    assert steps(live) == len(trajectory.time_s) + 1 < live.duration * 100  # the runner leaves the last sample out
    assert trajectory.status == live.outcome().status == "slipped"
    assert live.outcome().reason == trajectory.reason


@pytest.mark.parametrize(
    ("show", "allowed"),
    [
        (LiveTrial, "a slide or a turn"),
        (lambda trial: Playback(SimulationRunner().run_clean(trial), trial.object, (0.05, 0.085)), "a slide or a turn"),
        (lambda trial: SimulationRunner().run_with_contacts(trial), "anything but a weighing"),
    ],
    ids=["live", "playback", "feet"],
)
def test_a_weighing_has_no_motion_and_no_feet(show, allowed: str):
    with pytest.raises(InvalidValueError, match=allowed):
        show(Trial(load_object("L2"), Weigh()))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory) -> tuple[Path, str]:
    """Results folder with a slide, and the trial's key."""
    root = tmp_path_factory.mktemp("results")
    return root, put_trial(root, "L2", Slide(1, duration=0.3))


def test_a_replay_steps_through_the_record(recorded):
    record = read_trial(*recorded)
    replay = Replay(Playback(record.trajectory, record.object, record.pads, meshes=False))
    time_s, joints = record.trajectory.time_s, record.trajectory.joint_position
    assert replay.physics.time() == time_s[0]
    for sample in (1, 2, 3):
        replay.step(NO_ACTION)
        assert replay.physics.time() == time_s[sample]
        assert_array_equal(replay.physics.data.qpos[:7], joints[sample])
    assert steps(replay) == len(time_s) - 1
    assert_array_equal(replay.physics.data.qpos[:7], joints[-1])
    replay.step(NO_ACTION)
    assert replay.physics.time() == time_s[-1]


def test_grasps_are_named():
    shape = load_object("hammer").shape
    names = [grasp.name for grasp in shape.grasps]
    assert [grasp_index(shape, name) for name in (None, *names)] == [0, *range(len(names))]
    with pytest.raises(InvalidValueError, match=f"^--grasp: got 'nose'; allowed: {names[0]}"):
        grasp_index(shape, "nose")


def test_without_a_display_a_line_says_what_to_do(recorded, monkeypatch: pytest.MonkeyPatch, capsys):
    root, key = recorded
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    for words in (["L2"], [str(root), key]):
        assert ended("watch", *words) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert (
            line.startswith("heft: cannot open a window: there is no display") and "heft view DIR TRIAL --film" in line
        )


@pytest.mark.slow
def test_a_display_that_does_not_answer_is_named():
    """In a process of its own, which has yet to import MuJoCo."""
    done = run("-m", "scenarios", "watch", "L2", display=":9871")
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line.startswith("heft: cannot open a window on display :9871") and "heft view DIR TRIAL --film" in line


@pytest.fixture
def display():
    """A display that nobody sees."""
    if shutil.which("Xvfb") is None or ctypes.util.find_library("Xtst") is None:
        pytest.skip("no Xvfb, or no keys for it, here (Debian: apt-get install xvfb libxtst6)")
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1100x850x24", "-nolisten", "tcp", "-noreset"]
    server = subprocess.Popen(command, pass_fds=(writing,), stderr=subprocess.DEVNULL)
    os.close(writing)
    with os.fdopen(reading) as told:
        name = f":{told.readline().strip()}"
    yield name
    server.terminate()
    server.wait(timeout=30)


def screen(name: str) -> np.ndarray:
    return np.asarray(ImageGrab.grab(xdisplay=name).convert("RGB"))


def wait_for(met, process: subprocess.Popen[str], seconds: float = 120.0) -> None:
    begun = time.monotonic()
    while not met():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() - begun < seconds
        time.sleep(0.5)


def press_space(name: str) -> None:
    """Presses a key like a keyboard."""
    x11, test = ctypes.CDLL("libX11.so.6"), ctypes.CDLL("libXtst.so.6")
    x11.XOpenDisplay.restype = ctypes.c_void_p
    screen = ctypes.c_void_p(x11.XOpenDisplay(name.encode()))
    code = x11.XKeysymToKeycode(screen, ctypes.c_ulong(0x20))
    for down in (1, 0):
        test.XTestFakeKeyEvent(screen, code, down, ctypes.c_ulong(0))
    x11.XCloseDisplay(screen)


@pytest.mark.slow
def test_a_window_opens_and_the_trial_runs_in_it(display):
    command = [sys.executable, "-m", "scenarios", "watch", "L2", "--action", "slide"]
    env = NO_DISPLAY | {"DISPLAY": display}
    process = subprocess.Popen(command, cwd=ROOT, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_for(lambda: len(np.unique(screen(display) // 32)) > 4, process)
        still = screen(display)
        table = still[..., 0].astype(int) - still[..., 2] > 15
        assert 0.1 < table.mean() < 0.8
        press_space(display)
        arm = (slice(0, 600), slice(0, 1024))  # the window's upper part, without its panel of figures
        wait_for(lambda: (np.abs(screen(display)[arm].astype(int) - still[arm]) > 40).mean() > 0.005, process)
        process.send_signal(signal.SIGINT)
        printed, errors = process.communicate(timeout=60)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    assert "space starts" in printed
    assert "ok until" in printed and "ok until 0.0" not in printed


INTERRUPTED = """
import os, signal
from testbed.simulation.graphics import choose_window
choose_window()
from testbed.actions.slide import Slide
from testbed.objects.files import load_object
from testbed.simulation.watch import LiveTrial, watch
from testbed.trial import Trial

class Pressed(LiveTrial):
    def reset(self):
        begun = super().reset()
        if shown:
            os.kill(os.getpid(), signal.SIGINT)
            print("pressed", flush=True)
        return begun

shown = False
live = Pressed(Trial(load_object("L2"), Slide(1, duration=0.1)))
shown, before = True, signal.getsignal(signal.SIGINT)
watch(live, "L2")
print("closed", signal.getsignal(signal.SIGINT) is before)
"""


@pytest.mark.slow
def test_ctrl_c_within_a_step_is_heard(display):
    done = run("-c", INTERRUPTED, display=display)
    assert done.returncode == 0, done.stderr
    assert done.stdout.split() == ["pressed", "closed", "True"]
