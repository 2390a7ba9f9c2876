"""Values, units and signs that the robot's classes and files refuse, each with its field and what is allowed."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

import numpy as np
import pytest

from testbed.errors import InvalidValueError
from testbed.robot.calibration.file import CalibrationFile, load_calibration, save_calibration
from testbed.robot.calibration.hand_eye import align
from testbed.robot.calibration.static_poses import Calibration, StaticPose, calibrate, static_pose
from testbed.robot.calibration.trial import check_trial
from testbed.robot.config import RobotFile, RobotSettings
from testbed.robot.interfaces import ArmIdentity, Pose
from testbed.robot.kinova.arm import GEN3
from testbed.robot.kinova.gripper import data_sheet
from testbed.robot.raw_record import RawRecord
from testbed.robot.registry import load_robot_file
from testbed.robot.safety import SafetyLimits
from testbed.robot.weighing import Weighing, check_known_mass, held_center, weigh
from testbed.toml import InvalidFileError
from tests.fakes.static_hand import BIAS, DOWN, ERROR, readings

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


GOOD = replace(calibrate(readings(DOWN)), bias_walk=np.full(6, 0.1))


def numbers_of_a_calibration() -> list[str]:
    return [n for n, f in CalibrationFile.model_fields.items() if n.startswith(("bias", "tool")) and "std" not in n]


@pytest.mark.parametrize("key", numbers_of_a_calibration())
def test_every_number_of_a_calibration_is_bounded(key, tmp_path):
    path = tmp_path / "calibration.toml"
    save_calibration(path, GOOD, "1", "today")
    load_calibration(path)
    lines = path.read_text(encoding="utf-8").splitlines()
    value = "1e6" if get_args(CalibrationFile.model_fields[key].annotation) == () else "[0.0, 0.0, 1e6]"
    path.write_text("\n".join(f"{key} = {value}" if s.startswith(f"{key} =") else s for s in lines), encoding="utf-8")
    with pytest.raises(InvalidFileError, match=key):
        load_calibration(path)


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
    calibration: Calibration = replace(GOOD, **changes)
    RobotFile().settings(GOOD, data_sheet(0.05))
    with pytest.raises(InvalidValueError, match=field):
        RobotFile().settings(calibration, data_sheet(0.05))


def test_another_arm_than_the_file_names_is_refused(tmp_path: Path):
    path = tmp_path / "robot.toml"
    path.write_text('[arm]\nserial = "AC1"\nfirmware = "0x20600"\n', encoding="utf-8")
    file = load_robot_file(path)
    file.check_arm(ArmIdentity("GEN3", "AC1", "0x20600"))
    for other in (ArmIdentity("GEN3", "AC2", "0x20600"), ArmIdentity("GEN3", "AC1")):
        with pytest.raises(InvalidValueError, match="which the arm reports"):
            file.check_arm(other)


def test_a_record_that_cannot_be_written_is_refused_before_motion(tmp_path: Path):
    (tmp_path / "file").touch()
    with pytest.raises(Exception, match="the record cannot be written"):
        RawRecord(tmp_path / "file")
