"""Interfaces of the real robot: arm, gripper, wrench sensor, object pose, clock; their data types and errors."""

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
    """Failure or refusal of the real robot; the message states a remedy."""


class MissingDriverError(RobotError, ImportError):
    """A driver package that is not installed."""

    def __init__(self, package: str):
        super().__init__(f"{package}: not installed; pip install 'heft-testbed[robot]'")


class SensorLostError(RobotError):
    """The wrench sensor is disconnected or silent, or its data cannot be read."""


class ArmLostError(RobotError):
    """No connection to the arm, or its feedback is stale."""


class ArmRefusedError(RobotError):
    """The arm is in a fault, or refused a command."""


@runtime_checkable
class Clock(Protocol):
    """Source of time: the computer's clock, or the faster one of a simulated robot."""

    def now(self) -> float:
        """Time since an arbitrary epoch [s], on which every `time_s` of the interfaces is based."""
        ...

    def sleep(self, seconds: float) -> None:
        """Wait; return at once for `seconds` <= 0."""
        ...

    def every(self, period: float, call: Callable[[], None]) -> AbstractContextManager[None]:
        """Call `call` every `period` s while entered, even if the caller hangs."""
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
        """Call from a daemon thread; a late call is made at once, missed ones are skipped."""
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
        """Rotation from the axes of the frame to those of the base."""
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
    """Name and characteristics of a sensor."""

    name: str
    """Maker and model."""
    serial: str
    """Serial number, or "unknown"."""
    firmware: str
    """Version of its firmware, or "unknown"."""
    rate_hz: float
    """Frame rate [Hz]."""
    force_range: float = math.inf
    """Largest measurable force along an axis [N]."""
    torque_range: float = math.inf
    """Largest measurable torque about an axis [N m]."""
    repeats: tuple[int, ...] = (20,) * 6
    """Largest number of equal values in a row of each component that its noise permits."""
    noise: tuple[float, ...] | None = None
    """Standard deviation of each component at rest, per frame [N, N m]; 0 disables the check on it, None estimates it
    from the first 50 frames."""


@dataclass(frozen=True)
class ArmIdentity:
    """Model and versions of an arm, "unknown" if it does not report them."""

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
    """Frames with a wrong checksum."""
    resyncs: int
    """Number of times that bytes were skipped to find the next frame."""
    lost_frames: int
    """Frames that were due by the sensor's rate and did not arrive: damaged or missing."""
    dropouts: int
    """Gaps of several frames after which the stream resumed."""
    age_s: float
    """Time since the latest whole frame [s]; infinite before the first."""
    warnings: tuple[str, ...] = ()
    """Defects of the connection that do not prevent a trial, a sentence each."""


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
    """A device as a context manager: entering connects, leaving disconnects."""

    def __enter__(self) -> Self: ...

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object, /) -> None: ...


@runtime_checkable
class WrenchSensor(Device, Protocol):
    """A six-axis wrench sensor that streams. Entering opens it and starts the stream; leaving stops it and closes."""

    @property
    def identity(self) -> SensorIdentity:
        """Name and characteristics; serial and firmware are "unknown" before it is entered."""
        ...

    def drain(self) -> Sequence[WrenchSample]:
        """Every frame since the last drain, in order, none dropped.

        Raises:
            SensorLostError: unplugged, or silent for too long, once all earlier frames have been drained.
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

        Watchdog: unless another thread polls `state` meanwhile, the arm stops.

        Raises:
            ArmRefusedError: in a fault, or the pose was refused or not reached.
            ArmLostError: the connection was lost on the way.
        """
        ...

    def twist(self, linear: Float[np.ndarray, "3"], angular: Float[np.ndarray, "3"]) -> None:
        """Move the TCP at a velocity [m/s, rad/s], base axes, until the next command; returns at once.

        Watchdog: the driver stops the arm after a time without a further twist.

        Raises:
            ArmRefusedError: in a fault, or beyond its limits.
            ArmLostError: no connection.
        """
        ...

    def stop(self) -> None:
        """Stop all motion. Callable from any thread and repeatedly, also at rest or without a connection.

        Earlier twists and poses are discarded, including those in transit.
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
        """Close on an object `width` [m] wide with `force` [N]; returns when it is held.

        Raises:
            ArmRefusedError: another width than expected after closing, or refused.
        """
        ...

    def open(self, width: float | None) -> None:
        """Open until the pads are `width` [m] apart, None for the full stroke; returns when they are at rest.

        Raises:
            ArmRefusedError: another width than expected after opening, or refused.
        """
        ...


@runtime_checkable
class ObjectPose(Protocol):
    """Source of the object's pose: a known pose, or a tracker."""

    def read(self) -> tuple[float, float, float]:
        """Planar pose of the object frame in the arm's base frame: x, y [m] and yaw [rad].

        Raises:
            RobotError: the pose is unknown.
        """
        ...
