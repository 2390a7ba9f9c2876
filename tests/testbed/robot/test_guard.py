"""The guard on the computer's own clock: it stops the arm whatever the control loop or a driver is doing."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from test_safety import GEN3, snapshot

from testbed.robot.guard import Guard
from testbed.robot.interfaces import (
    ArmState,
    Clock,
    MonotonicClock,
    RobotError,
    SensorHealth,
    SensorIdentity,
    WrenchSample,
)
from testbed.robot.safety import SafetyLimits, UnsafeError

LIMITS = SafetyLimits()
SLOW = np.array([0.01, 0.0, 0.0])


class Stub:
    """Arm and sensor at once: all is well until a test changes them."""

    limits = GEN3
    identity = SensorIdentity("stub", "1", "1", 100.0, 300.0, 30.0)

    def __init__(self) -> None:
        self.stops: list[float] = []
        self.twists = 0
        self.load = np.zeros(6)
        self.hang: Callable[[], object] = lambda: None
        self.broken: Exception | None = None

    def state(self) -> ArmState:
        if self.broken is not None:
            raise self.broken
        state = snapshot().state
        return ArmState(time.monotonic(), state.joint_position, state.joint_velocity, state.tcp_pose, state.tcp_twist)

    def drain(self) -> list[WrenchSample]:
        return [WrenchSample(time.monotonic(), self.load, 0)]

    latest = drain

    def health(self) -> SensorHealth:
        return SensorHealth(0, 0, 0, 0, 0, 0.0)

    def twist(self, linear: np.ndarray, angular: np.ndarray) -> None:
        self.twists += 1
        self.hang()

    def stop(self) -> None:
        self.stops.append(time.monotonic())


def guard_of(stub: Stub, clock: Clock | None = None) -> Guard:
    return Guard(stub, stub, LIMITS, clock or MonotonicClock())  # pyright: ignore[reportArgumentType]


def until(true: Callable[[], object], seconds: float = 5.0) -> bool:
    end = time.monotonic() + seconds
    while not true() and time.monotonic() < end:
        time.sleep(0.01)
    return bool(true())


def test_nothing_is_stopped_where_all_is_well():
    stub = Stub()
    with guard_of(stub) as guard:
        for _ in range(5):
            guard.twist(SLOW, np.zeros(3))
            time.sleep(0.02)
        assert not stub.stops
        assert guard.state().time_s <= time.monotonic()
    assert stub.stops, "leaving it stops the arm"


def test_a_twist_that_hangs_is_stopped_from_the_guards_own_thread():
    stub, freed = Stub(), threading.Event()
    stub.hang = lambda: freed.wait(10.0)
    with guard_of(stub) as guard:
        raised: list[UnsafeError] = []

        def twist() -> None:
            try:
                guard.twist(SLOW, np.zeros(3))
            except UnsafeError as error:
                raised.append(error)

        loop = threading.Thread(target=twist)
        loop.start()
        assert until(lambda: stub.stops)
        assert guard.trouble is not None and "silence of the control loop" in str(guard.trouble)
        freed.set()
        loop.join()
        assert raised
        with pytest.raises(UnsafeError):
            guard.twist(SLOW, np.zeros(3))
        assert stub.twists == 1


def test_a_loop_that_does_something_else_is_stopped_too():
    stub = Stub()
    with guard_of(stub) as guard:
        guard.twist(SLOW, np.zeros(3))
        assert until(lambda: stub.stops)
        with pytest.raises(UnsafeError, match="silence of the control loop"):
            guard.check()


def test_a_loop_that_stands_still_may_take_its_time():
    stub = Stub()
    with guard_of(stub) as guard:
        guard.twist(SLOW, np.zeros(3))
        guard.twist(np.zeros(3), np.zeros(3))
        time.sleep(0.3)
        guard.check()


@pytest.mark.parametrize("what", ["load", "refusal", "mistake"])
def test_trouble_stops_the_arm_and_stays(what):
    stub = Stub()
    with guard_of(stub) as guard:
        guard.rest(np.zeros(6))
        if what == "load":
            stub.load = np.array([100.0, 0, 0, 0, 0, 0])
        else:
            stub.broken = RobotError("gone") if what == "refusal" else KeyError("a driver's")
        assert until(lambda: stub.stops)
        stub.load, stub.broken = np.zeros(6), None
        with pytest.raises(RobotError, match={"load": "force: 100 N", "refusal": "gone", "mistake": "KeyError"}[what]):
            guard.twist(SLOW, np.zeros(3))
    assert stub.twists == 0


def test_a_load_counts_from_what_it_was_at_rest():
    stub = Stub()
    stub.load = np.array([100.0, 0, 0, 0, 0, 0])
    with guard_of(stub) as guard:
        guard.rest(stub.load)
        guard.twist(SLOW, np.zeros(3))


def test_a_twist_beyond_a_limit_is_not_sent():
    stub = Stub()
    with (
        guard_of(stub) as guard,
        pytest.raises(UnsafeError, match=r"commanded speed: 0\.2 m/s; allowed: at most 0\.15"),
    ):
        guard.twist(20 * SLOW, np.zeros(3))
    assert stub.twists == 0


def test_a_guard_that_cannot_look_lets_nothing_move():
    class Deaf(MonotonicClock):
        def every(self, period: float, call: Callable[[], None]):
            return super().every(period, lambda: call() if heard else None)

    stub, heard = Stub(), [True]
    with guard_of(stub, Deaf()) as guard:
        heard.clear()
        time.sleep(0.2)
        with pytest.raises(UnsafeError, match="age of the guard's last look"):
            guard.twist(SLOW, np.zeros(3))
    assert stub.twists == 0


def test_a_silent_robot_is_told():
    stub = Stub()
    stub.drain = lambda: []
    with pytest.raises(RobotError, match="the robot is silent"):
        guard_of(stub).__enter__()
    assert stub.stops
