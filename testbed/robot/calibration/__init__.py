"""Calibration of the sensor's mount and the tool by static poses, its test by trials, and a tracker's by points."""

from testbed.robot.calibration.file import load_hand_eye
from testbed.robot.calibration.hand_eye import TrackedPose

__all__ = ["TrackedPose", "load_hand_eye"]
