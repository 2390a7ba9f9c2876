"""A fake Gen3 and a fake FT-300S on one simulated robot, in a process of their own in real time; trials on them."""

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Self

import numpy as np

from testbed import ObjectModel, Rotate, Sensing, Trajectory, Trial, preset
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import RobotError
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.path import KnownPose, starting_pose
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.robot.runner import RealRunner
from testbed.worlds.setup_errors import EXACT_SETUP
from tests.fakes.ft300s import FakeFt300s
from tests.fakes.gen3 import FakeGen3
from tests.fakes.world import Gen3World

FT300S = preset("ft300s")
KORTEX = str(Path(__file__).parent / "kortex")
"""Folder of the fake `kortex_api`, for PYTHONPATH."""


@dataclass(frozen=True)
class Wires:
    """Ports for the drivers."""

    arm_port: int
    sensor_port: str


class FakeRig:
    """Runs while it is entered."""

    def __init__(self, obj: ObjectModel, *, noise: Sensing = FT300S):
        self._asked = obj, noise

    def __enter__(self) -> Self:
        context = get_context("spawn")
        self._ours, theirs = context.Pipe()
        self._process = context.Process(target=_live, args=(theirs, *self._asked), daemon=True)
        self._process.start()
        self.wires: Wires = self._ours.recv()
        return self

    def __exit__(self, *_: object) -> None:
        self._ours.close()
        self._process.join(5.0)
        self._process.kill()

    def place(self, pose: np.ndarray, grasp: int) -> None:
        """Put the object at a planar pose; only the faces of `grasp` can then be gripped."""
        self._ours.send((pose, grasp))
        self._ours.recv()


def _live(theirs: Connection, obj: ObjectModel, noise: Sensing) -> None:
    world = Gen3World(obj, noise=noise)
    with FakeGen3(world) as arm, FakeFt300s(lambda _: world.wrench) as sensor:
        theirs.send(Wires(arm.port, sensor.port))
        while True:
            try:
                pose, grasp = theirs.recv()
            except EOFError:
                return
            with arm.lock:
                world.place(pose, grasp)
            theirs.send(None)


QUIET = replace(
    FT300S,
    force_noise=tuple(n / 10 for n in FT300S.force_noise),
    torque_noise=tuple(n / 10 for n in FT300S.torque_noise),
)
"""An FT-300S with a tenth of its noise: then the path's own error shows. Without any noise its frames repeat, and it
counts as dead."""
ATTEMPTS = 5
"""Times that a trial is begun: a busy computer is silent, and ends it."""
LATE = 0.008
"""Largest 99th percentile of the lateness of commands, s. Masses of L2 were 0.5 % off at 5 ms (three other
processes on two cores) and 3 % at 11 ms (eight), in one run each; between them nothing was measured."""


class _QuietFt300s(Ft300s):
    """Sensor whose noise is below its counts of 0.01 N and 0.001 N m: its values repeat for long."""

    def __init__(self, port: str):
        super().__init__(port)
        self.identity = replace(self.identity, repeats=(10**6,) * 6, noise=(0.0,) * 6)


def over_wires(model: ObjectModel, actions: Sequence[Rotate]) -> list[Trajectory]:
    """Turns on a fake Gen3 with a quiet FT-300S, by the drivers themselves; those that are data and in time."""
    os.environ["PYTHONPATH"] = KORTEX  # the process that speaks Kortex finds the fake
    done = []
    with FakeRig(model, noise=QUIET) as rig:
        for action in actions:
            trial = Trial(model, action)
            pose = starting_pose(trial)
            arm = KortexArm("127.0.0.1", port=rig.wires.arm_port, watchdog=0.1)
            gripper = KortexGripper.data_sheet(model.shape.grasps[action.grasp].width)
            settings = RobotSettings(gripper, setup=EXACT_SETUP)
            sensor = _QuietFt300s(rig.wires.sensor_port)
            for _ in range(ATTEMPTS):
                rig.place(pose, action.grasp)
                try:
                    with RealRunner(
                        arm, KortexGripper(arm), sensor, KnownPose(*pose), settings, confirm=lambda _: True
                    ) as runner:
                        record = runner.run(trial)
                except RobotError:
                    continue
                if record.ok and record.figures["command_late_p99_s"] < LATE:
                    done.append(record)
                    break
    return done
