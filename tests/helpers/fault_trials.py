"""Everything that may go wrong on the real bench, put into a trial on the fake one, and what came of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from testbed.actions.base import Rotate
from testbed.errors import HeftError
from testbed.objects.blocks import block_object, parse_layout
from testbed.objects.model import ObjectModel
from testbed.robot.config import RobotSettings
from testbed.robot.execution import Execution
from testbed.robot.path import starting_pose
from testbed.robot.runner import RealRunner
from testbed.sensing.presets import preset
from testbed.sensing.windows import steady_windows
from testbed.simulation.settings import GripSettings, SimulationSettings
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.fakes.bench import FakeBench
from tests.fakes.gen3_world import Gen3World, world_settings

ACTION = Rotate(0, speed=0.3, duration=1.6, pivot=(0.0, 0.01))
BOUND = 0.150
"""Time after which nothing may drive the arm any more, s."""
WRONG = np.array([0.25, 0.25, np.inf, np.inf, np.inf, 0.02])
"""Difference from an undisturbed trial's wrench that makes a record wrong, N and N m: ten times its noise."""
LOST_PLACE = 0.003
"""Distance of the object from where the hand believes it to be that makes a record wrong, m."""


def small_object() -> ObjectModel:
    """Two blocks: as little physics as shows everything."""
    cells = parse_layout(["11"])
    return block_object(
        "two", cells, size=0.05, height=0.03, mass=[0.4, 0.3], friction=[0.5], friction_group=[0, 0], grid=2
    )


class Placed:
    """An `ObjectPose`: where a person has put the object."""

    def __init__(self, pose: np.ndarray):
        self._pose = tuple(float(v) for v in pose)

    def read(self) -> tuple[float, float, float]:
        """x, y, m, and yaw, rad."""
        x, y, yaw = self._pose
        return x, y, yaw


def bench_for(
    trial: Trial,
    watch: Callable[[FakeBench], None] = lambda _: None,
    *,
    seed: int = 0,
    change: Callable[[RobotSettings], RobotSettings] = lambda settings: settings,
    **of_runner: Any,
) -> tuple[FakeBench, RealRunner]:
    """A fake bench with the object in its place, and a runner for it; `of_runner` goes to the runner."""
    grip = SimulationSettings(grip=GripSettings(force=60.0))
    world = Gen3World(trial.object, trial.support, settings=grip, noise=preset("ft300s"), seed=seed)
    bench = FakeBench(world, watch, seed)
    pose = starting_pose(trial)
    grasp = getattr(trial.action, "grasp", 0)
    world.place(pose, grasp)
    settings = change(world_settings(world, grasp))
    options = {"confirm": lambda _: True, "tracker": bench.object_pose, "clock": bench.clock} | of_runner
    return bench, RealRunner(bench.arm, bench.gripper, bench.sensor, Placed(pose), settings, **options)


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong at some moment."""

    name: str
    strike: Callable[[FakeBench], None]
    """Does it."""
    blinds: bool = False
    """Whether the arm's feedback ends."""
    until: float = 0.95
    """Part of the trial in which it may strike."""


def _trouble(name: str, *, blinds: bool = False, until: float = 0.95, **changes: object) -> Fault:
    def strike(bench: FakeBench) -> None:
        for field, value in changes.items():
            setattr(bench.troubles, field, value)

    return Fault(name, strike, blinds, until)


def _hang_the_loop(bench: FakeBench) -> None:
    """The control loop is busy with something else for a second, the last twist still standing."""
    usual = Execution._correction
    hung = []

    def slow(self: Execution, *arguments):
        if not hung:
            hung.append(True)
            bench.clock.sleep(1.0)
        return usual(self, *arguments)

    bench.patches.append((Execution, "_correction", usual))
    Execution._correction = slow


def _weaken(bench: FakeBench) -> None:
    bench.world.strength = 0.03


def _move_the_object(bench: FakeBench) -> None:
    bench.world.shove(np.array([60.0, 60.0, 0.0]), 0.2)


def _short_silence(bench: FakeBench) -> None:
    bench.troubles.sensor_stalls = True
    bench.later(0.07, lambda: setattr(bench.troubles, "sensor_stalls", False))


def _long_silence(bench: FakeBench) -> None:
    bench.troubles.feedback_stalls = True
    bench.later(0.09, lambda: setattr(bench.troubles, "feedback_stalls", False))


FORCE, TORQUE = np.array([100.0, 0, 0, 0, 0, 0]), np.array([0, 0, 0, 0, 0, 20.0])
FAULTS = (
    _trouble("connection of the arm lost", blinds=True, arm_lost=True),
    _trouble("feedback of the arm stalls", blinds=True, feedback_stalls=True),
    Fault("feedback of the arm pauses for 90 ms", _long_silence),
    _trouble("feedback of the arm says it stands", feedback_lies=True),
    _trouble("arm goes into a fault", arm_faulted=True),
    _trouble("arm refuses twists", refuses_twists=True),
    _trouble("arm refuses poses", until=0.05, refuses_poses=True),
    _trouble("arm stops short of poses", until=0.08, misses_poses=True),
    _trouble("arm ignores twists", ignores_twists=True),
    _trouble("twists in the wrong unit", twist_scale=57.3),
    _trouble("twists in the wrong direction", twist_scale=-1.0),
    _trouble("twists 300 ms late", latency=0.3),
    _trouble("a twist hangs for 1 s", hang=1.0),
    _trouble("the arm's driver crashes", crash=ValueError("a mistake in a driver")),
    _trouble("Ctrl-C", crash=KeyboardInterrupt()),
    _trouble("SIGTERM", crash=SystemExit(143)),
    Fault("the control loop hangs for 1 s", _hang_the_loop),
    _trouble("the guard no longer looks", guard_dead=True),
    _trouble("sensor unplugged", sensor_lost=True),
    _trouble("sensor stalls", sensor_stalls=True),
    Fault("sensor pauses for 70 ms", _short_silence),
    _trouble("a fifth of the frames lost", drops=0.2),
    _trouble("sensor repeats one frame", frozen=True),
    _trouble("the tool hits something", load=FORCE),
    _trouble("the tool is twisted", load=TORQUE),
    _trouble("the sensor's zero jumps by 1 N", load=FORCE / 100),
    _trouble("the sensor's zero creeps by 0.1 N/s", drift=FORCE / 1000),
    _trouble("the gripper refuses", gripper_refuses=True),
    _trouble("the gripper lets go", lets_go=True),
    Fault("the grip weakens", _weaken),
    Fault("the object is pushed away", _move_the_object),
)


@dataclass(frozen=True)
class Outcome:
    """What came of one fault."""

    fault: str
    seed: int
    struck: float
    """When, s."""
    ended: str
    """Status of the trajectory, or the error's name."""
    reason: str
    after_stop: float
    """How long the arm was still driven after it had been told to stop, s."""
    after_loss: float
    """How long it was still driven after the last feedback, where that was lost, s."""
    rolled: float
    """How long the tool still moved after it had been told to stop: the fake arm's way of slowing down, s."""
    wrong: str
    """Why a trajectory that is marked ok is not, else empty."""


@lru_cache(maxsize=1)
def undisturbed() -> tuple[Trajectory, float]:
    """The trial without any fault, and how long it took, s."""
    bench, runner = bench_for(Trial(small_object(), ACTION), seed=99)
    with runner:
        trajectory = runner.run(Trial(small_object(), ACTION))
    assert trajectory.ok, trajectory.reason
    return trajectory, bench.clock.now()


def struck_by(fault: Fault, seed: int) -> Outcome:
    """Run the trial with one fault at a random moment of it."""
    _, duration = undisturbed()
    at = float(np.random.default_rng([seed, 5]).uniform(0.0, fault.until) * duration)
    done: list[float] = []

    def watch(bench: FakeBench) -> None:
        if not done and bench.clock.now() >= at:
            done.append(bench.clock.now())
            fault.strike(bench)

    trial = Trial(small_object(), ACTION)
    bench, runner = bench_for(trial, watch, seed=seed)
    trajectory, ended, reason = None, "", ""
    try:
        with runner:
            trajectory = runner.run(trial)
        ended, reason = trajectory.status, trajectory.reason
    except (HeftError, KeyboardInterrupt, SystemExit, ValueError) as error:
        ended, reason = type(error).__name__, str(error)
    finally:
        for where, name, usual in bench.patches:
            setattr(where, name, usual)
    bench.clock.sleep(1.0)  # nothing may move of itself afterwards
    first = min(bench.arm.stopped)
    return Outcome(
        fault.name,
        seed,
        done[0] if done else float("nan"),
        ended,
        reason,
        bench.driven_after(first),
        bench.driven_after(done[0]) if fault.blinds and done else 0.0,
        bench.moved_after(first),
        "" if trajectory is None or not trajectory.ok else wrongness(trajectory, bench),
    )


def wrongness(trajectory: Trajectory, bench: FakeBench) -> str:
    """Why a trajectory is no data, judged by what only the fake bench knows; empty where it is."""
    expected = steady_windows(undisturbed()[0])
    for window, usual in zip(steady_windows(trajectory), expected, strict=True):
        off = np.abs(window.wrench - usual.wrench)
        if (off > WRONG).any():
            return f"wrench off by {off.round(3).tolist()}"
    if (slid := bench.slid) > LOST_PLACE:
        return f"the object slid {slid * 1e3:.1f} mm in the grip"
    return ""
