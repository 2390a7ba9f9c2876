"""Interfaces of the real robot: arm, gripper, wrench sensor, object pose, clock; their values and their errors."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Protocol, Self, runtime_checkable

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.errors import HeftError, InvalidValueError
from testbed.trajectory import Tool
from testbed.validation import check_positive_fields, freeze_arrays, frozen_array, unit_quaternion


class RobotError(HeftError):
    """Failure or refusal of the real robot; the message says what to do about it."""


class MissingDriverError(RobotError, ImportError):
    """A driver package that is not installed."""

    def __init__(self, package: str):
        super().__init__(f"{package}: not installed; pip install 'heft-testbed[robot]'")


class SensorLostError(RobotError):
    """The wrench sensor is gone, silent, or sends nothing that can be read."""


class ArmLostError(RobotError):
    """No connection to the arm, or its feedback is stale."""


class ArmRefusedError(RobotError):
    """The arm is in a fault, or refused a command."""


@runtime_checkable
class Clock(Protocol):
    """Time: the computer's own, or a simulated robot's that runs faster."""

    def now(self) -> float:
        """Time since any moment [s]; the clock of every `time_s` of the interfaces."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; not at all for `seconds` <= 0."""
        ...

    def every(self, period: float, call: Callable[[], None]) -> AbstractContextManager[None]:
        """Call `call` every `period` s while entered, whatever the caller does, also if it hangs."""
        ...


class MonotonicClock:
    """`time.monotonic`, with a thread for periodic calls."""

    def now(self) -> float:
        """Time [s]."""
        return time.monotonic()

    def sleep(self, seconds: float) -> None:
        """Wait."""
        if seconds > 0:
            time.sleep(seconds)

    @contextmanager
    def every(self, period: float, call: Callable[[], None]) -> Iterator[None]:
        """Call from a daemon thread; a late call is made at once, missed ones are not."""
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


@dataclass(frozen=True, eq=False)
class Pose:
    """Pose of a frame in the arm's base frame."""

    position: Float[np.ndarray, "3"]
    """Origin [m]."""
    orientation: Float[np.ndarray, "4"]
    """Unit quaternion, wxyz."""

    def __post_init__(self) -> None:
        freeze_arrays(self, position=(3,))
        object.__setattr__(self, "orientation", unit_quaternion("Pose.orientation", self.orientation))

    @property
    def rotation(self) -> Rotation:
        """Turn from the base's axes to the frame's."""
        return Rotation.from_quat(self.orientation, scalar_first=True)


@dataclass(frozen=True, eq=False)
class WrenchSample:
    """One frame of the sensor."""

    time_s: float
    """Arrival of the frame's last byte [s]."""
    wrench: Float[np.ndarray, "6"]
    """Wrench as reported [N, N m], sensor axes, about the sensor's origin, bias included."""
    sequence: int
    """Number among the frames received since the stream was opened, from 0; a lost frame takes no number."""


@dataclass(frozen=True)
class SensorIdentity:
    """Name and abilities of a sensor."""

    name: str
    """Maker and model."""
    serial: str
    """Serial number, or "unknown"."""
    firmware: str
    """Version of its firmware, or "unknown"."""
    rate_hz: float
    """Frame rate [Hz]."""
    force_range: float = math.inf
    """Largest force along an axis that it measures [N]."""
    torque_range: float = math.inf
    """Largest torque about an axis that it measures [N m]."""
    repeats: tuple[int, ...] = (20,) * 6
    """Most equal values in a row of each component: its noise allows no more."""
    noise: tuple[float, ...] | None = None
    """Standard deviation of each component at rest, per frame [N, N m]; 0 allows any, None takes that of its first 50
    frames."""


@dataclass(frozen=True)
class ArmIdentity:
    """Name of an arm; what it does not report is "unknown"."""

    model: str = "unknown"
    """Model number."""
    serial: str = "unknown"
    """Serial number."""
    firmware: str = "unknown"
    """Version of its firmware."""

    def __str__(self) -> str:
        return f"{self.model} {self.serial}, firmware {self.firmware}"


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
    """Frames that were due by the sensor's rate and did not come: damaged or missing."""
    dropouts: int
    """Silences of several frames that ended by themselves."""
    age_s: float
    """Time since the latest whole frame [s]; infinite before the first."""
    warnings: tuple[str, ...] = ()
    """Trouble with the connection that a trial can do with, a sentence each."""


@dataclass(frozen=True, eq=False)
class ArmLimits:
    """Limits of an arm, known before connecting."""

    joint_range: Float[np.ndarray, "7 2"]
    """Lowest and highest angle of each joint [rad]; infinite for a joint without an end."""
    joint_speed: Float[np.ndarray, "7"]
    """Highest speed of each joint [rad/s]."""
    linear_speed: float
    """Highest linear speed of a commanded twist [m/s]."""
    angular_speed: float
    """Highest angular speed of a commanded twist [rad/s]."""

    def __post_init__(self) -> None:
        ranges = frozen_array("ArmLimits.joint_range", self.joint_range, (7, 2), finite=False)
        if not (ranges[:, 0] < ranges[:, 1]).all():
            raise InvalidValueError(
                "ArmLimits.joint_range", ranges.tolist(), "a lower and a higher angle for each joint"
            )
        object.__setattr__(self, "joint_range", ranges)
        freeze_arrays(self, joint_speed=(7,))
        if not (self.joint_speed > 0).all():
            raise InvalidValueError("ArmLimits.joint_speed", self.joint_speed.tolist(), "numbers > 0, rad/s")
        check_positive_fields(self, "linear_speed", "angular_speed")


@dataclass(frozen=True, eq=False)
class ArmState:
    """State of the arm by its own feedback."""

    time_s: float
    """Arrival of the feedback [s]."""
    joint_position: Float[np.ndarray, "7"]
    """Joint angles [rad]."""
    joint_velocity: Float[np.ndarray, "7"]
    """Joint speeds [rad/s]."""
    tcp_pose: Pose
    """Pose of the tool center point (TCP)."""
    tcp_twist: Float[np.ndarray, "6"]
    """Linear and angular velocity of the tool at the TCP [m/s, rad/s], base axes."""
    faulted: bool = False
    """True if the arm refuses to move until its faults are cleared."""
    message: str = ""
    """Name of the fault, else empty."""

    def __post_init__(self) -> None:
        freeze_arrays(self, joint_position=(7,), joint_velocity=(7,), tcp_twist=(6,))


class Device(Protocol):
    """A connection: entering opens it, leaving closes it."""

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object, /) -> None: ...


@runtime_checkable
class WrenchSensor(Device, Protocol):
    """A six-axis wrench sensor that streams. Entering opens it and starts the stream; leaving stops it and closes."""

    @property
    def identity(self) -> SensorIdentity:
        """Name and abilities; serial and firmware are "unknown" before it is entered."""
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


@runtime_checkable
class Arm(Device, Protocol):
    """A seven-joint arm. Entering connects and moves nothing; leaving stops it and disconnects."""

    @property
    def identity(self) -> ArmIdentity:
        """Model, serial number and firmware; "unknown" before it is entered."""
        ...

    @property
    def limits(self) -> ArmLimits:
        """Limits of the arm; known before connecting."""
        ...

    def state(self) -> ArmState:
        """The newest feedback.

        Raises:
            ArmLostError: no connection, or no fresh feedback.
        """
        ...

    def move_to(self, pose: Pose, speed: float) -> None:
        """Move the TCP to a pose at no more than `speed` [m/s]; returns on arrival or after `stop`.

        Watchdog: another thread must poll `state` meanwhile, or the arm stops.

        Raises:
            ArmRefusedError: in a fault, or the pose was refused or not reached.
            ArmLostError: the connection was lost on the way.
        """
        ...

    def twist(self, linear: Float[np.ndarray, "3"], angular: Float[np.ndarray, "3"]) -> None:
        """Move the TCP at a velocity [m/s, rad/s], base axes, until the next command; returns at once.

        The arm stops by itself after a while without a further twist; its driver sees to that.

        Raises:
            ArmRefusedError: in a fault, or beyond its limits.
            ArmLostError: no connection.
        """
        ...

    def stop(self) -> None:
        """Stop all motion. From any thread, any number of times, also at rest or without a connection.

        Earlier twists and poses no longer count, also those still on their way.
        """
        ...


@runtime_checkable
class Gripper(Protocol):
    """A parallel gripper."""

    @staticmethod
    def data_sheet(width: float) -> Tool:
        """Mass, inertia and TCP with the pads `width` [m] apart, sensor frame; known before connecting."""
        ...

    def width(self) -> float:
        """Opening between the pads [m]."""
        ...

    def close_on(self, width: float, force: float) -> None:
        """Close on something `width` [m] wide with `force` [N]; returns when it holds.

        Raises:
            ArmRefusedError: closed on nothing or something else, not closed, or refused.
        """
        ...

    def open(self, width: float | None) -> None:
        """Open until the pads are `width` [m] apart, None as far as they go; returns when they stand.

        Raises:
            ArmRefusedError: not opened so far, or refused.
        """
        ...


@runtime_checkable
class ObjectPose(Protocol):
    """Source of the object's pose: a known place, or a tracker."""

    def read(self) -> tuple[float, float, float]:
        """Planar pose of the object frame in the arm's base frame: x, y [m] and yaw [rad].

        Raises:
            RobotError: not known now.
        """
        ...
