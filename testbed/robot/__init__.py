"""The real robot: interfaces of arm, gripper, sensor and pose source, their registry, the trial runner and its guards.

The names below load their module on first use; the process that speaks Kortex reads this package with another Python,
without heft's dependencies.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from testbed.robot.config import RobotSettings, load_robot_file
    from testbed.robot.interfaces import Arm, Gripper, ObjectPose, RobotError, WrenchSensor
    from testbed.robot.path import KnownPose
    from testbed.robot.registry import build_arm, build_gripper, build_sensor
    from testbed.robot.runner import RealRunner
    from testbed.robot.safety import SafetyLimits

_MODULES = {
    "config": ("RobotSettings", "load_robot_file"),
    "interfaces": ("Arm", "Gripper", "ObjectPose", "RobotError", "WrenchSensor"),
    "path": ("KnownPose",),
    "registry": ("build_arm", "build_gripper", "build_sensor"),
    "runner": ("RealRunner",),
    "safety": ("SafetyLimits",),
}
_MODULE_OF = {name: f"{__name__}.{module}" for module, names in _MODULES.items() for name in names}

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


def __getattr__(name: str) -> Any:
    if name not in _MODULE_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULE_OF[name]), name)
