"""Calibration of the sensor's mount and the tool by static poses, its test by trials, and a tracker's by points."""

from testbed.robot.calibration.file import load_calibration, load_hand_eye, save_calibration, save_hand_eye
from testbed.robot.calibration.hand_eye import HandEye, TrackedPose, align
from testbed.robot.calibration.static_poses import Calibration, CalibrationError, StaticPose, calibrate, static_pose
from testbed.robot.calibration.trial import Finding, check_trial

__all__ = [
    "Calibration",
    "CalibrationError",
    "Finding",
    "HandEye",
    "StaticPose",
    "TrackedPose",
    "align",
    "calibrate",
    "check_trial",
    "load_calibration",
    "load_hand_eye",
    "save_calibration",
    "save_hand_eye",
    "static_pose",
]
