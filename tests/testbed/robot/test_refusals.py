"""Values that the robot's classes and functions refuse, each with its field and what is allowed."""

import math
from dataclasses import replace

import numpy as np
import pytest

from testbed.actions.weigh import Weigh
from testbed.errors import InvalidValueError
from testbed.robot.calibration.hand_eye import align
from testbed.robot.calibration.static_poses import StaticPose, calibrate, static_pose
from testbed.robot.calibration.trial import check_trial
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import Pose
from testbed.robot.kinova.arm import GEN3, KortexArm
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.robot.robotiq.gripper import data_sheet
from testbed.robot.safety import SafetyLimits
from testbed.robot.weighing import Weighing, check_known_mass, held_center, weigh
from testbed.trial import Trial
from tests.fakes.robot import robot_for, small_object
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
        (lambda: replace(LIMITS, force=0.0), "SafetyLimits.force", "1 to 300 N"),
        (lambda: replace(LIMITS, age=math.nan), "SafetyLimits.age", "0.02 to 0.2 s"),
        (lambda: replace(LIMITS, joint_margin=-0.1), "SafetyLimits.joint_margin", "0 to 0.785398 rad"),
        (lambda: replace(SETTINGS, sensor_sign=0), "RobotSettings.sensor_sign", "one of 1, -1"),
        (lambda: replace(SETTINGS, table_height=math.inf), "RobotSettings.table_height", "-0.6 to 0.6 m"),
        (lambda: replace(SETTINGS, off_path=(-1.0, 1.0)), "RobotSettings.off_path[0]", "0 to 0.05 m"),
        (lambda: replace(SETTINGS, rate=0.0), "RobotSettings.rate", "20 to 1000 Hz"),
        (lambda: Pose(np.zeros(3), np.zeros(4)), "Pose.orientation", "a unit quaternion, wxyz"),
        (lambda: replace(GEN3, joint_range=np.ones((7, 2))), "ArmLimits.joint_range", "a lower and a higher angle"),
        (lambda: replace(GEN3, joint_speed=np.zeros(7)), "ArmLimits.joint_speed", "numbers > 0, rad/s"),
        (lambda: KortexArm(port=0), "KortexArm.port", "an integer from 1 to 65535"),
        (lambda: KortexArm(watchdog=0.0), "KortexArm.watchdog", "0.02 to 0.1 s"),
        (lambda: Ft300s("/dev/none", stale_after=0.0), "Ft300s.stale_after", "0.03 to 0.2 s"),
        (lambda: robot_for(Trial(small_object(), Weigh()), weight=0.0), "RealRunner.weight", "a finite number > 0"),
    ],
)
def test_it_is_refused(call, field, allowed):
    with pytest.raises(InvalidValueError) as refused:
        call()
    assert refused.value.field == field
    assert refused.value.allowed.startswith(allowed)
