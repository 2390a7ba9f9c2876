"""`heft robot sensor`: the wrench sensor live in Rerun, as numbers, or against a known mass."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np
import tyro

if TYPE_CHECKING:
    from testbed.robot.interfaces import WrenchSensor

_PERIOD = 0.05
_WEIGHING_TIME = 3.0


def sensor(
    *,
    config: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("robot.toml"),
    port: Annotated[str | None, tyro.conf.arg(metavar="DEVICE")] = None,
    seconds: Annotated[float, tyro.conf.arg(metavar="S")] = 30.0,
    mass: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    viewer: bool = True,
) -> None:
    """Show the wrench sensor live in Rerun or as one line per second, or check it against a known mass. Moves nothing.

    Numbers are mean +- standard deviation over one second, forces then torques, with the sensor's own zero and sign.
    Exit code: 1 if the reading disagrees with the mass, or if more than 1 % of the frames are lost.

    Examples: heft robot sensor --port /dev/ttyUSB0 --no-viewer --seconds 5
              heft robot sensor --mass 2

    Args:
        config: robot file, of which only the sensor is used.
        port: device file of the sensor; default: as in the robot file.
        seconds: duration.
        mass: known mass to hang from the tool on request, kg.
        viewer: show the readings in Rerun; otherwise, or if no viewer opens, print numbers.
    """
    from testbed.robot.registry import build_sensor, load_robot_file
    from testbed.validation import check_positive

    check_positive("--seconds", seconds)
    if mass is not None:
        check_positive("--mass", mass)
    with build_sensor(load_robot_file(config), port) as device:
        identity = device.identity
        print(f"{identity.name}, serial {identity.serial}, firmware {identity.firmware}, {identity.rate_hz:g} Hz")
        for warning in device.health().warnings:
            print(warning)
        if mass is not None:
            good = _agrees(device, mass)
        else:
            _watch(device, seconds, _viewer(identity.serial) if viewer else None)
            health = device.health()
            print(
                f"{health.frames} frames, {health.lost_frames} lost, {health.crc_errors} with a wrong checksum, "
                f"{health.dropouts} silences"
            )
            good = health.lost_frames <= 0.01 * health.frames
    if not good:
        sys.exit(1)


def reading(device: WrenchSensor, seconds: float) -> np.ndarray:
    """Samples of some seconds [N, N m], shape (T, 6)."""
    device.drain()
    end, kept = time.monotonic() + seconds, []
    while time.monotonic() < end:
        time.sleep(_PERIOD)
        kept += [sample.wrench for sample in device.drain()]
    return np.array(kept).reshape(-1, 6)


def _viewer(serial: str) -> Callable[[list[float], np.ndarray], None] | None:
    """A function that sends samples to Rerun; None, with the reason printed, without a viewer."""
    try:
        from viz.recordings.trial import SensorStream
        from viz.recordings.viewer import ViewerError, open_viewer
    except ImportError:
        print("Rerun is not installed; numbers instead")
        return None
    try:
        return SensorStream(open_viewer(), f"sensor {serial}").send
    except ViewerError as error:
        print(f"{error}; numbers instead")
        return None


def _watch(device: WrenchSensor, seconds: float, send: Callable[[list[float], np.ndarray], None] | None) -> None:
    """Send every sample to a viewer, or print a line per second without one."""
    end, due = time.monotonic() + seconds, time.monotonic() + 1.0
    kept: list[np.ndarray] = []
    while (now := time.monotonic()) < end:
        samples = device.drain()
        wrenches = np.array([sample.wrench for sample in samples]).reshape(-1, 6)
        if send is not None:
            send([sample.time_s for sample in samples], wrenches)
        kept.append(wrenches)
        if send is None and now >= due:
            due += 1.0
            print(_line(np.concatenate(kept)), flush=True)
            kept.clear()
        time.sleep(_PERIOD)


def _line(wrenches: np.ndarray) -> str:
    mean, std = wrenches.mean(axis=0), wrenches.std(axis=0)
    force = " ".join(f"{m:8.2f} +- {s:.2f}" for m, s in zip(mean[:3], std[:3], strict=True))
    torque = " ".join(f"{m:8.4f} +- {s:.4f}" for m, s in zip(mean[3:], std[3:], strict=True))
    return f"{len(wrenches):4d} frames  N {force}  N m {torque}"


def _agrees(device: WrenchSensor, mass: float) -> bool:
    """True if two readings, without and with the mass [kg], agree with it; prints the verdict."""
    from testbed.robot.weighing import check_known_mass, weigh

    readings = []
    for request in (
        f"let nothing hang from the tool and press Enter ({_WEIGHING_TIME:g} s)",
        f"hang {mass:g} kg and press Enter",
    ):
        print(request, flush=True)
        sys.stdin.readline()
        readings.append(reading(device, _WEIGHING_TIME))
    verdict, text = check_known_mass(weigh(*readings, up=None), mass)
    print(text)
    return verdict == "agrees"
