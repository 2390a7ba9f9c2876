"""Faults of programs and connections in each phase of a guarded trial on the fake Gen3: in real time, over the wire.

As a program it drives the arm under a guard: `python -m tests.fakes.wire_faults PORT PHASE`.
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
from typing import Literal, get_args

import numpy as np

from testbed.objects.model import STROKE
from testbed.robot.guard import Guard
from testbed.robot.interfaces import MonotonicClock, Pose, RobotError, SensorHealth, SensorIdentity, WrenchSample
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.runner import terminable
from testbed.robot.safety import SafetyLimits
from tests.fakes.gen3 import FakeGen3, Faults
from tests.fakes.rig import ATTEMPTS, KORTEX
from tests.fakes.robot import Entered
from tests.fakes.world import TICK

Phase = Literal["twists", "pose", "tare", "grasp"]
"""Twists, a travel move, standing after a motion, and the gripper closing."""
PHASES: tuple[Phase, ...] = get_args(Phase)
ROOT = str(Path(__file__).parents[2])
SPEED = 0.02
"""Speed of the tool [m/s]."""
_MIDDLE = 0.2
"""Height [m] towards which the tool moves."""
_LONG = 10.0
"""Duration of a phase [s]."""


class NoiseSensor(Entered):
    """A `WrenchSensor` that measures noise, 100 frames a second of the computer's clock."""

    identity = SensorIdentity("noise", "1", "1", 1 / TICK)

    def __init__(self) -> None:
        self._rng, self._next, self._count = np.random.default_rng(0), time.monotonic(), 0

    def drain(self) -> list[WrenchSample]:
        frames = []
        while self._next <= time.monotonic():
            frames.append(WrenchSample(self._next, 0.1 * self._rng.standard_normal(6), self._count))
            self._next, self._count = self._next + TICK, self._count + 1
        return frames

    def health(self) -> SensorHealth:
        return SensorHealth(self._count, 0, 0, 0, 0, 0.0)


def drive(port: int, phase: Phase) -> None:
    """Drive the arm until something ends it; prints the ids of its processes, the begin of the phase, and the error."""
    clock = MonotonicClock()
    with terminable(), KortexArm("127.0.0.1", port=port) as arm:
        link = arm._link
        assert link is not None
        print(link._process.pid, link._standby.pid, flush=True)
        limits = SafetyLimits(tilt=0.3)
        guard = Guard(arm, NoiseSensor(), limits, clock)
        try:
            with guard:
                start = guard.state().tcp_pose
                way = np.array([0.0, 0.0, SPEED if start.position[2] < _MIDDLE else -SPEED])
                if phase == "pose":
                    print("begins", flush=True)
                    arm.move_to(Pose(start.position + 5 * way, start.orientation), SPEED)
                elif phase == "twists":
                    print("begins", flush=True)
                    _follow(guard, way, _LONG)
                else:
                    _follow(guard, way, 0.3)
                    _rest(guard, 0.3)
                    print("begins", flush=True)
                    if phase == "grasp":
                        KortexGripper(arm).close_on(0.0, 10.0)
                    _rest(guard, _LONG)
                guard.check()
                print("went on to its end", flush=True)
        except RobotError as error:
            print(f"fault: {error}", flush=True)


def _follow(guard: Guard, way: np.ndarray, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        guard.twist(way, np.zeros(3))
        time.sleep(0.025)
    guard.twist(np.zeros(3), np.zeros(3))


def _rest(guard: Guard, seconds: float) -> None:
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        guard.check()
        time.sleep(0.025)


@dataclass
class Driver:
    """A program that drives the arm."""

    heft: subprocess.Popen[str]
    kortex: int
    """Id of the process that speaks Kortex."""
    standby: int
    """Id of the one that stops the arm if that ends."""


class TooBusyError(RuntimeError):
    """Some silence of a busy machine ended the program before the phase began."""


Fault = Callable[[Driver, FakeGen3], None]


def to_group(number: signal.Signals) -> Fault:
    """A signal to heft and all that shares its process group, as a terminal sends it."""
    return lambda driver, _: os.killpg(driver.heft.pid, number)


def signals(number: signal.Signals, *processes: Literal["heft", "kortex", "standby"]) -> Fault:
    """A signal to some of the processes."""

    def strike(driver: Driver, _: FakeGen3) -> None:
        ids = {"heft": driver.heft.pid, "kortex": driver.kortex, "standby": driver.standby}
        for process in processes:
            try:
                os.kill(ids[process], number)
            except ProcessLookupError:
                raise TooBusyError(f"{process} has ended already") from None

    return strike


def ctrl_z_and_refused(driver: Driver, gen3: FakeGen3) -> None:
    """Two at once: Stop is refused, so that the emergency stop is left, and Ctrl-Z."""
    gen3.faults.refuse = "Base.Stop"
    os.killpg(driver.heft.pid, signal.SIGTSTP)


def frozen_and_refused(driver: Driver, gen3: FakeGen3) -> None:
    """Stop is refused to the stand-by too."""
    gen3.faults.refuse = "Base.Stop"
    signals(signal.SIGSTOP, "kortex")(driver, gen3)


def frozen_and_reset(driver: Driver, gen3: FakeGen3) -> None:
    """The arm's process is frozen, and the stand-by must connect anew.

    Frozen first: the reset alone ends the arm's process, and could do so before the signal.
    """
    signals(signal.SIGSTOP, "kortex")(driver, gen3)
    gen3.reset()


STOP, KILL = signal.SIGSTOP, signal.SIGKILL
WIRE_FAULTS: dict[str, Fault] = {
    "Ctrl-C": to_group(signal.SIGINT),
    "Ctrl-Z": to_group(signal.SIGTSTP),
    "Ctrl-\\": to_group(signal.SIGQUIT),
    "closed terminal (SIGHUP)": to_group(signal.SIGHUP),
    "SIGTERM to the group": to_group(signal.SIGTERM),
    "kill -9 of heft": to_group(KILL),
    "kill -9 of the arm's process": signals(KILL, "kortex"),
    "kill -9 of the stand-by": signals(KILL, "standby"),
    "kill -9 of heft and the arm's process": signals(KILL, "kortex", "heft"),
    "kill -9 of heft and the stand-by": signals(KILL, "standby", "heft"),
    "SIGSTOP of heft": to_group(STOP),
    "SIGSTOP of the arm's process": signals(STOP, "kortex"),
    "SIGSTOP of the stand-by": signals(STOP, "standby"),
    "SIGSTOP of heft and the arm's process": signals(STOP, "heft", "kortex"),
    "SIGSTOP of heft and the stand-by": signals(STOP, "heft", "standby"),
    "arm resets the connection": lambda _, gen3: gen3.reset(controls=True),
    "arm resets the stand-by's connection": lambda _, gen3: gen3.reset(controls=False),
    "arm resets both": lambda _, gen3: gen3.reset(),
    "arm closes both": lambda _, gen3: gen3.drop(),
    "Ctrl-Z, and Stop is refused": ctrl_z_and_refused,
    "SIGSTOP of the arm's process, and Stop is refused": frozen_and_refused,
    "SIGSTOP of the arm's process, and both are reset": frozen_and_reset,
}
"""Faults after which a process is left that can stop the arm."""
LAST = "SIGSTOP of the arm's process and the stand-by"
"""The fault after which only the arm itself is left."""
freeze_both = signals(STOP, "kortex", "standby")


@dataclass(frozen=True)
class Stopped:
    """What the arm did after a fault."""

    stop_s: float
    """Time to the first stop command, or to the arm's own stop [s]; infinite without any."""
    moved_mm: float
    """Way of the tool from the fault until it stood, or for 4 s [mm]."""
    said: str
    """Last words of the program, as the record has them, if it had any."""


@contextmanager
def driving(gen3: FakeGen3, phase: Phase) -> Iterator[Driver]:
    """The program, once the phase has begun; it and its processes are killed at the end."""
    environment = os.environ | {"PYTHONPATH": os.pathsep.join((ROOT, KORTEX))}
    environment.pop("HEFT_KORTEX_PYTHON", None)
    heft = subprocess.Popen(
        [sys.executable, "-m", "tests.fakes.wire_faults", str(gen3.port), phase],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env=environment,
        process_group=0,
    )
    others: list[int] = []
    try:
        assert heft.stdout is not None
        others += map(int, heft.stdout.readline().split())
        begins = heft.stdout.readline()
        if begins != "begins\n":
            raise TooBusyError(begins)
        deadline = time.monotonic() + 5.0
        while not _in_phase(gen3, phase) and time.monotonic() < deadline:
            time.sleep(TICK)
        yield Driver(heft, *others)
    finally:
        heft.kill()
        heft.wait()
        for process in others:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)


def _in_phase(gen3: FakeGen3, phase: Phase) -> bool:
    if phase == "grasp":
        return gen3.world.width < 0.9 * STROKE
    return phase == "tare" or gen3.world.speed > 0.8 * SPEED


def stopped_after(gen3: FakeGen3, fault: Fault, phase: Phase, *, own_limit: bool = False) -> Stopped:
    """Strike in a phase, and watch the arm for 4 s or until it stands; by itself it stops only with `own_limit`."""
    for _ in range(ATTEMPTS):
        with suppress(TooBusyError):
            return _stopped_after(gen3, fault, phase, own_limit)
    raise TooBusyError(f"{ATTEMPTS} times")


def _stopped_after(gen3: FakeGen3, fault: Fault, phase: Phase, own_limit: bool) -> Stopped:
    gen3.faults = Faults(endures_silence=not own_limit)
    gen3.world.stop()
    gen3.world.open(STROKE)
    while gen3.world.width < 0.95 * STROKE:
        time.sleep(TICK)
    with driving(gen3, phase) as driver:
        gen3.commands.clear()
        begin, at = time.monotonic(), gen3.world.reading.tcp_pose.position
        fault(driver, gen3)
        stop = np.inf
        while time.monotonic() < begin + 4.0 and (stop == np.inf or gen3.world.speed > 5e-4):
            if stop == np.inf and {"Stop", "own limit"} & set(gen3.commands):
                stop = time.monotonic() - begin
            time.sleep(0.002)
        moved = float(np.linalg.norm(gen3.world.reading.tcp_pose.position - at))
        with suppress(ProcessLookupError):
            os.killpg(driver.heft.pid, signal.SIGCONT)
        with suppress(subprocess.TimeoutExpired):
            driver.heft.wait(3.0)
        driver.heft.kill()
        said = (driver.heft.stdout.read() if driver.heft.stdout else "").strip()
    gen3.faults = Faults()
    gen3.world.stop()
    return Stopped(stop, 1e3 * moved, said)


if __name__ == "__main__":
    drive(int(sys.argv[1]), PHASES[PHASES.index(sys.argv[2])])  # pyright: ignore[reportArgumentType]
