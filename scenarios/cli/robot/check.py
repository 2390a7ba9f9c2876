"""`heft robot check` and `verify`: the parts of the real robot, and the sensor by measured trials and physics alone."""

from __future__ import annotations

import sys
import time
from collections.abc import Generator, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

from testbed.errors import HeftError, InvalidValueError

if TYPE_CHECKING:
    from scenarios.results.trials import TrialRecord
    from testbed.robot.calibration.trial import Finding
    from testbed.robot.config import RobotFile


def check(*, config: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("robot.toml")) -> None:
    """Check which parts of the real robot are available, what is missing, and how to fix it. Moves nothing.

    The robot file, robot.toml in the current folder, describes the arm, sensor, gripper and table, and limits every
    motion. docs/hardware.md lists every field and the steps to a first trial.

    Exit code: 0 if everything that a trial needs is available, otherwise 1.

    Example: heft robot check --config benches/left.toml

    Args:
        config: robot file; defaults apply if there is no robot.toml.
    """
    from scenarios.cli.terminal import open_console

    console, missing = open_console(), 0
    for line in _lines(config):
        missing += line.state == "missing"
        console.print(f"{line.state:8}{line.part}: {line.text}", soft_wrap=True)
    later = f"{missing} missing; a trial can be planned with --dry-run all the same"
    console.print(later if missing else "a trial can be run")
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
    from testbed.robot.kinova.link import missing_api
    from testbed.robot.registry import load_robot_file

    file = load_robot_file(config)
    there = config.is_file()
    yield Line("config", "ok" if there else "note", str(config) if there else f"no {config}: defaults are used")
    for package in ("pyserial", "pymodbus"):
        yield _package(package, "pip install 'heft-testbed[robot]'", needed=file.sensor.model == "ft300s")
    yield _package("rerun-sdk", "heft robot sensor then prints numbers", needed=False)
    lack = ""
    if file.arm.model == "kinova_gen3":
        lack = missing_api()
        text = lack or "can be imported by the process that speaks to the arm"
        yield Line("kortex_api", "missing" if lack else "ok", text)
    serial = yield from _sensor(file)
    yield _calibration(file, config, serial)
    if file.camera.model is not None:
        yield _camera(file)
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


def _sensor(file: RobotFile) -> Generator[Line, None, str | None]:
    """Findings on the sensor; returns its serial number, None if it cannot be opened."""
    from testbed.robot.interfaces import MissingDriverError
    from testbed.robot.registry import build_sensor, needs_port

    try:
        if file.sensor.port is None and needs_port(file):
            from testbed.robot.robotiq.serial_port import usb_serial_ports

            found = ", ".join(usb_serial_ports()) or "none: plug in the USB adapter"
            yield Line("sensor", "missing", f'no [sensor] port = "..." in the config; USB serial ports: {found}')
            return None
        with build_sensor(file) as sensor:
            time.sleep(1.0)
            health, identity = sensor.health(), sensor.identity
    except HeftError as error:
        lacks_driver = isinstance(error, MissingDriverError)
        yield Line("sensor", "missing", "needs pyserial and pymodbus" if lacks_driver else str(error))
        return None
    text = f"{identity.name} {identity.serial}, firmware {identity.firmware}, {health.frames} frames in 1 s"
    yield Line("sensor", "ok" if health.frames > 0.9 * identity.rate_hz else "missing", text)
    for warning in health.warnings:
        yield Line("sensor", "note", warning)
    return identity.serial


def _calibration(file: RobotFile, config: Path, serial: str | None) -> Line:
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


def _camera(file: RobotFile) -> Line:
    from testbed.robot.registry import build_camera

    try:
        camera = build_camera(file)
        assert camera is not None
        with camera:
            time.sleep(1.0)
            frames = camera.drain()
    except HeftError as error:
        return Line("camera", "missing", str(error))
    if not frames:
        return Line("camera", "missing", "no frame in 1 s: clear its view, and look whether it streams")
    x, y, yaw = frames[-1].poses[0]
    seen = "unseen now" if np.isnan(x) else f"at ({x:.3f}, {y:.3f}) m, turned by {np.degrees(yaw):.1f} deg"
    parts = len(frames[-1].poses)
    return Line("camera", "ok", f"{len(frames)} frames in 1 s, of {parts} part{'s' * (parts > 1)}; the first {seen}")


def _arm(file: RobotFile, *, can_connect: bool) -> Line:
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
            state, who = arm.state(), arm.identity
        file.check_arm(who)
    except HeftError as error:
        return Line("arm", "missing", str(error))
    x, y, z = state.tcp_pose.position
    place = f"tool at ({x:.3f}, {y:.3f}, {z:.3f}) m; {who}"
    if state.faulted:
        return Line("arm", "missing", f"{name}: {state.message}; clear it in the Web App; {place}")
    return Line("arm", "ok", f"{name}: no fault; {place}")


def verify(folder: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="DIR")]) -> None:
    """Test the sensor's sign, rotation and zero with measured trials and physics only. Moves nothing.

    The tests need no masses: a hanging object pulls down, friction dissipates work in every turn and slide, the force
    of a slide opposes its motion, and the torque of a turn changes sign on the way back. The reading of a scale in the
    folder is compared with the lift. The centers of the turns reveal a wrong closing direction, TCP, grasp or side.
    Recommended: weighing by a lift, three turns there and back about separate points, and two slides.

    Exit code: 1 if something is wrong.

    Example: heft robot verify results/lab

    Args:
        folder: results folder of heft robot trial or heft import.
    """
    from scenarios.cli.terminal import open_console
    from scenarios.results.trials import measured_records

    console = open_console()
    sound = [t for t in measured_records(folder) if t.trajectory.ok]
    found = [
        (name, finding) for name in dict.fromkeys(t.object.name for t in sound) for finding in _findings(sound, name)
    ]
    if not found:
        raise InvalidValueError("DIR", str(folder), "a folder with measured turns, slides, or weighings by lifting")
    for name, finding in found:
        line = f"{'ok' if finding.ok else 'wrong':8}{name}: {finding.text}"
        console.print(line, soft_wrap=True)
    wrong, total = sum(not finding.ok for _, finding in found), len(found)
    console.print(f"{wrong} of {total} findings are wrong" if wrong else f"all {total} findings are as they should be")
    if wrong:
        sys.exit(1)


def _findings(trials: list[TrialRecord], name: str) -> list[Finding]:
    """Findings of one object's sound trials: its last lift, its turns and slides at constant speed."""
    from testbed.robot.calibration.motion import check_motion, check_wrenches
    from testbed.robot.calibration.trial import check_trial
    from testbed.sensing.windows import mean_covariance, weight_of

    of_object = [t for t in trials if t.object.name == name]
    records = [t.trajectory for t in of_object]
    weighings = [t for t in records if not t.action.moves]
    lifts = [t for t in weighings if "weight_std_kg" in t.figures]
    scale = [weight_of(t) for t in weighings if "weight_std_kg" not in t.figures]
    found: list[Finding] = []
    if lifts:
        wrench = lifts[-1].wrench_on_object_world
        covariance = mean_covariance(wrench) + np.diag(lifts[-1].sensor_bias_std ** 2)
        found += check_trial(wrench.mean(axis=0), covariance, [], mass=scale[-1] if scale else None)
    shape = of_object[0].object.shape
    return found + check_wrenches(shape, records) + check_motion(shape, records)
