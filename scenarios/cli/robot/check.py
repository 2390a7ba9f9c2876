"""What of the real bench is there: a line each, in the order in which one thing needs another."""

from __future__ import annotations

import socket
import time
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from rich.console import Console

from testbed.errors import HeftError
from testbed.robot.calibration.static_poses import MISFIT
from testbed.robot.config import RobotFile, calibration_of, load_robot_file
from testbed.robot.interfaces import MissingDriverError
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.kinova.link import missing_api


@dataclass(frozen=True)
class Line:
    """One finding."""

    what: str
    state: str
    """ok, missing, or note: what a trial can do without."""
    said: str

    @property
    def needed(self) -> bool:
        """Whether a trial cannot go on like this."""
        return self.state == "missing"


def check_bench(config: Path, console: Console) -> int:
    """Print every finding as it is made; 0 where nothing that is needed is missing, else 1."""
    missing = 0
    for line in _lines(config):
        missing += line.needed
        console.print(f"{line.state:8}{line.what}: {line.said}", highlight=False, markup=False, soft_wrap=True)
    text = (
        "a trial can be run"
        if not missing
        else f"{missing} missing; a trial can be planned with --dry-run all the same"
    )
    console.print(text, highlight=False)
    return int(missing > 0)


def _lines(config: Path) -> Iterator[Line]:
    file = load_robot_file(config)
    there = config.is_file()
    yield Line("config", "ok" if there else "note", str(config) if there else f"no {config}: defaults are used")
    for package in ("pyserial", "pymodbus"):
        yield _package(package, "pip install 'heft[robot]'", needed=True)
    yield _package("rerun-sdk", "heft robot sensor then prints numbers", needed=False)
    lack = missing_api(file.arm.python)
    yield Line(
        "kortex_api", "missing" if lack else "ok", lack or "can be imported by the process that speaks to the arm"
    )
    serial: list[str] = []
    yield from _sensor(file, serial)
    yield from _calibration(file, config, *serial)
    yield from _arm(file, can_connect=not lack)
    box = file.limits
    spans = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", box.low_m, box.high_m, strict=True))
    yield Line("limits", "ok", f"box {spans} m; {box.speed_m_s:g} m/s, {box.turn_deg_s:g} deg/s, {box.force_N:g} N")


def _package(name: str, hint: str, *, needed: bool) -> Line:
    try:
        return Line(name, "ok", version(name))
    except PackageNotFoundError:
        return Line(name, "missing" if needed else "note", f"not installed: {hint}")


def _sensor(file: RobotFile, serial: list[str]) -> Iterator[Line]:
    """Its serial number goes to `serial` where it answers."""
    try:
        from testbed.robot.robotiq.ft300s import Ft300s  # noqa: PLC0415
        from testbed.robot.robotiq.serial_port import usb_serial_ports  # noqa: PLC0415
    except MissingDriverError:
        yield Line("sensor", "missing", "needs pyserial and pymodbus")
        return
    if file.sensor.port is None:
        found = ", ".join(usb_serial_ports())
        yield Line(
            "sensor",
            "missing",
            f'no [sensor] port = "..." in the config; USB serial ports: {found or "none: plug in the USB adapter"}',
        )
        return
    try:
        with Ft300s(file.sensor.port) as sensor:
            time.sleep(1.0)
            health, identity = sensor.health(), sensor.identity
            serial.append(identity.serial)
            said = f"{identity.name} {identity.serial}, firmware {identity.firmware}, {health.frames} frames in 1 s"
            yield Line("sensor", "ok" if health.frames > 90 else "missing", said)
            for warning in sensor.warnings:
                yield Line("sensor", "note", warning)
    except HeftError as error:
        yield Line("sensor", "missing", str(error))


def _calibration(file: RobotFile, config: Path, serial: str | None = None) -> Iterator[Line]:
    where = config.parent / file.sensor.calibration
    try:
        calibration = calibration_of(file, config, serial)
    except HeftError as error:
        yield Line("calibration", "missing", str(error).replace("\n", "; "))
        return
    if calibration is None:
        yield Line("calibration", "missing", f"no {where}: heft robot calibrate makes it")
        return
    mass = f"sign {calibration.sign:+d}, tool {calibration.mass:.3f} +- {calibration.mass_std:.3f} kg"
    bad = calibration.misfit > MISFIT
    worse = f"; allowed: {MISFIT:g}: calibrate again" if bad else ""
    yield Line("calibration", "note" if bad else "ok", f"{where}: {mass}, misfit {calibration.misfit:.1f}{worse}")


def _arm(file: RobotFile, *, can_connect: bool) -> Iterator[Line]:
    settings = file.kortex()
    try:
        socket.create_connection((settings.address, settings.port), 2.0).close()
    except OSError as error:
        why = error.strerror or str(error)
        yield Line(
            "arm",
            "missing",
            f"{settings.address}:{settings.port}: {why}; power it, plug in its cable, give this computer an address "
            "beside it, as 192.168.1.11/24",
        )
        return
    if not can_connect:
        yield Line("arm", "note", f"{settings.address}:{settings.port} answers; kortex_api is needed to say more")
        return
    try:
        with KortexArm(settings) as arm:
            state = arm.state()
            x, y, z = state.tcp_pose.position
            where = f"tool at ({x:.3f}, {y:.3f}, {z:.3f}) m"
            if state.faulted:
                yield Line("arm", "missing", f"{settings.address}: {state.message}; clear it in the Web App; {where}")
            else:
                yield Line("arm", "ok", f"{settings.address}: no fault; {where}")
    except HeftError as error:
        yield Line("arm", "missing", str(error))
