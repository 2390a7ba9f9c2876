"""The camera of the real robot: datagrams over a real socket, and what the runner makes of frames."""

import json
import math
import socket
import sys
import time
from dataclasses import replace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import drawn_object
from testbed import InvalidValueError, faces
from testbed.actions.push import SPEEDS, Push
from testbed.robot.camera.interface import CameraLostError, ObjectCamera, SeenFrame, SeenPose, seen_stream
from testbed.robot.camera.udp import UdpCamera
from testbed.robot.camera.watch import CameraWatch
from testbed.robot.config import RobotFile
from testbed.robot.interfaces import MonotonicClock
from testbed.robot.registry import build_camera
from testbed.sensing.camera import CAMERAS
from tests.fakes.analytic_push import drag_of
from tests.fakes.robot import Entered
from tests.helpers.pages import DOCS
from tests.helpers.waiting import until


def sent(camera: UdpCamera, *messages: object) -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for message in messages:
            raw = message if isinstance(message, bytes) else json.dumps(message).encode()
            sender.sendto(raw, ("127.0.0.1", camera.port))


def drained(camera: UdpCamera, count: int) -> list[SeenFrame]:
    found: list[SeenFrame] = []

    def enough() -> bool:
        found.extend(camera.drain())
        return len(found) >= count

    until(enough)
    return found


def test_frames_come_with_their_age_and_their_gaps():
    with UdpCamera(port=0) as camera:
        assert isinstance(camera, ObjectCamera)
        before = time.monotonic()
        sent(camera, {"poses": [[0.4, 0.1, 0.5], None]}, {"poses": [[0.4, 0.1, 0.5], [0.5, 0.2, -3.0]], "age_s": 0.8})
        first, second = drained(camera, 2)
    assert_allclose(first.poses, [[0.4, 0.1, 0.5], [math.nan] * 3], atol=1e-12)
    assert_allclose(second.poses[1], [0.5, 0.2, -3.0], atol=1e-12)
    assert before <= first.time_s <= time.monotonic()
    assert first.time_s - second.time_s == pytest.approx(0.8, abs=0.5)


def test_poses_in_space_are_taken_to_the_base():
    """A camera that looks down from aside, and a tag on the object, turned in its plane, whose z axis points down."""
    rng = np.random.default_rng(0)
    mount = Rotation.from_euler("xyz", [math.pi - 0.2, 0.1, 0.7])
    tag, beside, place = Rotation.from_euler("xz", [math.pi, 0.4]), np.array([0.02, -0.01, 0.05]), rng.normal(size=3)
    true = np.array([0.41, -0.07, 2.2])
    turn = mount.inv() * Rotation.from_euler("z", true[2]) * tag.inv()
    seen = mount.inv().apply([*true[:2], 0.1] - place) - turn.apply(beside)
    with UdpCamera(
        port=0,
        in_base_m=place.tolist(),
        in_base_wxyz=mount.as_quat(scalar_first=True).tolist(),
        object_m=beside.tolist(),
        object_wxyz=tag.as_quat(scalar_first=True).tolist(),
    ) as camera:
        upright = [*seen, *turn.as_quat(scalar_first=True)]
        flipped = [*seen, *(turn * Rotation.from_euler("x", math.pi)).as_quat(scalar_first=True)]
        sent(camera, {"poses": [upright]}, {"poses": [flipped]})
        found = drained(camera, 2)
        assert_allclose(found[0].poses[0], true, atol=1e-9)
        assert np.isnan(found[1].poses).all()  # it lay there, and a tag flips now and then
    with UdpCamera(port=0) as camera:
        sent(camera, {"poses": [[0, 0, 0, 0, 1, 0, 0]]})
        with pytest.raises(CameraLostError, match="z axis is 180 deg"):
            drained(camera, 1)


@pytest.mark.parametrize(
    "message",
    [b"\xff\x00", b"[]", {"pose": []}, {"poses": []}, {"poses": [[1, 2]]}, {"poses": [[1, 2, math.nan]]},
     {"poses": [[0, 0, 0, 0, 0, 0, 0]]}, {"poses": [[1, 2, 3]], "age_s": -1}, {"poses": [["a", 2, 3]]},
     {"poses": [["1", "2", "3"]]}, {"poses": [[True, 0, 0]]},
     b'{"poses": [[1' + b"0" * 400 + b', 0, 0]]}', b'{"poses": [[1' + b"0" * 5000 + b', 0, 0]]}',
     b'{"poses": [[0, 0, 0]], "age_s": 1' + b"0" * 400 + b"}", b'{"poses": [[0, 0, 0]], "age_s": 1e308}',
     {"poses": [[1e308, 0, 0]]}, {"poses": [[1e308, 0, 0, 1, 0, 0, 0]]}, {"poses": [[0, 0, 0, 1e-320, 0, 0, 0]]},
     {"poses": [[11, 0, 0]]}, {"poses": [[0, 0, 0]], "age_s": 3600}, {"poses": [None] * 8000},
     b"[" * 30000, b'{"poses": ' + b"[" * 30000 + b"]" * 30000 + b"}"],
)  # fmt: skip
def test_a_malformed_datagram_is_refused(message):
    with UdpCamera(port=0) as camera:
        sent(camera, message)
        with pytest.raises(CameraLostError, match=r"camera: got .*; allowed: a JSON object"):
            drained(camera, 1)
        assert camera._thread is not None and camera._thread.is_alive()


@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_a_thread_that_has_ended_is_noticed():
    with UdpCamera(port=0) as camera:
        assert camera._socket is not None and camera._thread is not None
        camera._frame = lambda *_: sys.exit()  # whatever may end it
        sent(camera, {"poses": [[0, 0, 0]]})
        assert until(lambda: not camera._thread.is_alive())  # pyright: ignore[reportOptionalMemberAccess]
        with pytest.raises(CameraLostError, match="thread that listens has ended"):
            camera.drain()


def test_a_port_in_use_and_wrong_settings_are_refused():
    with UdpCamera(port=0) as camera, pytest.raises(CameraLostError, match="Address already in use"):
        UdpCamera(port=camera.port).__enter__()
    for settings, refusal in (({"port": "five"}, "port: got 'five'"), ({"prot": 5}, "got 'prot'.*nearest: port")):
        with pytest.raises(InvalidValueError, match=rf"camera\.settings.*{refusal}"):
            build_camera(RobotFile.model_validate({"camera": {"model": "udp", "settings": settings}}))
    assert build_camera(RobotFile()) is None


def test_the_sender_of_the_page_is_understood():
    page = (DOCS / "hardware.md").read_text(encoding="utf-8")
    code = page.split("<!-- sender -->\n```python\n")[1].split("```")[0]
    downwards = [0.0, 1.0, 0.0, 0.0]
    with UdpCamera(port=0, in_base_m=[0.45, 0.0, 0.8], in_base_wxyz=downwards, object_wxyz=downwards) as camera:
        exec(code.replace("5005", str(camera.port)), {})
        (frame,) = drained(camera, 1)
    assert_allclose(frame.poses[0], [0.462, 0.034, 0.0], atol=1e-12)


@pytest.mark.parametrize("flipped", [2, 4])
def test_the_place_of_an_object_is_the_median_of_a_look(flipped):
    class Camera(Entered):
        count = 0

        def drain(self) -> list[SeenFrame]:
            self.count += 1
            pose = [5.0, 5.0, 0.0] if self.count == flipped else [0.4, 0.1, math.pi - 0.001 * (-1) ** self.count]
            return [SeenFrame(0.1 * self.count, np.array([pose, [math.nan] * 3]))]

    class Skipping(MonotonicClock):
        time = 0.0

        def now(self) -> float:
            return self.time

        def sleep(self, seconds: float) -> None:
            self.time += seconds

    clock, camera = Skipping(), Camera()
    x, y, yaw = SeenPose(camera, clock, parts=2).read()
    assert (x, y) == (0.4, 0.1)
    assert abs(math.remainder(yaw - math.pi, math.tau)) < 0.002
    with pytest.raises(CameraLostError, match="saw part 1 of the object in 0 frames"):
        SeenPose(camera, clock, parts=2, part=1).read()
    with pytest.raises(CameraLostError, match="poses of 2 parts; the object has 1"):
        SeenPose(camera, clock).read()


def test_a_trials_frames_lose_their_mean_delay_and_their_jumps():
    times = [10.1, 10.2, 10.15, 10.3]  # one stamp goes back
    poses = [np.array([[0.1 * i, 0.0, math.remainder(3.0 + 0.2 * i, math.tau)]]) for i in range(4)]
    stream = seen_stream([SeenFrame(t, p) for t, p in zip(times, poses, strict=True)], CAMERAS["30hz"], 10.0, 1)
    assert_allclose(stream.time_s, [0.07, 0.17, 0.27])
    assert_allclose(stream.poses[:, 0, 2], [3.0, 3.2, 3.6])
    assert (stream.position_std, stream.delay_std) == (0.001, CAMERAS["30hz"].delay_std)


def test_a_pose_that_is_known_in_part_ends_the_trial_before_its_record():
    watch = CameraWatch(CAMERAS["30hz"], 1)
    unseen, half = (SeenFrame(0.1, np.array([[x, 0.0, math.nan]])) for x in (math.nan, 0.4))
    assert list(watch.kept([replace(unseen, poses=np.full((1, 3), math.nan))], 0.1))
    with pytest.raises(CameraLostError, match="got a pose of"):
        list(watch.kept([half], 0.1))


@pytest.mark.parametrize("part", [0.1, 0.5, 0.9])
def test_no_frame_of_the_fastest_push_is_a_jump(part):
    """A block of 50 mm, pushed near the end of a face, turns faster than any other object."""
    block = drawn_object(0, ["1"])
    push = replace(Push.into(faces(block.shape)[0], part), speed=SPEEDS[1])
    (motion,) = drag_of(block).motion(block.shape, [push], 1 / 30)
    frames = [SeenFrame(time, pose[None]) for time, pose in zip(motion.time_s, motion.poses, strict=True)]
    watch = CameraWatch(replace(CAMERAS["30hz"], position=0.0, angle=0.0), 1, SPEEDS[1])
    assert len(frames) > 5
    assert [kept for frame in frames for kept in watch.kept([frame], frame.time_s)] == frames
