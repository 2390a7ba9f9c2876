"""Calibration of the sensor's mount and the tool by static poses, its checks by trials, and hand-eye calibration."""

from testbed.robot.calibration.file import load_hand_eye
from testbed.robot.calibration.hand_eye import TrackedPose

__all__ = ["TrackedPose", "load_hand_eye"]
