"""Trials on the real path over fakes at the wire, in real time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from testbed.actions.base import Rotate
from testbed.objects.model import ObjectModel
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import RobotError
from testbed.robot.kinova.arm import KortexArm, KortexSettings
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.path import starting_pose
from testbed.robot.robotiq.ft300s import Ft300s
from testbed.robot.runner import RealRunner
from testbed.sensing.presets import Sensing
from testbed.simulation.motion import gripper_tool
from testbed.trajectory import Trajectory
from testbed.trial import Trial
from tests.fakes.rig import FT300S, FakeRig, python_with_fake_kortex
from tests.helpers.fault_trials import Placed

QUIET = replace(
    FT300S,
    force_noise=tuple(n / 10 for n in FT300S.force_noise),
    torque_noise=tuple(n / 10 for n in FT300S.torque_noise),
)
"""An FT-300S with a tenth of its noise: what it shows is the path's own error. Without any its frames would repeat, and
a sensor that repeats itself is taken for dead."""
ATTEMPTS = 5
"""A busy computer is a silent one, and ends a trial: times that each is begun."""


def over_wires(
    model: ObjectModel,
    actions: Sequence[Rotate],
    noise: Sensing = FT300S,
    said: Callable[[str], None] = lambda _: None,
) -> list[Trajectory]:
    """Turns on a fake Gen3 with a fake FT-300S of some noise, each by the drivers themselves; those that are data."""
    python_with_fake_kortex()
    done = []
    with FakeRig(model, noise=noise) as rig:
        for action in actions:
            trial = Trial(model, action)
            pose = starting_pose(trial)
            arm = KortexArm(KortexSettings("127.0.0.1", port=rig.wires.arm_port))
            settings = RobotSettings(gripper_tool(model.shape.grasps[action.grasp].width))
            sensor = Ft300s(rig.wires.sensor_port)
            for _ in range(ATTEMPTS):
                rig.do("place", pose, action.grasp)
                try:
                    with RealRunner(
                        arm, KortexGripper(arm), sensor, Placed(pose), settings, confirm=lambda _: True
                    ) as runner:
                        record = runner.run(trial)
                except RobotError as error:
                    said(f"{len(done)} of {len(actions)}: {error}")
                    continue
                said(f"{len(done) + record.ok} of {len(actions)}: {record.status} {record.reason}")
                if record.ok:
                    done.append(record)
                    break
    return done
