"""A whole bench behind the ports, in one process and in simulated time: quick, and deaf to the machine's load."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from types import TracebackType
from typing import Self

import numpy as np
from scipy.spatial.transform import Rotation

from testbed.robot.interfaces import (
    ArmLimits,
    ArmLostError,
    ArmRefusedError,
    ArmState,
    Pose,
    SensorHealth,
    SensorIdentity,
    SensorLostError,
    WrenchSample,
)
from testbed.robot.kinova.arm import GEN3
from tests.fakes.gen3_world import TICK, Gen3World, Reading

SILENCE = 0.1
"""Time without a twist after which the arm stops by itself, and without a frame after which the sensor is lost, s."""
COUNTS = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Of the sensor in a newton and in a newton metre, (6,)."""


@dataclass
class Troubles:
    """What goes wrong from now on; tests change it while a trial runs."""

    arm_lost: bool = False
    """No command reaches the arm, no feedback comes."""
    feedback_stalls: bool = False
    """The newest feedback stays the newest."""
    feedback_lies: bool = False
    """Feedback is fresh and says that the arm stands where it stood."""
    arm_faulted: bool = False
    """The arm stops, and says that it is in a fault."""
    refuses_twists: bool = False
    refuses_poses: bool = False
    misses_poses: bool = False
    """Poses are said to be reached, and are not."""
    ignores_twists: bool = False
    """Twists are taken, and nothing happens."""
    twist_scale: float = 1.0
    """What is done over what was asked: degrees for radians, or a twist in other axes (-1)."""
    latency: float = 0.0
    """Time that a twist takes to the arm, s."""
    hang: float = 0.0
    """Time for which the next twist hangs on its way, s."""
    crash: BaseException | None = None
    """What the next twist raises."""
    sensor_lost: bool = False
    """Unplugged."""
    sensor_stalls: bool = False
    """No frame comes."""
    drops: float = 0.0
    """Part of the frames that are lost."""
    frozen: bool = False
    """The same frame again and again."""
    load: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """On top of what is felt, N and N m."""
    drift: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """Of the sensor's zero, a second, N and N m."""
    gripper_refuses: bool = False
    lets_go: bool = False
    """The fingers open."""
    guard_dead: bool = False
    """Whoever asked to be called is not."""


class SimulatedClock:
    """Time passes where somebody sleeps: the world ticks, and whoever asked to be called is called."""

    def __init__(self, world: Gen3World, on_tick: Callable[[], None]):
        self._world, self._on_tick = world, on_tick
        self._now, self._next_tick = 0.0, TICK
        self._calls: list[list] = []
        self.alive = True
        """Whether calls are made."""

    def now(self) -> float:
        """s."""
        return self._now

    def sleep(self, seconds: float) -> None:
        """Let time pass."""
        until = self._now + seconds
        while True:
            due = min([self._next_tick, *(call[0] for call in self._calls)])
            if due > until + 1e-9:
                break
            self._now = max(self._now, due)
            if self._next_tick <= due:
                self._next_tick += TICK
                self._world.tick()
                self._on_tick()
            for call in [call for call in self._calls if call[0] <= due]:
                call[0] = due + call[1]
                if self.alive:
                    call[2]()
        self._now = max(self._now, until)

    @contextmanager
    def every(self, period: float, call: Callable[[], None]) -> Iterator[None]:
        """While entered, `call` is called every `period` s."""
        entry = [self._now, period, call]
        self._calls.append(entry)
        try:
            yield
        finally:
            self._calls.remove(entry)


class FakeBench:
    """World, clock and ports that belong together; `watch` is called at every tick, for faults and for looking."""

    def __init__(self, world: Gen3World, watch: Callable[[FakeBench], None] = lambda _: None, seed: int = 0):
        self.world, self.troubles, self.watch = world, Troubles(), watch
        self.clock = SimulatedClock(world, self._tick)
        self.arm, self.gripper, self.sensor = FakeArm(self), FakeGripper(self), FakeSensor(self, seed)
        self.motion: list[tuple[float, float, bool]] = []
        """Time, s, speed of the tool, and whether the arm was driven, at every tick."""
        self.slid = 0.0
        """How far the object has moved in the closed grip, m."""
        self.patches: list[tuple[type, str, object]] = []
        """What was put in place of what, to be put back."""
        self._held: list[np.ndarray] = []
        self._to_come: list[tuple[float, Callable[[], None]]] = []
        self.object_pose = Where(self, seed)

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call once, when so much time has passed."""
        self._to_come.append((self.clock.now() + seconds, call))

    def driven_after(self, time: float) -> float:
        """How long the arm went on being driven after a moment, s."""
        return max((at - time for at, _, driven in self.motion if at > time and driven), default=0.0)

    def moved_after(self, time: float, still: float = 0.002) -> float:
        """How long the tool went on moving after a moment, s: driven, or slowing down."""
        return max((at - time for at, speed, _ in self.motion if at > time and speed > still), default=0.0)

    def _tick(self) -> None:
        self.watch(self)
        for entry in [entry for entry in self._to_come if entry[0] <= self.clock.now()]:
            self._to_come.remove(entry)
            entry[1]()
        self.clock.alive = not self.troubles.guard_dead
        self.arm.tick()
        self.sensor.tick()
        self.motion.append((self.clock.now(), self.world.speed, self.world.driven))
        if self.world.grip < 1:
            self._held.clear()
            return
        self._held.append(self.world.object_in_hand)
        if len(self._held) > 150:  # closed, and settled
            self.slid = max(self.slid, float(np.linalg.norm(self._held[-1] - self._held[150])))


class FakeArm:
    """An `Arm` on the world."""

    def __init__(self, bench: FakeBench):
        self._bench = bench
        self._pending: list[tuple[float, int, np.ndarray]] = []
        self._stops = 0
        self._last_twist = self._in_touch = 0.0
        self._heard: Reading = bench.world.reading
        self.stopped: list[float] = []
        """When it was told to stop, s."""

    limits: ArmLimits = GEN3

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def tick(self) -> None:
        """What arm and port do by themselves."""
        world, troubles, now = self._bench.world, self._bench.troubles, self._bench.clock.now()
        self._in_touch = self._in_touch if troubles.arm_lost else now
        silent = (world.twist.any() and now - self._last_twist > SILENCE) or now - self._in_touch > SILENCE
        if troubles.arm_faulted or silent:
            world.stop()
        for entry in [entry for entry in self._pending if entry[0] <= now]:
            self._pending.remove(entry)
            if entry[1] == self._stops and not (troubles.arm_lost or troubles.arm_faulted or troubles.ignores_twists):
                world.goal, world.twist = None, entry[2] * troubles.twist_scale
        if not (troubles.feedback_stalls or troubles.arm_lost):
            self._heard = world.reading

    def state(self) -> ArmState:
        """The newest feedback."""
        bench, heard = self._bench, self._heard
        if bench.clock.now() - heard.time_s > SILENCE:
            raise ArmLostError(f"arm: no feedback for {bench.clock.now() - heard.time_s:.3f} s")
        if bench.troubles.feedback_lies:
            self._lie = getattr(self, "_lie", heard)
            still = self._lie
            return ArmState(heard.time_s, still.q, np.zeros(7), Pose(still.position, still.orientation), np.zeros(6))
        faulted = bench.troubles.arm_faulted
        return ArmState(
            heard.time_s,
            heard.q,
            heard.qd,
            Pose(heard.position, heard.orientation),
            heard.twist,
            faulted,
            "joint fault" if faulted else "",
        )

    def move_to(self, pose: Pose, speed: float) -> None:
        """To a pose, at most so fast."""
        bench, troubles, stops = self._bench, self._bench.troubles, self._stops
        self._reachable()
        if troubles.refuses_poses:
            raise ArmRefusedError("arm: refused the pose: outside its workspace")
        bench.world.goal = (pose.position, Rotation.from_quat(pose.orientation, scalar_first=True), speed)
        for _ in range(3000):
            bench.clock.sleep(TICK)
            self._reachable()
            if bench.world.goal is None or (troubles.misses_poses and len(bench.motion) % 50 == 0):
                bench.world.stop()
                break
        off = np.linalg.norm(pose.position - bench.world.reading.position)
        if self._stops == stops and off > 0.002:
            raise ArmRefusedError(f"arm: said to be there, and is {off * 1e3:.0f} mm off")

    def twist(self, linear: np.ndarray, angular: np.ndarray) -> None:
        """Take a twist; a stop that comes while it is on its way ends it."""
        bench, stops = self._bench, self._stops
        self._reachable()
        if bench.troubles.refuses_twists:
            raise ArmRefusedError("arm: refused the twist")
        if (crash := bench.troubles.crash) is not None:
            bench.troubles.crash = None
            raise crash
        if (hang := bench.troubles.hang) > 0:
            bench.troubles.hang = 0.0
            bench.clock.sleep(hang)
        self._last_twist = bench.clock.now()
        self._pending.append((bench.clock.now() + bench.troubles.latency, stops, np.concatenate([linear, angular])))

    def stop(self) -> None:
        """No more motion."""
        self._stops += 1
        self.stopped.append(self._bench.clock.now())
        if not self._bench.troubles.arm_lost:
            self._bench.world.stop()

    def clear_faults(self) -> None:
        """Forget the fault."""
        self._bench.troubles.arm_faulted = False

    def _reachable(self) -> None:
        if self._bench.troubles.arm_lost:
            raise ArmLostError("arm: connection lost")
        if self._bench.troubles.arm_faulted:
            raise ArmRefusedError("arm: in a fault")


class FakeGripper:
    """A `Gripper` on the world."""

    def __init__(self, bench: FakeBench):
        self._bench = bench

    def width(self) -> float:
        """m."""
        return self._bench.world.width

    def close_on(self, width: float, force: float) -> None:
        """Close; the world's own force is used."""
        if self._bench.troubles.gripper_refuses:
            raise ArmRefusedError("gripper: refused")
        self._bench.world.grip = 1.0
        self._bench.clock.sleep(1.0)
        if self.width() < width - 0.003:
            raise ArmRefusedError(f"gripper: closed to {self.width() * 1e3:.0f} mm: on nothing")

    def open(self) -> None:
        """Open fully."""
        self._bench.world.grip = -0.05
        self._bench.clock.sleep(0.8)


class FakeSensor:
    """A `WrenchSensor` on the world."""

    identity = SensorIdentity("fake", "1", "1", 1 / TICK, 300.0, 30.0)

    def __init__(self, bench: FakeBench, seed: int = 0):
        self._bench, self._rng = bench, np.random.default_rng([seed, 7])
        self._samples: list[WrenchSample] = []
        self._latest: WrenchSample | None = None
        self._count = self._lost = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def tick(self) -> None:
        """A frame, if one comes."""
        troubles, now = self._bench.troubles, self._bench.clock.now()
        if troubles.lets_go:
            self._bench.world.grip = -0.05
        self._bench.world.bias = self._bench.world.bias + troubles.drift * TICK
        if troubles.sensor_lost or troubles.sensor_stalls:
            return
        if troubles.drops and self._rng.random() < troubles.drops:
            self._lost += 1
            return
        wrench = np.round((self._bench.world.wrench + troubles.load) * COUNTS) / COUNTS
        if troubles.frozen and self._latest is not None:
            wrench = self._latest.wrench
        self._latest = WrenchSample(now, wrench, self._count)
        self._samples.append(self._latest)
        self._count += 1

    def latest(self) -> WrenchSample | None:
        """The newest frame."""
        self._check()
        return self._latest

    def drain(self) -> Sequence[WrenchSample]:
        """Every frame since the last drain."""
        samples, self._samples = self._samples, []
        if not samples:
            self._check()
        return samples

    def health(self) -> SensorHealth:
        """Counts so far."""
        return SensorHealth(self._count, 0, 0, self._lost, 0, 0.0)

    def _check(self) -> None:
        if self._bench.troubles.sensor_lost:
            raise SensorLostError("sensor: unplugged")
        if self._latest is not None and self._bench.clock.now() - self._latest.time_s > SILENCE:
            raise SensorLostError("sensor: no frame")


class Where:
    """An `ObjectPose` that sees the object, a tenth of a millimetre and of a degree off."""

    def __init__(self, bench: FakeBench, seed: int = 0):
        self._bench, self._rng = bench, np.random.default_rng([seed, 8])

    def read(self) -> tuple[float, float, float]:
        """x, y, m, and yaw, rad."""
        x, y, yaw = self._bench.world.object_pose + self._rng.normal(0.0, [1e-4, 1e-4, 2e-3])
        return float(x), float(y), float(yaw)
