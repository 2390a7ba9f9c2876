"""heft robot, without hardware, over fakes at the wire, and with devices from outside."""

from __future__ import annotations

import errno
import io
import json
import math
import re
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Annotated

import numpy as np
import pandas as pd
import pytest
from scipy.spatial.transform import Rotation

from estimators.testing.analytic_world import analytic_trial, drawn_object
from scenarios.cli.robot.calibrate import COLUMNS
from scenarios.cli.robot.trial import action_of, push_of
from scenarios.results.store import Store, object_request
from testbed import Accelerate, Action, Push, Range, ReplayRunner, Rotate, Slide, Trajectory, Trial, Weigh, load_object
from testbed.errors import HeftError, InvalidValueError
from testbed.objects.model import GRAVITY, ObjectModel
from testbed.robot.calibration.file import load_calibration, load_hand_eye, save_calibration
from testbed.robot.calibration.hand_eye import TrackedPose
from testbed.robot.calibration.static_poses import Calibration, Sign
from testbed.robot.config import RobotFile, RobotSettings
from testbed.robot.interfaces import ArmState, Pose, SensorHealth, SensorIdentity, WrenchSample
from testbed.robot.path import KnownPose, starting_pose
from testbed.robot.registry import build_sensor, gripper_class, load_robot_file
from testbed.robot.runner import read_off
from tests.fakes.ft300s import FakeFt300s
from tests.fakes.gen3 import FakeGen3
from tests.fakes.rig import KORTEX, FakeRig
from tests.fakes.robot import FakeArm, FakeCamera, FakeGripper, FakeRobot, FakeSensor, robot_for, small_object
from tests.fakes.static_hand import COM, MASS, POSES, readings
from tests.fakes.world import Gen3World
from tests.helpers import commands
from viz.recordings.trial import SensorStream

SHEET = gripper_class(RobotFile()).data_sheet(0.05)
BRISK = "[bench]\ntare_s = 0.4\ntravel_speed_m_s = 0.13\n"
"""Short tares and fast travel, for trials that test the command alone."""
ended = partial(commands.ended, "robot")


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    return commands.refusal(capsys, "robot", *words)


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("PYTHONPATH", "")
    monkeypatch.delenv("HEFT_KORTEX_PYTHON", raising=False)
    return tmp_path


def answer(monkeypatch, line: str) -> None:
    monkeypatch.setattr("sys.stdin", io.StringIO(f"{line}\n"))


def straight(sign: Sign = 1, turn: float = 0.0) -> Calibration:
    """A sensor turned about the tool's axis above a tool that is the simulated gripper."""
    small, com = np.full(6, 1e-3), np.array([0, 0, 0.06])
    rotation = np.array([math.cos(turn / 2), 0, 0, math.sin(turn / 2)])
    return Calibration(sign, rotation, small[:3], np.zeros(6), small, 0.925, 1e-3, com, small[:3], 1.0, 8)


@pytest.mark.slow
@pytest.mark.parametrize(("serial", "code"), [("FSC-1234", 0), ("FSC-9", 1)])
def test_a_check_with_all_devices(folder, capsys, monkeypatch, serial, code):
    """Also with a calibration of another sensor, which is reported."""
    monkeypatch.setenv("PYTHONPATH", KORTEX)
    save_calibration(folder / "calibration.toml", straight(), serial, "2026-01-01")
    with FakeFt300s() as sensor, FakeGen3(Gen3World(small_object())) as arm:
        text = f'[sensor]\nport = "{sensor.port}"\n[arm]\naddress = "127.0.0.1"\nport = {arm.port}\n'
        (folder / "robot.toml").write_text(text, encoding="utf-8")
        assert ended("check") == code
        assert not arm.was_driven
    text = capsys.readouterr().out
    assert "Robotiq FT-300S FSC-1234" in text
    assert "no fault; tool at (0.450" in text
    assert "GEN3-7DOF AC123456-1, firmware 0x20600" in text
    assert ("sensor: got 'FSC-9'; allowed: FSC-1234" in text) == bool(code)
    assert text.splitlines()[-1].startswith("1 missing" if code else "a trial can be run")


@pytest.mark.parametrize(("hung", "code", "word"), [(19.62, 0, "within 2%"), (15.0, 1, "stored tool calibration")])
def test_a_known_mass_tests_the_sensor(folder, capsys, monkeypatch, hung, code, word):
    load, loads = np.zeros(6), iter((0.0, hung))

    class Person(io.StringIO):
        def readline(self, *_):
            load[2] = next(loads)
            time.sleep(0.05)
            return "\n"

    monkeypatch.setattr("sys.stdin", Person())
    monkeypatch.setattr("scenarios.cli.robot.sensor._WEIGHING_TIME", 0.3)
    with FakeFt300s(lambda _: load) as sensor:
        sensor.faults.noise = 0.05
        assert ended("sensor", "--port", sensor.port, "--mass", "2.0") == code
    assert word in capsys.readouterr().out


class Still:
    """Arm and sensor of another package, in poses set by hand."""

    identity = SensorIdentity("Still", "S-1", "1", 100.0)
    limits = None
    poses = readings(POSES[0] * POSES[0], noise=1.0)
    at, moving = 0, False

    def __init__(self, gain: Annotated[float, Range(0.5, 2, "")] = 1.0):
        self._rng, self._gain, self._frames = np.random.default_rng(1), gain, 0

    def __enter__(self):
        return self

    def __exit__(self, *_):
        return None

    def drain(self):
        self._frames += 10
        noise = self._rng.standard_normal((10, 6)) * [0.07, 0.08, 0.07, 0.003, 0.003, 0.001]
        return [WrenchSample(0.0, self._gain * (self.poses[self.at].wrench + n), 0) for n in noise]

    def health(self):
        return SensorHealth(self._frames, 0, 0, 0, 0, 0.0, ("a warning of its own",))

    def state(self):
        speed, pose = np.full(7, 0.1 if Still.moving else 0.0), Pose(np.zeros(3), self.poses[self.at].hand)
        return ArmState(0.0, np.zeros(7), speed, pose, np.zeros(6))

    def move_to(self, pose, speed): ...

    def twist(self, linear, angular): ...

    def stop(self): ...


@pytest.mark.slow
def test_a_sensor_from_outside_by_entry_point(folder, capsys, install):
    install(sensors=f"still = {__name__}:Still")
    (folder / "robot.toml").write_text('[sensor]\nmodel = "still"\nsettings = { gain = 2.0 }\n', encoding="utf-8")
    assert ended("sensor", "--seconds", "1.1", "--no-viewer") == 0
    text = capsys.readouterr().out
    assert "Still, serial S-1" in text and "a warning of its own" in text and ", 0 lost, " in text
    shown = re.search(r"\d+ frames  N +(-?\d+\.\d\d) \+- 0\.1\d ", text)
    assert shown and float(shown[1]) == pytest.approx(2 * Still.poses[0].wrench[0], abs=0.1)


@pytest.mark.parametrize(
    ("table", "field"),
    [
        ('model = "ft300"', r"sensor\.model: got 'ft300'; allowed: one of ft300s, still \(nearest: ft300s\)"),
        ('model = "still"\nsettings = { gian = 2.0 }', r"sensor\.settings: got 'gian'.*nearest: gain"),
        ('model = "json:JSONDecoder"', r"sensor\.model: .*has no __enter__"),
        ("", r"sensor\.port: got None"),
    ],
)
def test_a_device_that_cannot_be_built_is_named(folder, install, table, field):
    install(sensors=f"still = {__name__}:Still")
    (folder / "robot.toml").write_text(f"[sensor]\n{table}\n", encoding="utf-8")
    with pytest.raises(InvalidValueError, match=field):
        build_sensor(load_robot_file(folder / "robot.toml"))


@pytest.mark.slow
def test_a_calibration_by_hand_is_found_and_saved(folder, capsys, monkeypatch):
    """Poses set by hand, one of which is refused since the arm still moves."""
    model = f'model = "{__name__}:Still"\n'
    (folder / "robot.toml").write_text(f"[sensor]\n{model}[arm]\n{model}", encoding="utf-8")
    monkeypatch.setattr(Still, "at", -1)
    monkeypatch.setattr(Still, "moving", False)

    class Person(io.StringIO):
        def readline(self, *_):
            Still.moving = Still.at == 2 and not Still.moving
            Still.at += not Still.moving
            return "q\n" if Still.at == len(POSES) else "\n"

    monkeypatch.setattr("sys.stdin", Person())
    assert ended("calibrate", "--seconds", "0.1") == 0
    text = capsys.readouterr().out
    assert "the arm still moves" in text
    assert "enough: rotation to" in text
    found = load_calibration(folder / "calibration.toml", "S-1")
    assert found.poses == len(POSES)
    assert found.mass == pytest.approx(MASS, abs=5 * found.mass_std)
    assert np.abs(found.com - (POSES[0] * POSES[0]).inv().apply(COM)).max() < 0.002


class OutsideArm(FakeArm):
    """Arm of the fake robot that a test has set up, as another package would provide it."""

    robots: tuple[FakeRobot, ...] = ()

    def __init__(self):
        super().__init__(self.robots[0])
        self.robots[0].arm = self


class OutsideSensor(FakeSensor):
    def __init__(self):
        super().__init__(OutsideArm.robots[0])
        self.robot.sensor = self


class OutsideGripper(FakeGripper):
    def __init__(self, arm: OutsideArm):
        super().__init__(arm.robot)


class OutsideCamera(FakeCamera):
    def __init__(self):
        super().__init__(OutsideArm.robots[0])
        self.robot.camera = self


OUTSIDE = {kind: f"{__name__}:Outside{kind.title()}" for kind in ("arm", "gripper", "sensor", "camera")}


@pytest.fixture
def outside(folder, monkeypatch) -> Callable[[Action], tuple[Trial, FakeRobot]]:
    """Sets up the devices from outside, in simulated time, for a trial of `two.toml`."""
    save_calibration(folder / "calibration.toml", straight(), "1", "2026-01-01")
    two = '[blocks]\nlayout = ["11"]\nmass_kg = [0.4, 0.3]\n'
    (folder / "two.toml").write_text(f'name = "two"\n{two}', encoding="utf-8")

    def set_up(action: Action) -> tuple[Trial, FakeRobot]:
        planned = Trial(load_object("two.toml"), action)
        robot, _ = robot_for(planned)
        monkeypatch.setattr(OutsideArm, "robots", (robot,))
        for module in ("runner", "interfaces"):
            monkeypatch.setattr(f"testbed.robot.{module}.MonotonicClock", lambda: robot.clock)
        return planned, robot

    return set_up


@pytest.mark.slow
def test_a_trial_on_an_arm_a_gripper_and_a_sensor_from_outside(folder, outside, install, capsys, monkeypatch):
    """In simulated time: the registry builds them by the names in the robot file, and the command runs the trial."""
    devices = ("arm", "gripper", "sensor")
    install(**{f"{kind}s": f"mine = {OUTSIDE[kind]}" for kind in devices})
    tables = "".join(f'[{kind}]\nmodel = "mine"\n' for kind in devices)
    (folder / "robot.toml").write_text(BRISK + tables, encoding="utf-8")
    planned, robot = outside(Rotate(0, duration=1.3, pivot=(0.0, 0.01)))
    words = ("trial", "two.toml", "--seconds", "1.3", "--pivot", "0", "10", "--no-back", "--out", "out")
    answer(monkeypatch, "no")
    assert "not confirmed; nothing has moved" in refused(capsys, *words)
    assert robot.driven_after(0.0) == 0.0
    answer(monkeypatch, "yes")
    assert ended(*words) == 0
    (kept,) = ReplayRunner(folder / "out").recordings
    assert kept.fits(planned)
    request = json.loads(kept.path.with_name("trial.json").read_text(encoding="utf-8"))["asked"]
    assert request["robot"]["arm"]["model"] == "mine"
    assert "model" not in RobotFile().to_dict()["arm"] and "gripper" not in RobotFile().to_dict()


@pytest.mark.slow
def test_a_push_from_where_a_camera_sees_the_object(folder, outside, capsys, monkeypatch):
    """It lies elsewhere than in the simulation, and is pushed there."""
    tables = BRISK + "".join(f'[{kind}]\nmodel = "{name}"\n' for kind, name in OUTSIDE.items())
    (folder / "robot.toml").write_text(tables, encoding="utf-8")
    push = push_of(load_object("two.toml").shape, (51.0, -10.0))
    assert isinstance(push, Push) and push.point == pytest.approx((0.05, -0.01))
    planned, robot = outside(push)
    robot.world.place(np.array([0.43, 0.06, 1.0]), push.fingertip(planned.object.shape))
    words = ("trial", "two.toml", "--action", "push", "--point", "51", "-10", "--out", "out")
    answer(monkeypatch, "yes")
    assert "from its place" in refused(capsys, *words)
    assert ended(*words, "--at-seen", "--at", "0.4", "0", "0") == 2
    answer(monkeypatch, "yes")
    assert ended(*words, "--at-seen") == 0
    assert re.search(r"middle at \(0\.4[23]\d, 0\.0[56]\d\) m, turned by 5[67]", capsys.readouterr().out)
    (kept,) = ReplayRunner(folder / "out").recordings
    assert kept.fits(planned)
    (folder / "robot.toml").write_text(tables.split("[camera]")[0], encoding="utf-8")
    assert "camera.model: got None" in refused(capsys, *words)


SHAPE = load_object("L2").shape


def test_actions_in_a_users_units():
    turn = action_of(SHAPE, "rotate", "A2", 5.0, 20.0, (10.0, -20.0), back=False)
    assert turn == Rotate(2, speed=math.radians(20), duration=5.0, pivot=(0.01, -0.02), back=False)
    assert action_of(SHAPE, "slide", speed=0.03, direction_deg=90.0) == Slide(0, math.pi / 2, 0.03)
    assert action_of(SHAPE, "accelerate") == Accelerate(0)
    assert action_of(SHAPE, "weigh") == Weigh()
    beside = action_of(SHAPE, "rotate")
    assert isinstance(beside, Rotate) and beside.pivot is not None


def test_a_dry_run_shows_the_motion_and_connects_to_nothing(folder, capsys):
    assert ended("trial", "L2", "--grasp", "A2", "--seconds", "4", "--dry-run") == 0
    text = capsys.readouterr().out
    for part in ("put the object with its middle at (0.", "the action: (", "allowed 0.250 to 0.650 m"):
        assert part in text


def test_a_scales_reading_is_stored_and_moves_nothing(folder, capsys):
    assert ended("trial", "L2", "--action", "weigh", "--weight", "1.8", "--out", "out") == 0
    assert capsys.readouterr().out.startswith("ok")
    assert len(ReplayRunner(folder / "out").recordings) == 1


def test_a_full_disk_at_the_end_is_reported(folder, capsys, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("scenarios.results.store.Store.put_trial", full)
    said = refused(capsys, "trial", "L2", "--action", "weigh", "--weight", "1.8", "--out", "out")
    assert "out: the trial cannot be stored: No space left on device" in said


def hung(obj: ObjectModel) -> Trajectory:
    """The object lifted, as `testbed.robot.runner.lifted` leaves it."""
    held = analytic_trial(obj, Slide(0, duration=2.5), noise=0.05)
    wrench = held.wrench_on_object_world - held.wrench_on_object_world.mean(axis=0)
    wrench[:, 2] += obj.total_mass * GRAVITY
    return replace(held, action=Weigh(), wrench_on_object_world=wrench, tool=None, figures={"weight_std_kg": 0.005})


@pytest.mark.parametrize(
    ("sign", "runner", "code", "finding"),
    [
        (1, "robot", 0, "all 11 findings are as they should be"),
        (-1, "robot", 1, "it cannot hang upwards: sign is the wrong one"),
        (1, "simulation", 2, "a folder of measured trials"),
    ],
    ids=["right", "negated", "simulated"],
)
def test_a_measured_folder_is_verified(folder, capsys, sign, runner, code, finding):
    """By a lift, a turn, a slide, and a scale's reading."""
    obj = drawn_object(0)
    moves = (Rotate(0, duration=2.5, pivot=(0.1, 0.15), back=True), Slide(0, 0.4, duration=2.5))
    records = [hung(obj), *(analytic_trial(obj, move, noise=0.05) for move in moves)]
    records = [replace(t, wrench_on_object_world=sign * t.wrench_on_object_world) for t in records]
    for i, record in enumerate([*records, read_off(obj.total_mass)]):
        request = {"object": object_request(obj), "action": record.action.to_dict(), "support": "own_weight"}
        stored = replace(record, provenance={"runner": runner})
        Store(folder / "lab").put_trial(f"{i}", Trial(obj, record.action), request, stored)
    assert ended("verify", "lab") == code
    out, err = capsys.readouterr()
    assert finding in out + err
    assert ("wrong" in out) == (code == 1)


def test_hand_eye_finds_a_tracker(folder, capsys):
    turn, place = Rotation.from_euler("z", 40, degrees=True), np.array([0.5, -0.2, 0.1])
    seen = np.array([[x, y, z] for x in (-0.2, 0.2) for y in (-0.15, 0.15) for z in (0.0, 0.1)])
    table = pd.DataFrame(np.hstack([seen, turn.apply(seen) + place]), columns=COLUMNS)
    table.to_csv("points.csv", index=False)
    assert ended("hand-eye", "points.csv") == 0
    assert "tracker at (0.5000, -0.2000, 0.1000) m, turned by (0.00, 0.00, 40.00) deg" in capsys.readouterr().out
    found = load_hand_eye(folder / "hand_eye.toml")
    read = TrackedPose(KnownPose(0.1, 0.0, 0.0), found).read()
    assert read == pytest.approx([*(turn.apply([0.1, 0, 0]) + place)[:2], math.radians(40)], abs=1e-9)
    table.assign(**{name: 1e3 * table[name] for name in COLUMNS[:3]}).to_csv("points.csv", index=False)
    assert ended("hand-eye", "points.csv", "--out", "other.toml") == 1
    assert "no file is written: a residual of" in capsys.readouterr().out and not (folder / "other.toml").exists()
    table.drop(columns="seen_z").to_csv("points.csv", index=False)
    assert "seen_z as well" in refused(capsys, "hand-eye", "points.csv")
    for content in (b"", b"a,b\n1,2\n1,2,3\n", "Länge\n1\n".encode("latin-1")):
        Path("points.csv").write_bytes(content)
        said = refused(capsys, "hand-eye", "points.csv")
        assert "POINTS.csv: got 'points.csv'; allowed: a table of numbers in UTF-8 (" in said


@pytest.mark.parametrize(
    ("words", "field"),
    [
        (("sensor", "--port", "/dev/ttyNONE"), "sensor /dev/ttyNONE: cannot be opened: no such device"),
        (("sensor", "--port", __file__), "cannot be opened: no serial port"),
        (("sensor",), "sensor.port: got None"),
        (("sensor", "--port", "x", "--mass", "0"), "--mass: got 0.0"),
        (("sensor", "--port", "x", "--seconds", "nan"), "--seconds: got nan"),
        (("calibrate", "--seconds", "-1"), "--seconds: got -1.0"),
        (("check", "--config", "mine.toml"), "config: got 'mine.toml'"),
        (("hand-eye", "none.csv"), "POINTS.csv: got 'none.csv'"),
        (("trial", "L2"), "sensor.calibration: got 'calibration.toml'"),
        (("trial", "L2", "--grasp", "Z9"), "--grasp: got 'Z9'; allowed: one of B1, C1, A2"),
        (("trial", "L2", "--at", "0.6", "0", "0", "--action", "slide", "--dry-run"), "limit: the action: x of the"),
        (("trial", "L2", "--action", "weigh", "--weight", "-1"), "--weight: got -1.0"),
        (("trial", "L2", "--weight", "1.8"), "--weight: got 1.8; allowed: none with --action rotate: weigh uses it"),
        (("trial", "L2", "--tilt", "3"), "--tilt: got 3.0; allowed: none with --action rotate: lift or stop_and_go"),
        (("trial", "L2", "--action", "accelerate", "--speed", "5"), "--speed: got 5.0; allowed: none with"),
        (("trial", "L2", "--action", "slide", "--no-back"), "--back: got False; allowed: none with --action slide"),
        (("trial", "L2", "--action", "push", "--grasp", "A2"), "--grasp: got 'A2'; allowed: none with --action push"),
        (("trial", "L2", "--action", "weigh", "--grasp", "NOPE", "--dry-run"), "--grasp: got 'NOPE'; allowed: none"),
        (
            ("trial", "L2", "--action", "weigh", "--at", "0.4", "0", "0"),
            "--at: got (0.4, 0.0, 0.0); allowed: none with",
        ),
        (("trial", "L2", "--action", "weigh", "--at-seen"), "--at-seen: got True; allowed: none with --action weigh"),
        (("trial", "L2", "--length", "0.2"), "--length: got 0.2; allowed: none with --action rotate: push uses it"),
        (("trial", "L2", "--action", "weigh", "--weight", "1.8", "--dry-run"), "--weight: got 'with --dry-run, which"),
    ],
)
def test_bad_input_is_one_clear_line(folder, capsys, words, field):
    assert field in refused(capsys, *words)


def test_a_robot_file_names_its_errors(folder):
    for text, refusal in (
        (
            "[limits]\nlow_m = [0.6, -0.3, 0.1]\nhigh_m = [0.3, 0.3, 0.3]",
            r"limits.*high_m: got \[0\.3, .*; allowed: a corner beyond low_m",
        ),
        ("[bench]\ntable_height_m = 0.1", r"limits\.low_m: got \[0\.25, .*; allowed: z of 0\.1 m or more"),
        ("[limits]\nforce_n = 3\n[bench]\ntare_s = 0", r"(?s)bench\.tare_s.*limits\.force_n.*force_N"),
    ):
        (folder / "mine.toml").write_text(text, encoding="utf-8")
        with pytest.raises(HeftError, match=refusal):
            load_robot_file(folder / "mine.toml")
    assert load_robot_file(Path("robot.toml")) == RobotFile()


def test_a_robot_files_defaults_are_the_settings_own():
    ours, usual = RobotFile().settings(None, SHEET), RobotSettings(SHEET)
    for name in ("grip_height", "travel_speed", "descent_speed", "tare_time", "drift", "table_height", "closing_angle"):
        assert getattr(ours, name) == getattr(usual, name), name
    for name, value in vars(usual.limits).items():
        assert getattr(ours.limits, name) == pytest.approx(value, rel=5e-3), name


def test_a_calibration_turns_into_the_tools_frame():
    """With the gains of the axes."""
    gain = np.array([1.1, 0.9, 1.0, 1.2, 1.0, 0.8])
    settings = RobotFile().settings(replace(straight(sign=-1, turn=0.8), gain=gain), SHEET)
    assert settings.sensor_sign == -1
    np.testing.assert_allclose(settings.on_tool(np.full((2, 6), 3.0)), [-3.0 / gain] * 2)
    np.testing.assert_allclose(settings.tool.tcp, [0, 0, 0.174], atol=1e-12)
    assert np.trace(settings.tool.inertia) == pytest.approx(np.trace(SHEET.inertia))


@pytest.mark.slow
def test_a_trial_over_wires_is_run_and_stored(folder, capsys, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", KORTEX)
    model = load_object("L2")
    planned = Trial(model, Rotate(2, duration=1.5, pivot=(0.0, 0.03), back=True))
    save_calibration(folder / "calibration.toml", straight(), "FSC-1234", "2026-01-01")
    words = ("trial", "L2", "--grasp", "A2", "--seconds", "1.5", "--pivot", "0", "30", "--out", "out")
    with FakeRig(model) as rig:
        wires = rig.wires
        text = f'[sensor]\nport = "{wires.sensor_port}"\n[arm]\naddress = "127.0.0.1"\nport = {wires.arm_port}\n'
        (folder / "robot.toml").write_text(text + BRISK, encoding="utf-8")
        for _ in range(4):  # a busy machine ends a trial, or refuses it before anything moves
            rig.place(starting_pose(planned), 2)
            answer(monkeypatch, "yes")
            code = ended(*words)
            out, said = capsys.readouterr()
            if code != 1 and "before anything moved: age of the" not in said:
                break
        else:
            pytest.skip("this machine is too busy for real time: trials ended as faults or did not begin, rightly")
    assert code == 0
    assert "drift_N" in out
    assert any(r.fits(planned) for r in ReplayRunner(folder / "out").recordings)


@pytest.mark.slow  # Rerun waits 10 s for a viewer that is not there
def test_a_viewer_gets_the_samples(monkeypatch):
    sent: list[tuple[str, np.ndarray]] = []

    class Stream:
        def send_columns(self, path, time, data):
            sent.append((path, time[0].as_arrow_array().cast("int64").to_numpy()))

    stream = SensorStream("rerun+http://127.0.0.1:9/proxy", "sensor")
    monkeypatch.setattr(stream, "_stream", Stream())
    stream.send([], np.zeros((0, 6)))
    assert sent == []
    stream.send([5.0, 5.01], np.arange(12.0).reshape(2, 6))
    stream.send([6.0], np.zeros((1, 6)))
    assert [path for path, _ in sent[:6]] == ["force/x", "force/y", "force/z", "torque/x", "torque/y", "torque/z"]
    np.testing.assert_allclose(sent[0][1], [0, 1e7], atol=10)  # ns, from the first sample
    np.testing.assert_allclose(sent[6][1], [1e9], atol=10)
