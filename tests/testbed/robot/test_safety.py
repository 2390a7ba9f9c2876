"""Limits of the real bench, each found alone, and the guard that stops the arm whatever a loop or a driver does."""

import math
import threading
import time
from collections.abc import Callable

import numpy as np
import pytest
from scipy.signal import lfilter

from testbed.robot.guard import Guard
from testbed.robot.interfaces import ArmState, Clock, MonotonicClock, Pose, RobotError, SensorIdentity, WrenchSample
from testbed.robot.kinova.arm import GEN3
from testbed.robot.robotiq.ft300s import NOISE, REPEATS
from testbed.robot.safety import FrameWatch, SafetyLimits, Snapshot, UnsafeError, path_violations, violations
from tests.helpers.waiting import until

COUNTS = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Counts per newton and newton meter."""
DOWN = (0.0, 1.0, 0.0, 0.0)
LIMITS = SafetyLimits()


def snapshot(**changes) -> Snapshot:
    """A moment at which all is well, but for the changes, of the state or of the snapshot."""
    state = {
        "time_s": 10.0,
        "joint_position": np.array([0.0, 0.6, 3.1, -1.8, 0.0, -0.7, 1.6]),
        "joint_velocity": np.zeros(7),
        "tcp_pose": Pose(np.array([0.45, 0.0, 0.1]), np.array(DOWN)),
        "tcp_twist": np.zeros(6),
    }
    rest = {"now": 10.01, "wrench_time": 10.0, "load": np.zeros(6), "command": np.zeros(6)}
    for name, value in changes.items():
        (state if name not in rest else rest)[name] = value
    return Snapshot(state=ArmState(**state), **rest)


def tilted(angle: float) -> Pose:
    return Pose(np.array([0.45, 0.0, 0.1]), np.array([0.0, math.cos(angle / 2), 0.0, math.sin(angle / 2)]))


def at(x: float, y: float, z: float) -> Pose:
    return Pose(np.array([x, y, z]), np.array(DOWN))


def test_a_safe_state_has_no_violation():
    assert list(violations(LIMITS, GEN3, snapshot())) == []


@pytest.mark.parametrize(
    ("changes", "said", "broken"),
    [
        ({"faulted": True, "message": "joint fault"}, r"arm in a fault \(joint fault\)", True),
        ({"time_s": 9.9}, r"age of the feedback of the arm: 0\.11 s; allowed: at most 0\.08 s", True),
        ({"wrench_time": 9.8}, r"age of the wrench: 0\.21 s; allowed: at most 0\.08 s", True),
        ({"load": np.array([0, 50.0, 40.0, 0, 0, 0])}, r"force: 64 N; allowed: at most 60 N", False),
        ({"load": np.array([0, 0, 0, 6.0, 6.0, 0])}, r"torque: 8\.49 N m; allowed: at most 8 N m", False),
        ({"command": np.array([0.16, 0, 0, 0, 0, 0])}, r"commanded speed: 0\.16 m/s", False),
        ({"command": np.array([0, 0, 0, 0, 0, -1.3])}, r"commanded turn rate: 1\.3 rad/s", False),
        ({"tcp_twist": np.array([0, 0.2, 0, 0, 0, 0])}, r"measured speed: 0\.2 m/s", False),
        ({"tcp_pose": at(0.24, 0.0, 0.1)}, r"x of the tool: 0\.24 m; allowed: at least 0\.25 m", False),
        ({"tcp_pose": at(0.45, 0.36, 0.1)}, r"y of the tool: 0\.36 m; allowed: at most 0\.35 m", False),
        ({"tcp_pose": at(0.45, 0.0, 0.01)}, r"z of the tool: 0\.01 m; allowed: at least 0\.015 m", False),
        ({"tcp_pose": tilted(0.1)}, r"tilt of the tool: 0\.1 rad; allowed: at most 0\.0873 rad", False),
        ({"joint_position": np.eye(7)[1] * 2.2}, r"joint 2: 2\.2 rad; allowed: at most 2\.19 rad", False),
        ({"joint_velocity": np.array([0, 0, 0, 0, 0, 0, -1.3])}, r"speed of joint 7: 1\.3 rad/s", False),
    ],
    ids=lambda v: v if isinstance(v, str) else None,
)
def test_each_limit_is_found_alone(changes, said, broken):
    found = list(violations(LIMITS, GEN3, snapshot(**changes)))
    assert len(found) == 1
    assert found[0].broken == broken
    with pytest.raises(UnsafeError, match=said):
        raise UnsafeError(found[0])


def test_what_is_no_number_passes_no_limit():
    nan = np.full(6, np.nan)
    assert {v.limit for v in violations(LIMITS, GEN3, snapshot(load=nan))} == {"force", "torque"}
    commanded = {"commanded speed", "commanded turn rate"}
    assert {v.limit for v in violations(LIMITS, GEN3, snapshot(command=nan))} == commanded
    assert any(v.broken for v in violations(LIMITS, GEN3, snapshot(wrench_time=np.nan)))


def test_a_path_is_judged_by_its_farthest_place_and_its_fastest_moment():
    positions = np.array([[0.4, 0.0, 0.1], [0.7, -0.4, 0.1], [0.4, 0.0, 0.1]])
    twists = np.array([[0, 0, 0, 0, 0, 0], [0.1, 0, 0, 0, 0, 1.3], [0.2, 0, 0, 0, 0, 0.0]])
    tilts = np.array([0.0, 0.1, 0.0])
    found = [str(v) for v in path_violations(LIMITS, positions, twists, tilts)]
    names = ("tilt of the tool: 0.1", "y of the tool", "x of the tool", "planned speed: 0.2", "planned turn rate: 1.3")
    for said, name in zip(found, names, strict=True):
        assert said.startswith(name)
    assert list(path_violations(LIMITS, positions[:1], twists[:1], tilts[:1])) == []


@pytest.mark.parametrize(
    ("stated", "frames"),
    [
        pytest.param(True, 2_500, id="briefly"),
        pytest.param(True, 25_000, id="noise stated", marks=pytest.mark.slow),
        pytest.param(False, 25_000, id="noise of its first frames", marks=pytest.mark.slow),
    ],
)
def test_a_healthy_sensor_is_no_dead_one(stated: bool, frames: int):
    """At rest, up to four minutes, with the noise and the counts of an FT-300S."""
    watch = FrameWatch(SensorIdentity("s", "1", "1", 100.0, 300.0, 30.0, REPEATS, NOISE if stated else None))
    assert not [found for frame in at_rest(frames) for found in watch.violations(frame)]


@pytest.mark.parametrize("pattern", [2, 3, 7, "random"])
@pytest.mark.parametrize("axes", [[0, 1, 2, 3, 4, 5], [0], [1], [2], [3], [4], [5]], ids=str)
def test_a_sensor_whose_last_counts_toggle_is_dead(axes, pattern):
    """All components or one: found within a second, or with a period of up to ten frames."""
    rng, frames = np.random.default_rng(4), at_rest(400)
    watch = FrameWatch(SensorIdentity("s", "1", "1", 100.0, 300.0, 30.0, REPEATS, NOISE))
    assert not [found for frame in frames[:200] for found in watch.violations(frame)]
    low = rng.integers(0, 2, (200, 6)) if pattern == "random" else rng.integers(0, 3, (pattern, 6))
    for number in range(120):
        frame = frames[200 + number].copy()
        frame[axes] = np.round(frames[199] * COUNTS + low[number % len(low)])[axes] / COUNTS[axes]
        if found := next(watch.violations(frame), None):
            assert found.broken
            return
    raise AssertionError("not found")


def at_rest(count: int) -> np.ndarray:
    """Wrenches of an FT-300S at rest, correlated from frame to frame and rounded to counts, (count, 6)."""
    white = np.random.default_rng(3).standard_normal((count, 6))
    colored = np.asarray(lfilter([math.sqrt(1 - 0.3**2)], [1.0, -0.3], white, axis=0))
    return np.round((colored * np.array(NOISE) + [3.3, -2.1, 9.2, 0.11, -0.21, 0.31]) * COUNTS) / COUNTS


SLOW, STAND = np.array([0.01, 0.0, 0.0]), np.zeros(3)
PUSH = np.array([100.0, 0, 0, 0, 0, 0])
STUCK = np.array([0.01, 0.01, 0.01, 0.01, 0.0, 0.01])


class Stub:
    """Arm and sensor in one, without faults until a test changes them."""

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


def test_a_safe_trial_is_not_stopped():
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


def test_a_guard_that_no_longer_checks_permits_no_motion():
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
