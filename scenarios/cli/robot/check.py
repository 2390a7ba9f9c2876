"""`heft robot check`: the parts of the real robot, a line each, in the order in which one needs another."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

if TYPE_CHECKING:
    from testbed.robot.config import RobotFile


def check(*, config: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("robot.toml")) -> None:
    """Show which parts of the real robot are there, what is missing, and what to do about it. Moves nothing.

    The robot is described by a file, robot.toml in the current folder: its arm, sensor, gripper and table, and the
    limits of every motion. docs/hardware.md has every field and the way from here to a first trial, step by step.

    Exit code: 0 all that a trial needs is there, 1 something is missing.
    Example: heft robot check --config benches/left.toml

    Args:
        config: robot file; without a robot.toml, its defaults.
    """
    from rich.console import Console

    console, missing = Console(), 0
    for line in _lines(config):
        missing += line.state == "missing"
        console.print(f"{line.state:8}{line.part}: {line.text}", highlight=False, markup=False, soft_wrap=True)
    later = f"{missing} missing; a trial can be planned with --dry-run all the same"
    console.print(later if missing else "a trial can be run", highlight=False)
    if missing:
        sys.exit(1)


@dataclass(frozen=True)
class Line:
    """One finding."""

    part: str
    state: str
    """ok, missing, or note: a trial can do without."""
    text: str


def _lines(config: Path) -> Iterator[Line]:
    from testbed.robot.config import load_robot_file
    from testbed.robot.kinova.link import missing_api

    file = load_robot_file(config)
    there = config.is_file()
    yield Line("config", "ok" if there else "note", str(config) if there else f"no {config}: defaults are used")
    for package in ("pyserial", "pymodbus"):
        yield _package(package, "pip install 'heft[robot]'", needed=file.sensor.model == "ft300s")
    yield _package("rerun-sdk", "heft robot sensor then prints numbers", needed=False)
    lack = missing_api(file.arm.python) if file.arm.model == "kinova_gen3" else ""
    if file.arm.model == "kinova_gen3":
        text = lack or "can be imported by the process that speaks to the arm"
        yield Line("kortex_api", "missing" if lack else "ok", text)
    serial: list[str] = []
    yield from _sensor(file, serial)
    yield _calibration(file, config, *serial)
    yield _arm(file, can_connect=not lack)
    box = file.limits
    spans = ", ".join(f"{axis} {a:g} to {b:g}" for axis, a, b in zip("xyz", box.low_m, box.high_m, strict=True))
    yield Line("limits", "ok", f"box {spans} m; {box.speed_m_s:g} m/s, {box.turn_deg_s:g} deg/s, {box.force_N:g} N")


def _package(name: str, hint: str, *, needed: bool) -> Line:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return Line(name, "ok", version(name))
    except PackageNotFoundError:
        return Line(name, "missing" if needed else "note", f"not installed: {hint}")


def _sensor(file: RobotFile, serial: list[str]) -> Iterator[Line]:
    """Findings on the sensor; its serial number goes to `serial`."""
    import time

    from testbed.errors import HeftError
    from testbed.robot.interfaces import MissingDriverError
    from testbed.robot.registry import build_sensor, needs_port

    try:
        if file.sensor.port is None and needs_port(file):
            from testbed.robot.robotiq.serial_port import usb_serial_ports

            found = ", ".join(usb_serial_ports()) or "none: plug in the USB adapter"
            yield Line("sensor", "missing", f'no [sensor] port = "..." in the config; USB serial ports: {found}')
            return
        with build_sensor(file) as sensor:
            time.sleep(1.0)
            health, identity = sensor.health(), sensor.identity
    except MissingDriverError:
        yield Line("sensor", "missing", "needs pyserial and pymodbus")
        return
    except HeftError as error:
        yield Line("sensor", "missing", str(error))
        return
    serial.append(identity.serial)
    text = f"{identity.name} {identity.serial}, firmware {identity.firmware}, {health.frames} frames in 1 s"
    yield Line("sensor", "ok" if health.frames > 0.9 * identity.rate_hz else "missing", text)
    for warning in health.warnings:
        yield Line("sensor", "note", warning)


def _calibration(file: RobotFile, config: Path, serial: str | None = None) -> Line:
    from testbed.errors import HeftError
    from testbed.robot.calibration.static_poses import MISFIT
    from testbed.robot.config import calibration_of

    path = config.parent / file.sensor.calibration
    try:
        calibration = calibration_of(file, config, serial)
    except HeftError as error:
        return Line("calibration", "missing", str(error).replace("\n", "; "))
    if calibration is None:
        return Line("calibration", "missing", f"no {path}: heft robot calibrate makes it")
    mass = f"sign {calibration.sign:+d}, tool {calibration.mass:.3f} +- {calibration.mass_std:.3f} kg"
    bad = calibration.misfit > MISFIT
    worse = f"; allowed: {MISFIT:g}: calibrate again" if bad else ""
    return Line("calibration", "note" if bad else "ok", f"{path}: {mass}, misfit {calibration.misfit:.1f}{worse}")


def _arm(file: RobotFile, *, can_connect: bool) -> Line:
    from testbed.errors import HeftError
    from testbed.robot.registry import build_arm

    address, name = f"{file.arm.address}:{file.arm.port}", file.arm.model
    if name == "kinova_gen3":
        import socket

        name = file.arm.address
        try:
            socket.create_connection((file.arm.address, file.arm.port), 2.0).close()
        except OSError as error:
            why = error.strerror or str(error)
            hint = "power it, plug in its cable, give this computer an address beside it, as 192.168.1.11/24"
            return Line("arm", "missing", f"{address}: {why}; {hint}")
        if not can_connect:
            return Line("arm", "note", f"{address} answers; kortex_api is needed to say more")
    try:
        with build_arm(file) as arm:
            state = arm.state()
    except HeftError as error:
        return Line("arm", "missing", str(error))
    x, y, z = state.tcp_pose.position
    place = f"tool at ({x:.3f}, {y:.3f}, {z:.3f}) m"
    if state.faulted:
        return Line("arm", "missing", f"{name}: {state.message}; clear it in the Web App; {place}")
    return Line("arm", "ok", f"{name}: no fault; {place}")
