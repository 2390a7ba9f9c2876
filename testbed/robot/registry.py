"""Registry of arms, wrench sensors, grippers and cameras: built-in names, entry points, and "package:Class".

The robot file names one of each (`model`). Arguments of the class are those of its `settings` table, and those fields
of its own table that the class has as parameters (`address`, `port`, ...).
"""

from __future__ import annotations

import inspect
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, TypeVar

from testbed.errors import HeftError, InvalidValueError
from testbed.plugins import Role, configured, find_class, load_class
from testbed.robot.camera.interface import ObjectCamera
from testbed.robot.config import RobotFile
from testbed.robot.interfaces import Arm, Gripper, WrenchSensor
from testbed.toml import load_toml
from testbed.validation import check_settings

T = TypeVar("T")
_CONTEXT = ("__enter__(self)", "__exit__(self, kind, error, trace)")
ARM: Role[Arm] = Role(
    "testbed.robot.interfaces.Arm",
    (*_CONTEXT, "state(self)", "move_to(self, pose, speed)", "twist(self, linear, angular)", "stop(self)"),
    "heft.arms",
    "my_lab:Ur5",
)
SENSOR: Role[WrenchSensor] = Role(
    "testbed.robot.interfaces.WrenchSensor",
    (*_CONTEXT, "drain(self)", "health(self)"),
    "heft.sensors",
    "my_lab:Nano17",
)
GRIPPER: Role[Gripper] = Role(
    "testbed.robot.interfaces.Gripper",
    ("data_sheet(width)", "width(self)", "close_on(self, width, force)", "open(self, width)"),
    "heft.grippers",
    "my_lab:HandE",
)
CAMERA: Role[ObjectCamera] = Role(
    "testbed.robot.camera.interface.ObjectCamera",
    (*_CONTEXT, "drain(self)"),
    "heft.cameras",
    "my_lab:Tags",
)
DEVICES = {
    ARM: {"kinova_gen3": "testbed.robot.kinova.arm:KortexArm"},
    SENSOR: {"ft300s": "testbed.robot.robotiq.ft300s:Ft300s"},
    GRIPPER: {"2f85": "testbed.robot.kinova.gripper:KortexGripper"},
    CAMERA: {"udp": "testbed.robot.camera.udp:UdpCamera"},
}
"""Built-in devices by name; imported on use, since each needs its driver."""
DEFAULT = "robot.toml"
"""Name of the robot file; without the file the defaults apply."""
_TABLES = {ARM: "arm", SENSOR: "sensor", GRIPPER: "gripper", CAMERA: "camera"}
_FILLED = {
    ARM: ("address", "port", "username", "tool_length", "password"),
    SENSOR: ("port",),
    GRIPPER: ("arm",),
    CAMERA: (),
}
"""Arguments filled in from the fields of the table, where a class has such a parameter."""
PASSWORD_VARIABLE = "HEFT_KORTEX_PASSWORD"
"""Environment variable with the password of the arm's user; the manufacturer's default if not set."""


def load_robot_file(path: Path) -> RobotFile:
    """Load a robot file and check the numbers of its devices' settings; the defaults if there is no `robot.toml`.

    Raises:
        InvalidFileError: not a robot file, with a line for each error.
        InvalidValueError: no file of another name, or a folder in place of a file; a device's number outside its range,
            or without a range.
    """
    if not path.is_file():
        if path.name != DEFAULT or path.exists():
            raise InvalidValueError("config", str(path), "a path to an existing .toml file")
        return RobotFile()
    file = load_toml(path, RobotFile)
    for role, table in _TABLES.items():
        device = getattr(file, table)
        if device.model is None or (device.model in DEVICES[role] and not device.settings):
            continue  # nothing to check; built-in drivers are imported on use
        try:
            kind = _class_of(role, device.model, f"{table}.model")
        except HeftError:  # building the device, which a dry run does not do, raises this again
            continue
        check_settings(kind, device.settings, f"{table}.settings", skip=_FILLED[role])
    return file


def build_arm(file: RobotFile) -> Arm:
    """Construct the robot file's arm, not yet connected.

    Raises:
        InvalidValueError: no such arm, or a setting that it refuses.
    """
    table = file.arm
    offered = table.model_dump(include={"address", "port", "username"})
    offered |= {"tool_length": table.tool_length_m, "password": os.environ.get(PASSWORD_VARIABLE, "admin")}
    return _build(ARM, table.model, table.settings, "arm", offered)


def build_sensor(file: RobotFile, port: str | None = None) -> WrenchSensor:
    """Construct the robot file's sensor, not yet opened; `port` overrides the file's.

    Raises:
        InvalidValueError: no such sensor, no port for one that needs it, or a setting that it refuses.
        MissingDriverError: its driver is not installed.
    """
    table = file.sensor
    port = port or table.port
    if port is None and needs_port(file):
        allowed = '[sensor] port = "/dev/serial/by-id/..." in robot.toml; heft robot check lists the ports there are'
        raise InvalidValueError("sensor.port", None, allowed)
    settings = table.settings if port is None else {k: v for k, v in table.settings.items() if k != "port"}
    return _build(SENSOR, table.model, settings, "sensor", {} if port is None else {"port": port})


def build_gripper(file: RobotFile, arm: Arm) -> Gripper:
    """Construct the robot file's gripper on an arm.

    Raises:
        InvalidValueError: no such gripper, or a setting that it refuses.
    """
    return _build(GRIPPER, file.gripper.model, file.gripper.settings, "gripper", {"arm": arm})


def build_camera(file: RobotFile) -> ObjectCamera | None:
    """Construct the robot file's camera, not yet opened; None if the file names none.

    Raises:
        InvalidValueError: no such camera, or a setting that it refuses.
    """
    table = file.camera
    return None if table.model is None else _build(CAMERA, table.model, table.settings, "camera", {})


def gripper_class(file: RobotFile) -> type[Gripper]:
    """Class of the robot file's gripper, whose `data_sheet` needs no connection.

    Raises:
        InvalidValueError: no such gripper.
    """
    return _class_of(GRIPPER, file.gripper.model, "gripper.model")


def needs_port(file: RobotFile) -> bool:
    """True if the robot file's sensor cannot be opened without a port, and its settings name none.

    Raises:
        InvalidValueError: no such sensor.
        MissingDriverError: its driver is not installed.
    """
    argument = inspect.signature(_class_of(SENSOR, file.sensor.model, "sensor.model")).parameters.get("port")
    return argument is not None and argument.default is argument.empty and "port" not in file.sensor.settings


def _class_of(role: Role[T], name: str, field: str) -> type[T]:
    known = DEVICES[role]
    return load_class(known[name], role, field) if name in known else find_class(name, role, field, known)


def _build(role: Role[T], name: str, settings: Mapping[str, Any], table: str, offered: Mapping[str, Any]) -> T:
    kind = _class_of(role, name, f"{table}.model")
    check_settings(kind, settings, f"{table}.settings", skip=_FILLED[role])
    filled = {key: value for key, value in offered.items() if key not in settings}
    return configured(kind, settings, f"{table}.settings", given=filled)
