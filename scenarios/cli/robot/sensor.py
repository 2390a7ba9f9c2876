"""The sensor live: in Rerun, as numbers, or against a known mass."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from testbed.robot.config import load_robot_file, sensor_port
from testbed.robot.interfaces import WrenchSensor
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.robot.weighing import check_known_mass, weigh
from testbed.validation import check_positive

_PERIOD = 0.05
_WEIGHING_TIME = 3.0


def show_sensor(config: Path, port: str | None, seconds: float, mass: float | None, *, viewer: bool) -> int:
    """Show the sensor, or check it against a mass (kg); 0 where all is well, else 1.

    Raises:
        InvalidValueError: a time or a mass that is not above 0.
        RobotError: the sensor cannot be reached.
    """
    check_positive("--seconds", seconds)
    if mass is not None:
        check_positive("--mass", mass)
    with Ft300s(port or sensor_port(load_robot_file(config))) as sensor:
        identity = sensor.identity
        print(f"{identity.name}, serial {identity.serial}, firmware {identity.firmware}, {identity.rate_hz:g} Hz")
        for warning in sensor.warnings:
            print(warning)
        if mass is not None:
            return _weigh(sensor, mass)
        _watch(sensor, seconds, _viewer(identity.serial) if viewer else None)
        health = sensor.health()
    print(
        f"{health.frames} frames, {health.lost_frames} lost, {health.crc_errors} with a wrong checksum, "
        f"{health.dropouts} silences"
    )
    return int(health.lost_frames > 0.01 * health.frames)


def _viewer(serial: str) -> Callable[[list[float], np.ndarray], None] | None:
    """Sends samples to Rerun; None, with the reason printed, where there is none."""
    try:
        from viz.recordings.sensor import SensorStream  # noqa: PLC0415
        from viz.recordings.viewer import ViewerError, waiting  # noqa: PLC0415
    except ImportError:
        print("Rerun is not installed; numbers instead")
        return None
    try:
        return SensorStream(waiting(), f"sensor {serial}").send
    except ViewerError as error:
        print(f"{error}; numbers instead")
        return None


def _watch(sensor: WrenchSensor, seconds: float, send: Callable[[list[float], np.ndarray], None] | None) -> None:
    """Show what comes; a line a second where nobody takes it."""
    end, told = time.monotonic() + seconds, time.monotonic() + 1.0
    kept: list[np.ndarray] = []
    while (now := time.monotonic()) < end:
        samples = sensor.drain()
        wrenches = np.array([sample.wrench for sample in samples]).reshape(-1, 6)
        if send is not None:
            send([sample.time_s for sample in samples], wrenches)
        kept.append(wrenches)
        if send is None and now >= told:
            told += 1.0
            print(_line(np.concatenate(kept)), flush=True)
            kept.clear()
        time.sleep(_PERIOD)


def _line(wrenches: np.ndarray) -> str:
    mean, std = wrenches.mean(axis=0), wrenches.std(axis=0)
    force = " ".join(f"{m:8.2f} +- {s:.2f}" for m, s in zip(mean[:3], std[:3], strict=True))
    torque = " ".join(f"{m:8.4f} +- {s:.4f}" for m, s in zip(mean[3:], std[3:], strict=True))
    return f"{len(wrenches):4d} frames  N {force}  N m {torque}"


def _weigh(sensor: WrenchSensor, mass: float) -> int:
    """Two readings, without and with the mass; what they say of sensor and sign."""
    readings = []
    for say in (
        f"let nothing hang from the tool and press Enter ({_WEIGHING_TIME:g} s)",
        f"hang {mass:g} kg and press Enter",
    ):
        print(say, flush=True)
        sys.stdin.readline()
        readings.append(reading(sensor, _WEIGHING_TIME))
    found = check_known_mass(weigh(*readings, up=None), mass)
    print(found.said)
    return int(found.verdict != "agrees")


def reading(sensor: WrenchSensor, seconds: float) -> np.ndarray:
    """What the sensor says for some seconds, N and N m, (T, 6)."""
    sensor.drain()
    end, kept = time.monotonic() + seconds, []
    while time.monotonic() < end:
        time.sleep(_PERIOD)
        kept += [sample.wrench for sample in sensor.drain()]
    return np.array(kept).reshape(-1, 6)
