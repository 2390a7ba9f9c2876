"""Faults of programs and connections while the fake Gen3 moves, and what it then does: in real time, over the wire.

As a program it drives the arm like heft's control loop: `python -m tests.fakes.wire_faults PORT WAY WATCHDOG`.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from testbed.robot.interfaces import MonotonicClock, Pose, RobotError
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.runner import terminable
from tests.fakes.gen3 import FakeGen3, Faults
from tests.fakes.rig import KORTEX
from tests.fakes.world import TICK

Way = Literal["twists", "pose"]
ROOT = str(Path(__file__).parents[2])
UP = np.array([0.0, 0.0, 0.02])


def drive(port: int, way: Way, watchdog: float) -> None:
    """Drive the arm up until something ends it; prints the process ids of Kortex and "moving", then the error."""
    with terminable(), KortexArm("127.0.0.1", port=port, watchdog=watchdog) as arm:
        link = arm._link
        assert link is not None
        print(link._process.pid, link._standby.pid, flush=True)
        try:
            (_by_twists if way == "twists" else _to_a_pose)(arm)
        except RobotError as error:
            print(error, flush=True)


def _by_twists(arm: KortexArm) -> None:
    for _ in range(400):
        arm.state()
        arm.twist(UP, np.zeros(3))
        time.sleep(0.025)


def _to_a_pose(arm: KortexArm) -> None:
    def look() -> None:
        with suppress(RobotError):
            arm.state()

    start = arm.state().tcp_pose
    with MonotonicClock().every(0.01, look):
        arm.move_to(Pose(start.position + 10 * UP, start.orientation), float(UP[2]))


@dataclass
class Driver:
    """A program that drives the arm."""

    heft: subprocess.Popen[str]
    kortex: int
    """Id of the process that speaks Kortex."""
    standby: int
    """Id of the one that stops the arm if that ends."""


Fault = Callable[[Driver, FakeGen3], None]


def to_group(number: signal.Signals) -> Fault:
    """A signal to heft and all that shares its process group, as a terminal sends it."""
    return lambda driver, _: os.killpg(driver.heft.pid, number)


def to_kortex(driver: Driver, _: FakeGen3) -> None:
    """kill -9 of the process that speaks Kortex."""
    os.kill(driver.kortex, signal.SIGKILL)


def to_both(driver: Driver, _: FakeGen3) -> None:
    """kill -9 of heft and of that process."""
    os.kill(driver.kortex, signal.SIGKILL)
    driver.heft.kill()


def ctrl_z_and_refused(driver: Driver, gen3: FakeGen3) -> None:
    """Two at once: Stop is refused, so that the emergency stop is left, and Ctrl-Z."""
    gen3.faults.refuse = "Base.Stop"
    os.killpg(driver.heft.pid, signal.SIGTSTP)


WIRE_FAULTS: dict[str, Fault] = {
    "Ctrl-C": to_group(signal.SIGINT),
    "Ctrl-Z": to_group(signal.SIGTSTP),
    "Ctrl-\\": to_group(signal.SIGQUIT),
    "closed terminal (SIGHUP)": to_group(signal.SIGHUP),
    "SIGTERM to the group": to_group(signal.SIGTERM),
    "SIGSTOP of heft": to_group(signal.SIGSTOP),
    "kill -9 of heft": to_group(signal.SIGKILL),
    "kill -9 of the arm's process": to_kortex,
    "kill -9 of both": to_both,
    "Ctrl-Z, and Stop is refused": ctrl_z_and_refused,
}


@dataclass(frozen=True)
class Stopped:
    """What the arm did after a fault."""

    stop_s: float
    """Time to the first stop that the arm was told [s]; infinite if it never was."""
    moved_mm: float
    """Way of the tool from the fault until it stood, or for 4 s [mm]."""
    said: str
    """Last words of the program, if it had any."""


@contextmanager
def driving(gen3: FakeGen3, way: Way, watchdog: float) -> Iterator[Driver]:
    """The program, once the arm moves; it and what it has started are killed at the end."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((ROOT, KORTEX))}
    environment.pop("HEFT_KORTEX_PYTHON", None)
    heft = subprocess.Popen(
        [sys.executable, "-m", "tests.fakes.wire_faults", str(gen3.port), way, str(watchdog)],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
        process_group=0,
    )
    try:
        assert heft.stdout is not None
        kortex, standby = map(int, heft.stdout.readline().split())
        deadline = time.monotonic() + 5.0
        while gen3.world.speed < 0.8 * UP[2] and time.monotonic() < deadline:
            time.sleep(TICK)
        yield Driver(heft, kortex, standby)
    finally:
        heft.kill()
        heft.wait()


def stopped_after(gen3: FakeGen3, fault: Fault, way: Way, watchdog: float = 0.05) -> Stopped:
    """Strike the moving arm, which does not stop by itself, and watch it for 4 s or until it stands."""
    gen3.faults = Faults(endures_silence=True)
    with driving(gen3, way, watchdog) as driver:
        gen3.commands.clear()
        begin, at = time.monotonic(), gen3.world.reading.tcp_pose.position
        fault(driver, gen3)
        stop = np.inf
        while time.monotonic() < begin + 4.0 and (stop == np.inf or gen3.world.speed > 5e-4):
            if stop == np.inf and ("Stop" in gen3.commands):
                stop = time.monotonic() - begin
            time.sleep(0.002)
        moved = float(np.linalg.norm(gen3.world.reading.tcp_pose.position - at))
        with suppress(ProcessLookupError):
            os.killpg(driver.heft.pid, signal.SIGCONT)
        with suppress(subprocess.TimeoutExpired):
            driver.heft.wait(1.0)
        driver.heft.kill()
        said = (driver.heft.stdout.read() if driver.heft.stdout else "").strip()
    gen3.faults = Faults()
    gen3.world.stop()
    return Stopped(stop, 1e3 * moved, said)


if __name__ == "__main__":
    drive(int(sys.argv[1]), "pose" if sys.argv[2] == "pose" else "twists", float(sys.argv[3]))
