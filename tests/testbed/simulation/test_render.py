"""Playback and pictures of a record: everything is where the record has it."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import av
import mujoco
import numpy as np
import pytest
from numpy.testing import assert_allclose
from PIL import Image

from scenarios.cli.film import FILM_S, RenderRequest, nearest, pace_of
from scenarios.cli.main import main
from scenarios.results.files import write_json
from scenarios.results.store import key_of, trial_request
from scenarios.results.trials import TrialRecord, read_trial
from testbed import Phase, Rotate, SimulationSettings, Slide, Trial, load_object
from testbed.frames import transform_point
from testbed.objects.colors import group_rgba
from testbed.simulation.rendering import FIELD_OF_VIEW, MARGIN, VIEWS, Playback, bodies_named, camera, hide, object_pose
from tests.helpers.commands import ended
from tests.helpers.simulated import put_trial

ROOT = Path(__file__).parents[3]
SIZE = (240, 160)
THIRD = group_rgba(2)[:3]
"""Color of L2's third block, at the far end of its foot."""
PROBE = "import mujoco.egl; mujoco.egl.GLContext(8, 8).free()"
EGL = os.environ | {"MUJOCO_GL": "egl"}


@lru_cache(maxsize=1)
def why_no_egl() -> str:
    """Reason why this machine cannot draw; empty where it can. Found without heft's own code."""
    done = run("-c", PROBE)
    return "" if done.returncode == 0 else done.stderr.strip().splitlines()[-1]


@pytest.fixture(scope="module")
def egl():
    if why_no_egl():
        pytest.skip(f"no EGL here: {why_no_egl()}")


@pytest.fixture(scope="module")
def root(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def turn(root) -> TrialRecord:
    """L2 held by the top of its column and turned by 40 degrees."""
    return read_trial(root, put_trial(root, "L2", Rotate(4, speed=0.35, duration=2.0)))


@pytest.fixture(scope="module")
def slide(root) -> TrialRecord:
    return read_trial(root, put_trial(root, "hammer", Slide(1, direction=0.7, duration=0.5)))


RATE, SPEED = 2, 2.0
"""Pictures a second in the film, and the film's pace."""
FILM = f"--width {SIZE[0]} --height {SIZE[1]} --fps {RATE} --speed {SPEED} --no-caption".split()
PICTURE = ["--at", "1.0", "--width", "480", "--height", "320"]


@pytest.fixture(scope="module")
def drawn(egl, root, turn, slide, tmp_path_factory) -> Path:
    """A folder of films and pictures, made by one process."""
    folder = tmp_path_factory.mktemp("drawn")

    def render(record: TrialRecord, out: str, *words: str) -> list[str]:
        return ["view", str(root), record.folder.name[:9], "--film", "--out", str(folder / out), *words]

    done = heft(
        render(turn, "turn.mp4", "--camera", "above", *FILM),
        render(turn, "turn.png", *PICTURE),
        render(slide, "slide.png", *PICTURE),
    )
    assert done.returncode == 0, done.stderr
    written = [line for line in done.stdout.splitlines() if line.startswith(str(folder))]
    assert written == [str(folder / name) for name in ("turn.mp4", "turn.png", "slide.png")]
    return folder


@pytest.fixture(params=["turn", "slide"])
def record(request) -> TrialRecord:
    return request.getfixturevalue(request.param)


def played(record: TrialRecord, *, meshes: bool = False) -> Playback:
    return Playback(record.trajectory, record.object, record.pads, meshes=meshes)


def run(*words: str, env: dict[str, str] = EGL) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, *words]
    return subprocess.run(command, cwd=ROOT, env=env, capture_output=True, text=True, check=False, timeout=120)


def heft(*commands: list[str], env: dict[str, str] = EGL, before: str = "") -> subprocess.CompletedProcess[str]:
    """Commands in a process of their own, which has yet to import MuJoCo."""
    code = "\n".join([before, "from scenarios.cli.main import main", *(f"main({words!r})" for words in commands)])
    return run("-c", code, env=env)


def test_hand_pads_and_object_are_where_the_record_has_them(record):
    playback, trajectory = played(record), record.trajectory
    for sample in range(0, len(trajectory.time_s), 20):
        playback.show(sample)
        assert_allclose(playback.data.site("gripper/tcp").xpos, trajectory.tcp_position[sample], atol=2e-5)
        assert playback.data.time == trajectory.time_s[sample]

    steady = int(trajectory.mask(Phase.STEADY).argmax())
    playback.show(steady)
    left, right = (playback.data.geom(f"gripper/{side}_pad").xpos for side in ("left", "right"))
    assert_allclose(np.linalg.norm(left - right) - 2 * 0.004, record.pads[0], atol=1e-9)
    grasp = record.object.shape.grasps[trajectory.action.grasp]
    held = transform_point(object_pose(trajectory)[steady], grasp.position)
    assert_allclose((left + right)[:2] / 2, held, atol=1e-3)

    pose, moving = object_pose(trajectory), trajectory.mask(Phase.SETTLE, Phase.RAMP, Phase.STEADY)
    assert_allclose(pose[moving], trajectory.object_pose[moving])
    first, last = np.flatnonzero(moving)[[0, -1]]
    assert np.ptp(pose[: first + 1], axis=0).max() == np.ptp(pose[last:], axis=0).max() == 0
    assert np.linalg.norm(pose[-1, :2] - pose[0, :2]) > 0.02
    for sample in (0, first, last, len(pose) - 1):
        playback.show(int(sample))
        x, y, yaw = pose[sample]
        body = playback.data.body("object")
        assert_allclose(body.xpos, [x, y, record.object.shape.height / 2], atol=1e-12)
        assert_allclose(body.xmat.reshape(3, 3)[:, 0], [math.cos(yaw), math.sin(yaw), 0], atol=1e-12)


def projected(points: np.ndarray, playback: Playback, eye: mujoco.MjvCamera, aspect: float) -> np.ndarray:
    """Points in MuJoCo's own picture, -1 to 1 from left to right and from bottom to top."""
    scene = mujoco.MjvScene(playback.model, maxgeom=1000)
    mujoco.mjv_updateScene(
        playback.model, playback.data, mujoco.MjvOption(), None, eye, mujoco.mjtCatBit.mjCAT_ALL, scene
    )
    left, right = scene.camera  # of a stereo pair
    forward, up = np.array(left.forward), np.array(left.up)
    away = points - (np.array(left.pos) + np.array(right.pos)) / 2
    slope = math.tan(math.radians(FIELD_OF_VIEW) / 2)
    across, along = away @ np.cross(forward, up), away @ up
    return np.stack([across / aspect, along], axis=-1) / (slope * (away @ forward))[:, None]


def corners(playback: Playback, view: str) -> np.ndarray:
    """Corners of the boxes around all geoms that a view frames, m, world."""
    model, data, found = playback.model, playback.data, []
    for geom in np.flatnonzero(bodies_named(model, VIEWS[view].frames)[model.geom_bodyid]):  # pyright: ignore[reportArgumentType]
        center, half = model.geom_aabb[geom, :3], model.geom_aabb[geom, 3:]
        for signs in np.ndindex(2, 2, 2):
            local = center + (2 * np.array(signs) - 1) * half
            found.append(data.geom_xpos[geom] + data.geom_xmat[geom].reshape(3, 3) @ local)
    return np.array(found)


@pytest.mark.parametrize("view", VIEWS)
@pytest.mark.parametrize(("name", "aspect"), [("turn", 1.5), ("slide", 0.6)])
def test_the_whole_motion_is_in_the_picture_and_fills_it(name, view, aspect, request):
    record = request.getfixturevalue(name)
    playback = played(record)
    samples = np.linspace(0, len(record.trajectory.time_s) - 1, 12).astype(int).tolist()
    eye = camera(playback.model, playback.data, VIEWS[view], aspect, playback.show, samples)
    places = []
    for sample in samples:
        playback.show(sample)
        places.append(projected(corners(playback, view), playback, eye, aspect))
    extent = np.abs(np.concatenate(places)).max(axis=0)
    assert_allclose(extent.max(), MARGIN, atol=1e-3)


def test_above_leaves_out_the_arm_alone(turn):
    playback = played(turn)
    hide(playback.model, VIEWS["above"])
    visible = {playback.model.body(b).name for b in playback.model.geom_bodyid[playback.model.geom_rgba[:, 3] > 0]}
    assert visible == {"world", "object", "gripper/left_finger", "gripper/right_finger"}


def test_times_of_a_film_are_the_nearest_samples():
    time_s = np.array([0.0, 0.01, 0.02, 0.05])
    assert nearest(time_s, np.array([-1.0, 0.004, 0.0051, 0.034, 0.036, 9.0])).tolist() == [0, 0, 1, 2, 3, 3]
    assert nearest(time_s[:1], np.array([0.0, 1.0])).tolist() == [0, 0]


def test_a_film_is_of_twenty_seconds_or_as_asked(turn):
    paces = [(208.0, None, 11), (200.0, None, 10), (12.0, None, 1), (208.0, 1.0, 1), (8.0, 0.5, 0.5)]
    for duration, asked, pace in paces:
        time_s = np.linspace(0, duration, len(turn.trajectory.time_s))
        assert pace_of(replace(turn.trajectory, time_s=time_s), RenderRequest(speed=asked)) == pace
        assert asked or duration / pace <= FILM_S


def middle_of(picture: np.ndarray, color: tuple[float, float, float]) -> np.ndarray:
    """Middle of all that has a color's hue, -1 to 1 from left to right and from bottom to top."""
    pixels = picture.astype(float)
    bright = pixels.max(axis=-1, keepdims=True)
    close = np.abs(pixels / np.maximum(bright, 1) - np.array(color) / max(color)).max(axis=-1) < 0.08
    assert close.sum() > 30
    row, column = (np.argwhere(close) + 0.5).mean(axis=0)
    height, width = picture.shape[:2]
    return np.array([2 * column / width - 1, 1 - 2 * row / height])


@pytest.mark.slow
def test_a_film_shows_the_object_where_the_record_has_it(drawn, turn):
    trajectory = turn.trajectory
    length = trajectory.time_s[-1]
    with av.open(drawn / "turn.mp4") as film:
        stream = film.streams.video[0]
        assert (stream.width, stream.height, stream.average_rate) == (*SIZE, RATE)
        pictures = [frame.to_ndarray(format="rgb24") for frame in film.decode(stream)]
    assert len(pictures) == math.floor(length * RATE / SPEED) + 1
    playback, aspect = played(turn, meshes=True), SIZE[0] / SIZE[1]
    looks = np.unique(np.linspace(0, len(trajectory.time_s) - 1, 40).astype(int)).tolist()
    eye = camera(playback.model, playback.data, VIEWS["above"], aspect, playback.show, looks)
    shape, moved = turn.object.shape, []
    for i, picture in enumerate(pictures):
        sample = int(nearest(trajectory.time_s, np.array([i * SPEED / RATE]))[0])
        block = shape.particles[shape.mass_group == 2].mean(axis=0)
        top = np.append(transform_point(object_pose(trajectory)[sample], block), shape.height)
        playback.show(sample)
        expected = projected(top[None], playback, eye, aspect)[0]
        moved.append(expected)
        assert_allclose(middle_of(picture, THIRD), expected, atol=0.03)  # 4 px across: one side of the block shows too
    assert np.linalg.norm(np.ptp(moved, axis=0)) > 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["turn", "slide"])
def test_a_picture_is_lit_and_shows_table_arm_and_object(drawn, name):
    picture = np.asarray(Image.open(drawn / f"{name}.png"))
    assert picture.shape == (320, 480, 3)
    bright = picture.max(axis=-1)
    assert (bright > 250).mean() < 0.01 and (bright < 15).mean() < 0.05
    coarse = len(np.unique(picture.reshape(-1, 3) // 32, axis=0))
    assert coarse > 15
    warm = picture[..., 0].astype(int) - picture[..., 2]
    assert 0.2 < ((warm > 15) & (bright > 120)).mean() < 0.8  # the table
    assert (warm > 80).mean() > 1e-3  # a block, or the hammer's head


def test_trials_are_listed_by_object_support_and_grasp(tmp_path, capsys):
    made = [("I1", "rigid", None), ("I1", "own_weight", 1), ("L2", "rigid", 0), ("I1", "own_weight", 0)]
    made += [("hammer", "own_weight", 0)]
    for key, (name, support, grasp) in enumerate(made):
        kind = "slide" if name == "hammer" else "rotate"
        action = {"kind": "weigh"} if grasp is None else {"kind": kind, "grasp": grasp}
        content = {"asked": {"support": support, "action": action}, "names": {"object": name, "grasps": ["A1", "B1"]}}
        write_json(tmp_path / "trials" / f"{key:08}" / "trial.json", content | {"status": "ok"})
    write_json(tmp_path / "trials" / "of_other_format" / "trial.json", {})
    main(["view", str(tmp_path), "--film"])
    cells = [line.split()[1::2] for line in capsys.readouterr().out.splitlines() if line.count("│") > 5]
    assert len(cells) == 6, "the one of another format too"
    assert [row for row in cells if row[1] != "?"] == [
        ["00000003", "I1", "own_weight", "A1", "rotate", "ok"],
        ["00000001", "I1", "own_weight", "B1", "rotate", "ok"],
        ["00000000", "I1", "rigid", "-", "weigh", "ok"],
        ["00000002", "L2", "rigid", "A1", "rotate", "ok"],
        ["00000004", "hammer", "own_weight", "A1", "slide", "ok"],
    ]


NO_LIBRARY = """
import ctypes
load = ctypes.CDLL.__init__
def without_egl(self, name, *rest, **more):
    if name and "EGL" in str(name):
        raise OSError(f"{name}: cannot open shared object file: No such file or directory")
    load(self, name, *rest, **more)
ctypes.CDLL.__init__ = without_egl
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("env", "before", "advice"),
    [
        ({"MUJOCO_GL": "egl"}, NO_LIBRARY, "apt-get install libegl1"),
        ({"MUJOCO_GL": "egl", "__EGL_VENDOR_LIBRARY_FILENAMES": "/none"}, "", "apt-get install libegl1"),
        ({"MUJOCO_GL": "nonsense"}, "", "leave MUJOCO_GL unset"),
    ],
    ids=["no library", "no driver", "nonsense"],
)
def test_a_machine_that_cannot_draw_reports_what_to_install(root, slide, tmp_path, env, before, advice):
    out = tmp_path / "film.mp4"
    words = ["view", str(root), slide.folder.name, "--film", "--out", str(out)]
    done = heft(words, env=os.environ | env, before=before)
    assert done.returncode == 2
    assert len(done.stderr.splitlines()) == 1, done.stderr
    assert done.stderr.startswith("heft: cannot draw without a display") and advice in done.stderr
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (["nokey"], "TRIAL"),
        (["KEY", "--out", "film.avi"], "--out"),
        (["KEY", "--width", "111"], "--width"),
        (["KEY", "--speed", "0"], "--speed"),
        (["KEY", "--out", "one.png", "--at", "1e3"], "--at"),
        (["KEY", "--out", "film.mp4", "--at", "1"], "--at"),
        (["KEY", "--out", "one.png", "--speed", "2"], "--speed"),
    ],
)
def test_a_wrong_option_is_refused_in_a_line(root, slide, capsys, monkeypatch, tmp_path, words, field):
    monkeypatch.chdir(tmp_path)
    given = [slide.folder.name if word == "KEY" else word for word in words]
    assert ended("view", "--film", str(root), *given) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.startswith(f"heft: {field}: got")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_ctrl_c_leaves_nothing_half_written(egl, root, turn, tmp_path):
    out = tmp_path / "film.mp4"
    command = [sys.executable, "-m", "scenarios", "view", str(root), turn.folder.name, "--film", "--out", str(out)]
    process = subprocess.Popen(command, cwd=ROOT, env=EGL, stderr=subprocess.PIPE, text=True)
    begun = time.monotonic()
    while not any(path.stat().st_size > 0 for path in tmp_path.glob(".film.mp4.*.part")):
        assert process.poll() is None and time.monotonic() - begun < 60
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=60)
    assert process.returncode == 130
    assert errors == "heft: stopped; nothing was written\n"
    assert list(tmp_path.iterdir()) == []


def test_the_picture_of_the_readme_is_of_a_trial_of_the_main_run():
    """Keys are of what was asked: this is a turn that Algorithm 1's policy asks for on L2."""
    page = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
    found = re.search(r"heft view results/blocks ([0-9a-f]+) --film [^`]*--out docs/bench.png", page)
    assert found
    turn = Rotate(4, pivot=(-0.01666666666666667, 0.10833333333333334), back=True)
    asked = trial_request(Trial(load_object("L2"), turn), SimulationSettings())
    assert key_of(asked).startswith(found[1])
