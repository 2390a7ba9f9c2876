"""The real robot: interfaces of arm, gripper, sensor and pose source, their registry, the trial runner and its guards.

The names below load their module on first use; the process that speaks Kortex reads this package with another Python,
without heft's dependencies.
"""

from typing import TYPE_CHECKING

from testbed.packages import lazy_names

if TYPE_CHECKING:
    from testbed.robot.config import RobotSettings
    from testbed.robot.interfaces import Arm, Gripper, ObjectPose, RobotError, WrenchSensor
    from testbed.robot.path import KnownPose
    from testbed.robot.registry import build_arm, build_gripper, build_sensor, load_robot_file
    from testbed.robot.runner import RealRunner
    from testbed.robot.safety import SafetyLimits


__all__ = [
    "Arm",
    "Gripper",
    "KnownPose",
    "ObjectPose",
    "RealRunner",
    "RobotError",
    "RobotSettings",
    "SafetyLimits",
    "WrenchSensor",
    "build_arm",
    "build_gripper",
    "build_sensor",
    "load_robot_file",
]

__getattr__, __dir__ = lazy_names(__name__)
