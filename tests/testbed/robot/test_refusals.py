"""Numbers of the robot's files and classes: each has a range, and what is outside is refused with field and limits."""

from __future__ import annotations

import dataclasses
import inspect
import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

import numpy as np
import pytest
from pydantic import BaseModel, ValidationError

from testbed.errors import InvalidValueError
from testbed.robot.calibration.hand_eye import align
from testbed.robot.calibration.static_poses import StaticPose, calibrate, static_pose
from testbed.robot.calibration.trial import check_trial
from testbed.robot.camera.udp import UdpCamera
from testbed.robot.config import (
    ArmTable,
    BenchTable,
    CameraTable,
    GripperTable,
    LimitsTable,
    RobotFile,
    RobotSettings,
    SensorTable,
)
from testbed.robot.interfaces import ArmIdentity, Pose
from testbed.robot.kinova.arm import GEN3, KortexArm
from testbed.robot.kinova.gripper import KortexGripper, data_sheet
from testbed.robot.raw_record import RawRecord
from testbed.robot.registry import build_arm, load_robot_file
from testbed.robot.robotiq.ft300s import REPEATS, Ft300s
from testbed.robot.safety import SafetyLimits
from testbed.robot.weighing import Weighing, check_known_mass, held_center, weigh
from testbed.toml import InvalidFileError
from testbed.validation import Range, check_settings
from tests.fakes.robot import FakeArm
from tests.fakes.static_hand import BIAS, DOWN, ERROR, readings

GIVEN: Mapping[type, dict[str, Any]] = {
    ArmTable: {},
    SensorTable: {},
    GripperTable: {},
    CameraTable: {},
    BenchTable: {},
    LimitsTable: {},
    SafetyLimits: {},
    RobotSettings: {"tool": data_sheet(0.05)},
    KortexArm: {},
    KortexGripper: {"arm": KortexArm()},
    Ft300s: {"port": "/dev/none"},
    UdpCamera: {},
}
"""Classes with settings of the robot, and their arguments without a default."""
ODD = (math.nan, math.inf, -math.inf, True, "1", None)


def leaves(annotation: Any, within: Range | None = None) -> Iterator[tuple[Any, Range | None]]:
    """Types in an annotation, each with the range around it."""
    if get_origin(annotation) is Annotated:
        base, *beside = get_args(annotation)
        yield from leaves(base, next((b for b in beside if isinstance(b, Range)), within))
    elif get_origin(annotation) is not Literal:
        inner = get_args(annotation)
        yield from ((annotation, within),) if not inner else (leaf for one in inner for leaf in leaves(one, within))


def hints(kind: type) -> dict[str, Any]:
    """Annotation of each argument, with its range."""
    whole = dataclasses.is_dataclass(kind) or issubclass(kind, BaseModel)
    found = get_type_hints(kind if whole else kind.__init__, include_extras=True)
    return {name: found[name] for name in inspect.signature(kind).parameters}


def is_number(kind: Any) -> bool:
    return kind in (int, float, np.ndarray)


NUMBERS = [
    (kind, name, position, within)
    for kind in GIVEN
    for name, annotation in hints(kind).items()
    for position, within in enumerate(within for leaf, within in leaves(annotation) if is_number(leaf))
]


def default(kind: type, name: str) -> Any:
    made = getattr(kind(**GIVEN[kind]), name, None) if kind is not UdpCamera else None
    return inspect.signature(kind).parameters[name].default if made is None else made


def made_with(kind: type, name: str, position: int, value: object) -> None:
    """Construct a class with one number changed."""
    usual = default(kind, name)
    if isinstance(usual, tuple | list | np.ndarray):
        value = [value if index == position else one for index, one in enumerate(usual)]
    kind(**GIVEN[kind] | {name: value})


@pytest.mark.parametrize(("kind", "name", "position", "within"), NUMBERS)
def test_every_number_has_a_range_and_is_refused_outside_it(kind, name, position, within):
    assert isinstance(within, Range)
    integer = any(leaf is int for leaf, _ in leaves(hints(kind)[name]))
    step = 1 if integer else 1e-9 * max(abs(within.low), abs(within.high))
    if name not in ("low", "high", "low_m", "high_m", "delay_s", "sensor_orientation") and "wxyz" not in name:
        for allowed in (within.low, within.high):
            made_with(kind, name, position, allowed)
    for value in (within.low - step, within.high + step, *ODD):
        with pytest.raises((InvalidValueError, ValidationError)) as refused:
            made_with(kind, name, position, value)
        if not isinstance(value, str | bool | None):
            assert name in str(refused.value)
            assert str(within) in str(refused.value)


def test_the_walk_finds_the_numbers():
    found = {(kind, name) for kind, name, *_ in NUMBERS}
    assert {(KortexArm, "silence"), (KortexArm, "watchdog"), (KortexArm, "turn_speed")} <= found
    assert {(Ft300s, "stale_after"), (Ft300s, "repeats"), (SafetyLimits, "age"), (UdpCamera, "object_wxyz")} <= found
    assert len(found) > 50


def robot_file(tmp_path: Path, text: str) -> RobotFile:
    path = tmp_path / "robot.toml"
    path.write_text(text, encoding="utf-8")
    return load_robot_file(path)


@pytest.mark.parametrize(
    ("text", "refusal"),
    [
        ("[arm]\nsettings = { silence = 100.0 }", r"arm\.settings\.silence: got 100\.0; allowed: 0\.02 to 0\.2 s"),
        ("[arm]\nsettings = { watchdog = 50.0 }", r"arm\.settings\.watchdog: got 50\.0; allowed: 0\.02 to 0\.1 s"),
        ("[arm]\nsettings = { silence = [0.1] }", r"arm\.settings\.silence: got \[0\.1\]"),
        ("[arm]\nsettings = { turn_speed = 30 }", r"arm\.settings\.turn_speed: got 30; allowed: .* rad/s"),
        ("[arm]\nsettings = { tool_length = 211.5 }", r"arm\.settings\.tool_length: got 211\.5; .* 0\.6 m"),
        ("[arm]\nsettings = { port = 1e5 }", r"arm\.settings\.port: got 100000\.0; allowed: an integer"),
        ("[sensor]\nsettings = { stale_after = 100 }", r"sensor\.settings\.stale_after: got 100; .* 0\.2 s"),
        (
            "[sensor]\nsettings = { repeats = [7, 7, 8, 9, 1000000, 19] }",
            r"sensor\.settings\.repeats\[4\]: got 1000000; allowed: an integer from 2 to 30 frames",
        ),
        ("[sensor]\nsettings = { repeats = [7] }", r"sensor\.settings\.repeats: .*a list of 6 values"),
        ("[sensor]\nsettings = { repeats = 7 }", r"sensor\.settings\.repeats: .*a list of 6 values"),
        (
            '[camera]\nmodel = "udp"\nsettings = { in_base_m = [6, 0, 8] }',
            r"camera\.settings\.in_base_m\[0\]: got 6; allowed: -5 to 5 m",
        ),
    ],
)
def test_a_device_of_the_file_is_refused_at_load(tmp_path, text, refusal):
    with pytest.raises(InvalidValueError, match=refusal):
        robot_file(tmp_path, text)


def test_a_number_of_the_files_own_tables_is_no_bool_and_no_text(tmp_path):
    with pytest.raises(InvalidFileError) as refused:
        robot_file(
            tmp_path,
            '[limits]\nspeed_m_s = true\nforce_N = "60"\n[arm]\nport = true\n[camera]\ndelay_s = [0.05, 0.01]\n',
        )
    assert [line.partition("robot.toml: ")[2] for line in str(refused.value).splitlines()] == [
        "arm.port: got True; allowed: an integer from 1 to 65535",
        "camera.delay_s: got [0.05, 0.01]; allowed: two times, the least first, s",
        "limits.speed_m_s: got True; allowed: 0.002 to 0.5 m/s",
        "limits.force_N: got '60'; allowed: 1 to 300 N",
    ]


def test_a_folder_is_no_robot_file(tmp_path):
    (tmp_path / "robot.toml").mkdir()
    with pytest.raises(InvalidValueError, match=r"config: got .*a path to an existing"):
        load_robot_file(tmp_path / "robot.toml")


def test_settings_within_their_ranges_are_taken(tmp_path):
    file = robot_file(tmp_path, "[arm]\nsettings = { silence = 0.05, turn_speed = 1 }\n[sensor]\nport = '/dev/none'")
    arm = build_arm(file)
    assert isinstance(arm, KortexArm) and (arm.silence, arm.turn_speed) == (0.05, 1)
    assert Ft300s("/dev/none").identity.repeats == REPEATS


class Ranged(FakeArm):
    def __init__(
        self,
        address: str,
        port: int,
        *,
        pause: Annotated[float, Range(0.01, 0.2, "s")] = 0.1,
        gains: tuple[Annotated[float, Range(0, 5, "1/s")], ...] | None = None,
        mode: Literal[1, 2] = 1,
        fast: bool = False,
    ): ...


class Outside:
    """Methods of an arm of somebody else's."""

    def __enter__(self): ...

    def __exit__(self, *_): ...

    def state(self): ...

    def move_to(self, pose, speed): ...

    def twist(self, linear, angular): ...

    def stop(self): ...


@dataclasses.dataclass
class RangedData(Outside):
    pause: Annotated[float, Range(0.01, 0.2, "s")] = 0.1


class Bare(FakeArm):
    def __init__(self, pause: float = 0.1): ...


@dataclasses.dataclass
class BareData(FakeArm):
    pause: float | None = None


class Untyped(FakeArm):
    def __init__(self, pause=0.1): ...


class Table(FakeArm):
    def __init__(self, pause: dict[str, Any] | None = None): ...


class AnyName(FakeArm):
    def __init__(self, **pause: Any): ...


@pytest.mark.parametrize("kind", [Ranged, RangedData])
def test_a_plug_in_with_ranges_is_taken_within_them(tmp_path, kind):
    arm = f'[arm]\nmodel = "{__name__}:{kind.__name__}"\n'
    assert robot_file(tmp_path, arm)
    assert isinstance(build_arm(robot_file(tmp_path, f"{arm}settings = {{ pause = 0.2 }}")), kind)
    for value in ("100.0", "nan", "true", "-0.1", '"0.1"'):
        with pytest.raises(InvalidValueError, match=r"arm\.settings\.pause: got .*; allowed: 0\.01 to 0\.2 s"):
            robot_file(tmp_path, f"{arm}settings = {{ pause = {value} }}")


@pytest.mark.parametrize(
    ("settings", "refusal"),
    [
        ("gains = [1.0, 50.0]", r"gains\[1\]: got 50\.0; allowed: 0 to 5 1/s"),
        ("mode = 3", "mode: got 3; allowed: one of 1, 2"),
        ("fast = 1e9", "fast: got 1000000000.0; allowed: a number whose range the class states"),
        ("port = 1", "port: got 1; allowed: a number whose range the class states"),
    ],
)
def test_every_shape_of_a_plug_ins_setting_is_checked(tmp_path, settings, refusal):
    arm = f'[arm]\nmodel = "{__name__}:Ranged"\n'
    robot_file(tmp_path, f"{arm}settings = {{ gains = [1.0, 5.0], mode = 2, fast = true }}")
    with pytest.raises(InvalidValueError, match=refusal):
        robot_file(tmp_path, f"{arm}settings = {{ {settings} }}")


@pytest.mark.parametrize(
    ("kind", "settings"),
    [
        (Bare, ""),
        (BareData, ""),
        (Untyped, ""),
        (Bare, "pause = 0.1"),
        (Untyped, "pause = [[0.1]]"),
        (Table, "pause = { of = [{ a = 1e9 }] }"),
        (AnyName, "pause = 0.1"),
    ],
)
def test_a_plug_ins_number_without_a_range_is_refused_at_load(tmp_path, kind, settings):
    with pytest.raises(InvalidValueError, match=r"arm\.settings\.pause: .*pause: Annotated\[float, Range\(lowest"):
        robot_file(tmp_path, f'[arm]\nmodel = "{__name__}:{kind.__name__}"\nsettings = {{ {settings} }}')


def test_a_device_built_without_a_file_is_checked_too():
    table = {"model": f"{__name__}:Bare", "settings": {"pause": 1e9}}
    with pytest.raises(InvalidValueError, match=r"arm\.settings\.pause"):
        build_arm(RobotFile.model_validate({"arm": table}))


@pytest.mark.parametrize("limits", [(1, 0), (0, math.inf), (math.nan, 1), (False, 1)])
def test_a_range_has_two_finite_ends(limits):
    with pytest.raises(InvalidValueError):
        Range(limits[0], limits[1], "s")


def test_a_default_outside_its_own_range_is_refused():
    class Wrong:
        def __init__(self, pause: Any = 5.0): ...

    Wrong.__init__.__annotations__["pause"] = Annotated[float, Range(0, 1, "s")]
    with pytest.raises(InvalidValueError, match=r"mine\.pause: got 5\.0; allowed: 0 to 1 s"):
        check_settings(Wrong, {}, "mine")


HAND, COVARIANCE = DOWN.as_quat(scalar_first=True), np.eye(6) * 1e-4
SAMPLES, UP, ONE = np.random.default_rng(0).standard_normal((20, 6)), np.array([0, 0, 1.0]), Weighing(1.0, 0.001)
HANGS, FALLS, FAINT = (np.array([0, 0, force, 0, 0, 0]) for force in (3.0, -3.0, 0.02))
SETTINGS, LIMITS = RobotSettings(data_sheet(0.05)), SafetyLimits()


@pytest.mark.parametrize(
    ("call", "field", "allowed"),
    [
        (lambda: static_pose(HAND, np.zeros((9, 6))), "static_pose.samples", "10 or more samples"),
        (lambda: static_pose(HAND, np.zeros((100, 6))), "StaticPose.standard_error", "numbers > 0"),  # a dead sensor
        (lambda: StaticPose(np.ones(4), BIAS, ERROR), "StaticPose.hand", "a unit quaternion, wxyz"),
        (lambda: replace(calibrate(readings(DOWN)), sign=0), "Calibration.sign", "1 or -1"),
        (lambda: align(np.eye(4, 3), np.eye(3)), "hand_eye.touched", "4, one for each seen point"),
        (lambda: check_trial(HANGS, COVARIANCE, [], mass=0.0), "check_trial.mass", "a finite number > 0"),
        (lambda: check_known_mass(ONE, 0.0), "known mass", "a finite number > 0"),
        (lambda: weigh(SAMPLES[:5], SAMPLES, UP), "weigh.empty", "10 or more samples"),
        (lambda: weigh(SAMPLES, SAMPLES, 2 * UP), "weigh.up", "a unit vector, sensor axes"),
        (lambda: held_center(FALLS, COVARIANCE), "held_center.wrench", "a force that points up"),
        (lambda: held_center(FAINT, COVARIANCE), "held_center.wrench", "a force that points up"),
        (lambda: replace(LIMITS, high=(0.2, 0.2, 0.2)), "SafetyLimits.high", "a corner beyond the low one"),
        (lambda: replace(LIMITS, low=(1.0, 2.0)), "SafetyLimits.low", "a list of 3 values"),
        (lambda: replace(SETTINGS, sensor_sign=0), "RobotSettings.sensor_sign", "one of 1, -1"),
        (lambda: replace(SETTINGS, off_path=(-1.0, 1.0)), "RobotSettings.off_path[0]", "0 to 0.05 m"),
        (lambda: Pose(np.zeros(3), np.zeros(4)), "Pose.orientation", "a unit quaternion, wxyz"),
        (lambda: replace(GEN3, joint_range=np.ones((7, 2))), "ArmLimits.joint_range", "a lower and a higher angle"),
        (lambda: replace(GEN3, joint_speed=np.zeros(7)), "ArmLimits.joint_speed", "numbers > 0, rad/s"),
    ],
)
def test_it_is_refused(call, field, allowed):
    with pytest.raises(InvalidValueError) as refused:
        call()
    assert refused.value.field == field
    assert refused.value.allowed.startswith(allowed)


GOOD = calibrate(readings(DOWN))


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"com": -GOOD.com}, "tool_com_m"),
        ({"com": 4 * GOOD.com}, "tool_com_m"),
        ({"com": GOOD.com + 0.06}, "tool_com_m"),
        ({"mass": 0.1}, "tool_mass_kg"),
        ({"mass": 3.5}, "tool_mass_kg"),
    ],
)
def test_a_tool_that_cannot_hang_on_the_sensor_is_refused(changes, field):
    RobotFile().settings(GOOD, data_sheet(0.05))
    with pytest.raises(InvalidValueError, match=field):
        RobotFile().settings(replace(GOOD, **changes), data_sheet(0.05))


def test_another_arm_than_the_file_names_is_refused(tmp_path: Path):
    file = robot_file(tmp_path, '[arm]\nserial = "AC1"\nfirmware = "0x20600"\n')
    file.check_arm(ArmIdentity("GEN3", "AC1", "0x20600"))
    for other in (ArmIdentity("GEN3", "AC2", "0x20600"), ArmIdentity("GEN3", "AC1")):
        with pytest.raises(InvalidValueError, match="which the arm reports"):
            file.check_arm(other)


def test_a_record_that_cannot_be_written_is_refused_before_motion(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(Exception, match="the record cannot be written"):
        RawRecord(tmp_path / "file")
