"""Time as a port: the computer's own, or a simulated bench's that runs faster."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float

from testbed.errors import HeftError, InvalidValueError
from testbed.validation import check_positive, frozen_array


@runtime_checkable
class Clock(Protocol):
    """What time it is, waiting, and being called while others wait."""

    def now(self) -> float:
        """s, since any moment; the clock of every `time_s` of the ports."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; not at all where `seconds` <= 0."""
        ...

    def every(self, period: float, call: Callable[[], None]) -> AbstractContextManager[None]:
        """While entered, `call` is called every `period` s whatever the caller does, also where it hangs."""
        ...


class MonotonicClock:
    """`time.monotonic`, and a thread for what is called."""

    def now(self) -> float:
        """s."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)

    @contextmanager
    def every(self, period: float, call: Callable[[], None]) -> Iterator[None]:
        """Call from a daemon thread; a call that is late is made at once, and those that were missed are not."""
        done = threading.Event()

        def run() -> None:
            due = time.monotonic()
            while not done.wait(max(due - time.monotonic(), 0.0)):
                call()
                due = max(due + period, time.monotonic())

        thread = threading.Thread(target=run, name="every", daemon=True)
        thread.start()
        try:
            yield
        finally:
            done.set()
            thread.join(1.0)


class RobotError(HeftError):
    """Something of the real bench that failed or refused; the message says what to do about it."""


class MissingDriverError(RobotError, ImportError):
    """A driver package that is not installed.

    Args:
        package: its name.
    """

    def __init__(self, package: str):
        super().__init__(f"{package}: not installed; pip install 'heft[robot]'")


class SensorLostError(RobotError):
    """The wrench sensor is gone, silent, or sends nothing that can be read."""


class ArmLostError(RobotError):
    """No connection to the arm, or its feedback is stale."""


class ArmRefusedError(RobotError):
    """The arm is in a fault, or refused a command."""


@dataclass(frozen=True, eq=False)
class Pose:
    """Where a frame is in the arm's base frame."""

    position: Float[np.ndarray, "3"]
    """m."""
    orientation: Float[np.ndarray, "4"]
    """Unit quaternion, wxyz."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen_array("Pose.position", self.position, (3,)))
        object.__setattr__(self, "orientation", frozen_array("Pose.orientation", self.orientation, (4,)))
        length = float(np.linalg.norm(self.orientation))
        if abs(length - 1) > 1e-3:
            raise InvalidValueError("Pose.orientation", f"length {length:g}", "a unit quaternion, wxyz")


@dataclass(frozen=True, eq=False)
class WrenchSample:
    """One frame of the sensor."""

    time_s: float
    """Arrival of the frame's last byte, s."""
    wrench: Float[np.ndarray, "6"]
    """As the sensor reports it: N, N m, its own axes, about its own origin, bias included."""
    sequence: int
    """Place among the frames received since the stream was opened, from 0; a lost frame takes no number."""


@dataclass(frozen=True)
class SensorIdentity:
    """Which sensor it is, and what it can do."""

    name: str
    """Maker and model."""
    serial: str
    """Serial number, or "unknown"."""
    firmware: str
    """Version of its firmware, or "unknown"."""
    rate_hz: float
    """Frames a second."""
    force_range: float
    """Largest force along any axis, N."""
    torque_range: float
    """Largest torque about any axis, N m."""


@dataclass(frozen=True)
class SensorHealth:
    """Counts since the stream was opened."""

    frames: int
    """Whole frames received."""
    crc_errors: int
    """Frames whose checksum did not fit."""
    resyncs: int
    """Times that bytes had to be skipped to find the next frame."""
    lost_frames: int
    """Frames that should have come by the sensor's rate and did not: damaged or missing."""
    dropouts: int
    """Silences of several frames that ended by themselves."""
    age_s: float
    """Time since the latest whole frame, s; infinite before the first."""


@runtime_checkable
class WrenchSensor(Protocol):
    """A six-axis wrench sensor that streams. Entering opens it and starts the stream; leaving stops it and closes."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @property
    def identity(self) -> SensorIdentity:
        """Which sensor it is; serial and firmware are "unknown" before it is entered."""
        ...

    def latest(self) -> WrenchSample | None:
        """The newest frame, or None before the first; it stays for `drain`.

        Raises:
            SensorLostError: unplugged, or silent for too long.
        """
        ...

    def drain(self) -> Sequence[WrenchSample]:
        """Every frame since the last drain, in order; nothing is dropped between.

        Raises:
            SensorLostError: unplugged, or silent for too long, and all that came before has been drained.
        """
        ...

    def health(self) -> SensorHealth:
        """Counts so far; never raises."""
        ...


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """What an arm can do, known before connecting."""

    joint_range: Float[np.ndarray, "7 2"]
    """Lowest and highest angle of each joint, rad; infinite where it turns for ever."""
    joint_speed: Float[np.ndarray, "7"]
    """rad/s."""
    linear_speed: float
    """Of a commanded twist, m/s."""
    angular_speed: float
    """Of a commanded twist, rad/s."""
    payload: float
    """All that may hang from the flange, kg: sensor, gripper and object."""
    rate_hz: float
    """Highest rate of twist commands, Hz."""

    def __post_init__(self) -> None:
        ranges = frozen_array("ArmLimits.joint_range", self.joint_range, (7, 2), finite=False)
        if not (ranges[:, 0] < ranges[:, 1]).all():
            raise InvalidValueError(
                "ArmLimits.joint_range", ranges.tolist(), "a lower and a higher angle for each joint"
            )
        object.__setattr__(self, "joint_range", ranges)
        speeds = frozen_array("ArmLimits.joint_speed", self.joint_speed, (7,))
        if not (speeds > 0).all():
            raise InvalidValueError("ArmLimits.joint_speed", speeds.tolist(), "numbers > 0, rad/s")
        object.__setattr__(self, "joint_speed", speeds)
        for name in ("linear_speed", "angular_speed", "payload", "rate_hz"):
            check_positive(f"ArmLimits.{name}", getattr(self, name))


@dataclass(frozen=True, eq=False)
class ArmState:
    """The arm as its own feedback has it."""

    time_s: float
    """Arrival of the feedback, s."""
    joint_position: Float[np.ndarray, "7"]
    """rad."""
    joint_velocity: Float[np.ndarray, "7"]
    """rad/s."""
    tcp_pose: Pose
    """Of the tool centre point."""
    tcp_twist: Float[np.ndarray, "6"]
    """Linear and angular velocity of the tool at the TCP, base axes, m/s and rad/s."""
    faulted: bool = False
    """Whether the arm refuses to move until its faults are cleared."""
    message: str = ""
    """What the fault is, else empty."""

    def __post_init__(self) -> None:
        for name, size in (("joint_position", 7), ("joint_velocity", 7), ("tcp_twist", 6)):
            object.__setattr__(self, name, frozen_array(f"ArmState.{name}", getattr(self, name), (size,)))


@runtime_checkable
class Arm(Protocol):
    """A seven-joint arm. Entering connects and moves nothing; leaving stops it and disconnects."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...

    @property
    def limits(self) -> ArmLimits:
        """What it can do; known before connecting."""
        ...

    def state(self) -> ArmState:
        """The newest feedback.

        Raises:
            ArmLostError: no connection, or no fresh feedback.
        """
        ...

    def move_to(self, pose: Pose, speed: float) -> None:
        """Move the TCP to a pose at no more than `speed` (m/s); returns when it is there or when `stop` was called.

        Raises:
            ArmRefusedError: in a fault, or the pose was refused or not reached.
            ArmLostError: the connection was lost on the way.
        """
        ...

    def twist(self, linear: Float[np.ndarray, "3"], angular: Float[np.ndarray, "3"]) -> None:
        """Move the TCP at a velocity, base axes, m/s and rad/s, until the next command; returns at once.

        An arm stops by itself when no further twist comes for a while: its port sees to that.

        Raises:
            ArmRefusedError: in a fault, or beyond its limits.
            ArmLostError: no connection.
        """
        ...

    def stop(self) -> None:
        """Stop all motion. From any thread, as often as wanted, also where nothing moves or nothing is connected.

        A twist or a pose that was asked for before no longer counts, also where it is still on its way.
        """
        ...

    def clear_faults(self) -> None:
        """Ask the arm to forget its faults; moves nothing.

        Raises:
            ArmRefusedError: a fault remains.
            ArmLostError: no connection.
        """
        ...


@runtime_checkable
class Gripper(Protocol):
    """A parallel gripper."""

    def width(self) -> float:
        """Opening between the pads, m."""
        ...

    def close_on(self, width: float, force: float) -> None:
        """Close on something `width` (m) wide with `force` (N); returns when it holds.

        Raises:
            ArmRefusedError: closed on nothing, or refused.
        """
        ...

    def open(self) -> None:
        """Open fully; returns when it is open."""
        ...


@runtime_checkable
class ObjectPose(Protocol):
    """Where the object lies: the arm's taught pose, or a user's tracker."""

    def read(self) -> tuple[float, float, float]:
        """Planar pose of the object frame in the arm's base frame: x, y (m) and yaw (rad).

        Raises:
            RobotError: not known now.
        """
        ...
