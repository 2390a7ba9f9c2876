"""Robot behind its interfaces, in one process and in simulated time, which does not depend on the machine's load."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import Rotation

from testbed import Rotate, Trajectory, Trial, preset
from testbed.objects.model import STROKE, ObjectModel
from testbed.robot.camera.interface import CameraLostError, SeenFrame
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import (
    ArmIdentity,
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
from testbed.robot.kinova.gripper import data_sheet
from testbed.robot.path import KnownPose, opening, starting_pose
from testbed.robot.raw_record import RawRecord
from testbed.robot.robotiq.ft300s import NOISE, REPEATS
from testbed.robot.runner import RealRunner
from testbed.sensing.camera import CAMERAS
from testbed.simulation.settings import GripSettings, SimulationSettings
from tests.fakes.world import TICK, Gen3World
from tests.helpers.blocks import blocks

WATCHDOG, SILENCE = 0.05, 0.1
"""Times without a command, and without a connection or a frame, that stop the arm or lose the sensor [s]."""
COUNTS = np.array([100.0, 100.0, 100.0, 1000.0, 1000.0, 1000.0])
"""Counts per newton and per newton meter, shape (6,)."""


@dataclass
class Troubles:
    """Faults from now on; tests change them while a trial runs."""

    arm_lost: bool = False
    """No command reaches the arm, no feedback comes."""
    feedback_stalls: bool = False
    feedback_lies: bool = False
    """Feedback is fresh, and the arm stands still in it."""
    arm_faulted: bool = False
    refuses_twists: bool = False
    refuses_poses: bool = False
    misses_poses: bool = False
    """Poses are reported as reached, and are not."""
    ignores_twists: bool = False
    twist_scale: float = 1.0
    """Ratio of the executed to the commanded twist: degrees for radians, or other axes (-1)."""
    latency: float = 0.0
    """Time that a twist takes to the arm [s]."""
    hang: float = 0.0
    """Time for which the next twist hangs on its way [s]."""
    crash: BaseException | None = None
    """Error of the next twist."""
    sensor_lost: bool = False
    sensor_stalls: bool = False
    drops: float = 0.0
    """Fraction of lost frames."""
    frozen: bool = False
    """Repeats one frame."""
    stuck: int | None = None
    """Component that repeats its value."""
    dead: Callable[[int, np.ndarray], np.ndarray] | None = None
    """Wrench of a dead sensor, by the number of the frame since then and the last good frames (n, 6); NaN if alive."""
    camera_lost: bool = False
    camera_blind: bool = False
    """It streams nothing."""
    disk_full: bool = False
    load: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """Extra load [N, N m]."""
    drift: np.ndarray = field(default_factory=lambda: np.zeros(6))
    """Drift of the sensor's zero [N/s, N m/s]."""
    gripper_refuses: bool = False
    lets_go: bool = False
    guard_dead: bool = False
    """Periodic calls are not made."""


class SimulatedClock:
    """Clock whose time passes in `sleep`: there the world ticks, and periodic calls are made."""

    def __init__(self, world: Gen3World, on_tick: Callable[[], None]):
        self._world, self._on_tick = world, on_tick
        self._now, self._next_tick = 0.0, TICK
        self._calls: list[list] = []
        self.alive = True
        """True if calls are made."""
        self.hang = 0.0
        """Time for which the next sleep takes longer [s]: the control loop hangs."""

    def now(self) -> float:
        return self._now

    def sleep(self, seconds: float) -> None:
        until, self.hang = self._now + seconds + self.hang, 0.0
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
        entry = [self._now, period, call]
        self._calls.append(entry)
        try:
            yield
        finally:
            self._calls.remove(entry)


class FakeRobot:
    """World, clock, arm, gripper and sensor; `watch` is called at every tick."""

    def __init__(self, world: Gen3World, watch: Callable[[FakeRobot], None] = lambda _: None, seed: int = 0):
        self.world, self.troubles, self.watch = world, Troubles(), watch
        self.clock = SimulatedClock(world, self._tick)
        self.arm, self.gripper, self.sensor = FakeArm(self), FakeGripper(self), FakeSensor(self, seed)
        self.raw: list[RawRecord] = []
        """Raw records of its trials."""
        self.motion: list[tuple[float, float, bool]] = []
        """Time [s], speed of the tool, and True if the arm was driven, at every tick."""
        self.slid = 0.0
        """Movement of the object in the closed grip [m]."""
        self._held: list[np.ndarray] = []
        self._to_come: list[tuple[float, Callable[[], None]]] = []
        self.tracker, self.camera = Tracker(self, seed), FakeCamera(self, seed)

    def later(self, seconds: float, call: Callable[[], None]) -> None:
        """Call once, after some time."""
        self._to_come.append((self.clock.now() + seconds, call))

    def driven_after(self, time: float) -> float:
        """Time for which the arm was driven after a moment [s]."""
        return max((at - time for at, _, driven in self.motion if at > time and driven), default=0.0)

    def moved_after(self, time: float) -> float:
        """Time for which the tool moved after a moment [s]: driven, or slowing down."""
        return max((at - time for at, speed, _ in self.motion if at > time and speed > 0.002), default=0.0)

    def way_after(self, time: float) -> float:
        """Way of the tool after a moment [m], a radian counted as 0.1 m."""
        return sum(speed * TICK for at, speed, _ in self.motion if at > time)

    def _tick(self) -> None:
        self.watch(self)
        if self.troubles.disk_full and self.raw:
            self.raw[-1]._file = Path("/dev/full").open("w", encoding="utf-8")
        for entry in [entry for entry in self._to_come if entry[0] <= self.clock.now()]:
            self._to_come.remove(entry)
            entry[1]()
        self.clock.alive = not self.troubles.guard_dead
        self.arm.tick()
        self.sensor.tick()
        self.camera.tick()
        self.motion.append((self.clock.now(), self.world.speed, self.world.driven))
        if self.world.grip < 1:
            self._held.clear()
            return
        self._held.append(self.world.object_in_hand)
        if len(self._held) > 150:  # closed, and settled
            self.slid = max(self.slid, float(np.linalg.norm(self._held[-1] - self._held[150])))


class Entered:
    """A device that needs nothing to be entered or left."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass


class FakeArm(Entered):
    """An `Arm` on the world."""

    def __init__(self, robot: FakeRobot):
        self.robot = robot
        self._pending: list[tuple[float, int, np.ndarray]] = []
        self._stops = 0
        self._last_twist = self._in_touch = self._watched = 0.0
        self._heard = robot.world.reading
        self._lie: ArmState | None = None
        self.stopped: list[float] = []
        """Times of `stop` [s]."""

    identity = ArmIdentity("fake", "1", "1")
    limits: ArmLimits = GEN3

    def __exit__(self, *_: object) -> None:
        self.stop()

    def tick(self) -> None:
        """Behavior of the arm between commands."""
        world, troubles, now = self.robot.world, self.robot.troubles, self.robot.clock.now()
        self._in_touch = self._in_touch if troubles.arm_lost else now
        heard = self._last_twist if world.goal is None else self._watched
        moving = world.twist.any() or world.goal is not None
        silent = (moving and now - heard > WATCHDOG) or now - self._in_touch > SILENCE
        if troubles.arm_faulted or silent:
            world.stop()
        for entry in [entry for entry in self._pending if entry[0] <= now]:
            self._pending.remove(entry)
            if entry[1] == self._stops and not (troubles.arm_lost or troubles.arm_faulted or troubles.ignores_twists):
                world.goal, world.twist = None, entry[2] * troubles.twist_scale
        if not (troubles.feedback_stalls or troubles.arm_lost):
            self._heard = world.reading

    def state(self) -> ArmState:
        robot, heard = self.robot, self._heard
        self._watched = robot.clock.now()
        if robot.clock.now() - heard.time_s > SILENCE:
            raise ArmLostError(f"arm: no feedback for {robot.clock.now() - heard.time_s:.3f} s")
        if robot.troubles.feedback_lies:
            self._lie = self._lie or replace(heard, joint_velocity=np.zeros(7), tcp_twist=np.zeros(6))
            return replace(self._lie, time_s=heard.time_s)
        faulted = robot.troubles.arm_faulted
        return replace(heard, faulted=faulted, message="joint fault" if faulted else "")

    def move_to(self, pose: Pose, speed: float) -> None:
        robot, troubles, stops = self.robot, self.robot.troubles, self._stops
        self._reachable()
        if troubles.refuses_poses:
            raise ArmRefusedError("arm: refused the pose: outside its workspace")
        self._watched = robot.clock.now()
        robot.world.goal = (pose.position, Rotation.from_quat(pose.orientation, scalar_first=True), speed)
        for _ in range(3000):
            robot.clock.sleep(TICK)
            self._reachable()
            if robot.clock.now() - self._watched > WATCHDOG:
                raise ArmLostError("arm: stopped: heft was silent for 50 ms while the arm moved")
            if robot.world.goal is None or (troubles.misses_poses and len(robot.motion) % 50 == 0):
                robot.world.stop()
                break
        off = np.linalg.norm(pose.position - robot.world.reading.tcp_pose.position)
        if self._stops == stops and off > 0.002:
            raise ArmRefusedError(f"arm: said to be there, and is {off * 1e3:.0f} mm off")

    def twist(self, linear: np.ndarray, angular: np.ndarray) -> None:
        robot, stops = self.robot, self._stops
        self._reachable()
        if robot.troubles.refuses_twists:
            raise ArmRefusedError("arm: refused the twist")
        if (crash := robot.troubles.crash) is not None:
            robot.troubles.crash = None
            raise crash
        if (hang := robot.troubles.hang) > 0:
            robot.troubles.hang = 0.0
            robot.clock.sleep(hang)
        self._last_twist = robot.clock.now()
        self._pending.append((robot.clock.now() + robot.troubles.latency, stops, np.concatenate([linear, angular])))

    def stop(self) -> None:
        self._stops += 1
        self.stopped.append(self.robot.clock.now())
        if not self.robot.troubles.arm_lost:
            self.robot.world.stop()

    def _reachable(self) -> None:
        if self.robot.troubles.arm_lost:
            raise ArmLostError("arm: connection lost")
        if self.robot.troubles.arm_faulted:
            raise ArmRefusedError("arm: in a fault")


class FakeGripper:
    """A `Gripper` on the world."""

    data_sheet = staticmethod(data_sheet)

    def __init__(self, robot: FakeRobot):
        self.robot = robot

    def width(self) -> float:
        return self.robot.world.width

    def close_on(self, width: float, force: float) -> None:
        if self.robot.troubles.gripper_refuses:
            raise ArmRefusedError("gripper: refused")
        self.robot.world.grip = 1.0
        self.robot.clock.sleep(1.0)
        if self.width() < width - 0.003:
            raise ArmRefusedError(f"gripper: closed to {self.width() * 1e3:.0f} mm: on nothing")

    def open(self, width: float | None) -> None:
        self.robot.world.open(STROKE if width is None else width)
        self.robot.clock.sleep(0.8)


class FakeSensor(Entered):
    """A `WrenchSensor` on the world."""

    identity = SensorIdentity("fake", "1", "1", 1 / TICK, 300.0, 30.0, REPEATS, NOISE)

    def __init__(self, robot: FakeRobot, seed: int = 0):
        self.robot, self._rng = robot, np.random.default_rng([seed, 7])
        self._samples: list[WrenchSample] = []
        self._latest: WrenchSample | None = None
        self._history: list[np.ndarray] = []
        self._dead_for = 0
        self._count = self._lost = 0

    def tick(self) -> None:
        troubles, now = self.robot.troubles, self.robot.clock.now()
        if troubles.lets_go:
            self.robot.world.grip = -0.05
        self.robot.world.bias = self.robot.world.bias + troubles.drift * TICK
        if troubles.sensor_lost or troubles.sensor_stalls:
            return
        if troubles.drops and self._rng.random() < troubles.drops:
            self._lost += 1
            return
        wrench = np.round((self.robot.world.wrench + troubles.load) * COUNTS) / COUNTS
        if troubles.frozen and self._latest is not None:
            wrench = self._latest.wrench
        if troubles.stuck is not None and self._latest is not None:
            wrench[troubles.stuck] = self._latest.wrench[troubles.stuck]
        if troubles.dead is None:
            self._history = [*self._history[-59:], wrench]
        else:
            said = troubles.dead(self._dead_for, np.array(self._history))
            wrench = np.where(np.isnan(said), wrench, said)
            self._dead_for += 1
        self._latest = WrenchSample(now, wrench, self._count)
        self._samples.append(self._latest)
        self._count += 1

    def drain(self) -> Sequence[WrenchSample]:
        samples, self._samples = self._samples, []
        if not samples:
            self._check()
        return samples

    def health(self) -> SensorHealth:
        return SensorHealth(self._count, 0, 0, self._lost, 0, 0.0)

    def _check(self) -> None:
        if self.robot.troubles.sensor_lost:
            raise SensorLostError("sensor: unplugged")
        if self._latest is not None and self.robot.clock.now() - self._latest.time_s > SILENCE:
            raise SensorLostError("sensor: no frame")


class FakeCamera(Entered):
    """An `ObjectCamera` on the world, with the errors of the preset `30hz`."""

    def __init__(self, robot: FakeRobot, seed: int = 0):
        self.robot, self._rng, self._errors = robot, np.random.default_rng([seed, 9]), CAMERAS["30hz"]
        self._late = self._rng.uniform(*self._errors.delay)
        self._frames: list[SeenFrame] = []
        self._due = 0.0
        self.off = np.zeros(3)
        """Shift of all poses [m, m, rad]: its place in the base is not as stated."""
        self.lies: Callable[[list[SeenFrame]], SeenFrame] | None = None
        """Frame that it sends in place of the last one, by all true frames so far."""
        self.lied_at = np.inf
        """Time of its first lie [s]."""
        self._true: list[SeenFrame] = []

    def tick(self) -> None:
        now, errors = self.robot.clock.now(), self._errors
        if now < self._due:
            return
        self._due += 1 / errors.rate
        if self.robot.troubles.camera_blind or self._rng.random() < errors.dropout:
            return
        true = self.robot.world.link_poses + self.off
        noise = np.array([errors.position, errors.position, errors.angle]) * self._rng.standard_normal(true.shape)
        self._true.append(SeenFrame(now + self._late, true + noise))
        self._frames.append(self._true[-1] if self.lies is None else self.lies(self._true))

    def drain(self) -> Sequence[SeenFrame]:
        if self.robot.troubles.camera_lost:
            raise CameraLostError("camera: unplugged")
        frames, self._frames = self._frames, []
        return frames


class Tracker:
    """An `ObjectPose` that sees the object, a tenth of a millimeter and of a degree off."""

    def __init__(self, robot: FakeRobot, seed: int = 0):
        self.robot, self._rng = robot, np.random.default_rng([seed, 8])

    def read(self) -> tuple[float, float, float]:
        x, y, yaw = self.robot.world.object_pose + self._rng.normal(0.0, [1e-4, 1e-4, 2e-3])
        return float(x), float(y), float(yaw)


ACTION = Rotate(0, speed=0.3, duration=1.6, pivot=(0.0, 0.01))


def small_object() -> ObjectModel:
    """Two blocks: the least physics that shows everything."""
    return blocks(["11"], [0.4, 0.3], grid=2, name="two")


def briefly(settings: RobotSettings) -> RobotSettings:
    """Settings with short waits, for trials that test the motion alone."""
    return replace(settings, tare_time=0.4, settle_time=0.6, hover=0.03, travel_speed=0.13)


def robot_for(
    trial: Trial,
    watch: Callable[[FakeRobot], None] = lambda _: None,
    *,
    seed: int = 0,
    change: Callable[[RobotSettings], RobotSettings] = lambda settings: settings,
    **of_runner: Any,
) -> tuple[FakeRobot, RealRunner]:
    """A fake robot with the object in its place, and a runner for it; `of_runner` goes to the runner."""
    grip = SimulationSettings(grip=GripSettings(force=60.0))
    world = Gen3World(trial.object, trial.support, settings=grip, noise=preset("ft300s"), seed=seed)
    robot, pose = FakeRobot(world, watch, seed), starting_pose(trial)
    world.place(pose, trial.action.fingertip(trial.object.shape) or trial.action.grasp or 0)
    settings = change(RobotSettings(data_sheet(opening(trial))))
    options = {"confirm": lambda _: True, "tracker": robot.tracker, "camera": robot.camera, "clock": robot.clock}
    devices = robot.arm, robot.gripper, robot.sensor
    return robot, RealRunner(*devices, KnownPose(*pose), settings, **options | of_runner)


def run_trial(
    trial: Trial, watch: Callable[[FakeRobot], None] = lambda _: None, **options: Any
) -> tuple[Trajectory, FakeRobot]:
    """The record of a trial on a fake robot of its own, made by `robot_for` with these options."""
    robot, runner = robot_for(trial, watch, **options)
    with runner:
        return runner.run(trial), robot
