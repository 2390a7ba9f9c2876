"""The guard on the computer's own clock: it stops the arm whatever the control loop or a driver is doing."""

import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from test_safety import snapshot

from testbed.robot.guard import Guard
from testbed.robot.interfaces import ArmState, Clock, MonotonicClock, RobotError, SensorIdentity, WrenchSample
from testbed.robot.kinova.arm import GEN3
from testbed.robot.safety import SafetyLimits, UnsafeError
from tests.helpers.waiting import until

SLOW, STAND = np.array([0.01, 0.0, 0.0]), np.zeros(3)
PUSH = np.array([100.0, 0, 0, 0, 0, 0])
STUCK = np.array([0.01, 0.01, 0.01, 0.01, 0.0, 0.01])


class Stub:
    """Arm and sensor at once: all is well until a test changes them."""

    limits = GEN3
    identity = SensorIdentity("stub", "1", "1", 100.0, 300.0, 30.0)

    def __init__(self) -> None:
        self.stops = self.twists = 0
        self.load, self.noise = np.zeros(6), np.full(6, 0.01)
        self._rng = np.random.default_rng(0)
        self.silent = False
        self.hang: Callable[[], object] = lambda: None
        self.broken: Exception | None = None

    def state(self) -> ArmState:
        if self.broken is not None:
            raise self.broken
        state = snapshot().state
        return ArmState(time.monotonic(), state.joint_position, state.joint_velocity, state.tcp_pose, state.tcp_twist)

    def drain(self) -> list[WrenchSample]:
        if self.silent:
            return []
        wrench = self.load + self.noise * self._rng.standard_normal(6)
        return [WrenchSample(time.monotonic(), wrench, 0)]

    def twist(self, linear: np.ndarray, angular: np.ndarray) -> None:
        self.twists += 1
        self.hang()

    def stop(self) -> None:
        self.stops += 1


def guard_of(stub: Stub, clock: Clock | None = None) -> Guard:
    return Guard(stub, stub, SafetyLimits(), clock or MonotonicClock())  # pyright: ignore[reportArgumentType]


def test_nothing_is_stopped_if_all_is_well():
    """Nor while the arm stands; a load counts from the tare."""
    stub = Stub()
    stub.load = PUSH
    with guard_of(stub) as guard:
        guard.rest(PUSH)
        for _ in range(5):
            guard.twist(SLOW, STAND)
            time.sleep(0.02)
        guard.twist(STAND, STAND)
        time.sleep(0.3)
        assert guard.state().time_s <= time.monotonic()
        assert not stub.stops
    assert stub.stops, "leaving it stops the arm"


def test_a_twist_that_hangs_is_stopped_from_the_guards_own_thread():
    stub, freed = Stub(), threading.Event()
    stub.hang = lambda: freed.wait(10.0)
    with guard_of(stub) as guard:
        raised: list[UnsafeError] = []

        def twist() -> None:
            try:
                guard.twist(SLOW, STAND)
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
            guard.twist(SLOW, STAND)
        assert stub.twists == 1


def silence_the_loop(stub: Stub, guard: Guard) -> None:
    guard.twist(SLOW, STAND)


@pytest.mark.parametrize(
    ("strike", "twists", "reason"),
    [
        (silence_the_loop, 1, "silence of the control loop"),
        (lambda stub, _: setattr(stub, "load", PUSH), 0, "force: 100 N"),
        (lambda stub, _: setattr(stub, "load", 4 * PUSH), 0, "raw force: 400 N; allowed: at most 300 N"),
        (lambda stub, _: setattr(stub, "load", np.nan * PUSH), 0, "values of the wrench that are no number: 6"),
        (lambda stub, _: setattr(stub, "noise", np.zeros(6)), 0, "equal frames in a row: 5; allowed: at most 4"),
        (lambda stub, _: setattr(stub, "noise", STUCK), 0, "equal values of ty in a row: 21; allowed: at most 20"),
        (lambda stub, _: setattr(stub, "broken", RobotError("gone")), 0, "gone"),
        (lambda stub, _: setattr(stub, "broken", KeyError("a driver's")), 0, "KeyError"),
    ],
    ids=["silence", "load", "range", "NaN", "frozen", "stuck", "refusal", "mistake"],
)
def test_trouble_stops_the_arm_and_stays(strike, twists, reason):
    """Before any tare."""
    stub = Stub()
    with guard_of(stub) as guard:
        strike(stub, guard)
        assert until(lambda: stub.stops)
        stub.load, stub.noise, stub.broken = np.zeros(6), np.full(6, 0.01), None
        with pytest.raises(RobotError, match=reason):
            guard.twist(SLOW, STAND)
    assert stub.twists == twists


def test_a_twist_beyond_a_limit_is_not_sent():
    stub = Stub()
    with guard_of(stub) as guard, pytest.raises(UnsafeError, match=r"commanded speed: 0\.2 m/s"):
        guard.twist(20 * SLOW, STAND)
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
            guard.twist(SLOW, STAND)
    assert stub.twists == 0


@pytest.mark.slow
def test_a_silent_robot_is_not_guarded():
    stub = Stub()
    stub.silent = True
    with pytest.raises(RobotError, match="the robot is silent"):
        guard_of(stub).__enter__()
    assert stub.stops
