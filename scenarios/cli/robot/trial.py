"""One trial on the real arm: asked for in a user's units, planned, shown, confirmed, run, stored."""

from __future__ import annotations

import math
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np

from estimators.action_selection.rank import between_particles
from scenarios.results.store import Store, key_of, object_request
from testbed.actions.base import Accelerate, Action, Rotate, Slide, Weigh, action_to_dict
from testbed.errors import InvalidValueError
from testbed.objects.files import load_object
from testbed.objects.model import ObjectShape
from testbed.robot.config import RobotFile, calibration_of, load_robot_file, sensor_port
from testbed.robot.interfaces import WrenchSensor
from testbed.robot.kinova.arm import KortexArm
from testbed.robot.kinova.gripper import KortexGripper
from testbed.robot.path import described, plan_trial, starting_pose, weighing_grasp
from testbed.robot.runner import RealRunner, read_off
from testbed.simulation.runner import SimulationRunner
from testbed.trajectory import SCHEMA_VERSION, Trajectory
from testbed.trial import Trial, parse_support
from testbed.validation import check_positive


@dataclass(frozen=True)
class Asked:
    """What the command line says, in its units."""

    action: Literal["rotate", "slide", "accelerate", "weigh"]
    grasp: str | None
    seconds: float | None
    speed: float | None
    pivot_mm: tuple[float, float] | None
    direction_deg: float
    back: bool
    at: tuple[float, float, float] | None
    weight: float | None
    support: str


@dataclass(frozen=True)
class Placed:
    """An `ObjectPose`: where a person has put the object."""

    x: float
    y: float
    yaw: float

    def read(self) -> tuple[float, float, float]:
        """x, y, m, and yaw, rad."""
        return self.x, self.y, self.yaw


def run_trial(name: str, asked: Asked, config: Path, out: Path, *, dry_run: bool) -> int:
    """Plan and, if it is not a dry run and a person says yes, run one trial; 0 where it is data, else 1."""
    file, model = load_robot_file(config), load_object(name)
    if asked.weight is not None:
        check_positive("--weight", asked.weight)
        if asked.action != "weigh":
            raise InvalidValueError("--weight", asked.weight, "a weight with --action weigh alone")
    trial = Trial(model, action_of(asked, model.shape), parse_support(asked.support))
    if isinstance(trial.action, Weigh) and asked.weight is not None:
        return _stored(read_off(asked.weight), trial, file, out)
    placed = _place(trial, asked)
    calibration = None if dry_run else calibration_of(file, config)
    settings = file.settings(calibration, _width(trial))
    if dry_run:
        plan = plan_trial(trial, np.array(placed.read()), settings)
        plan.check(settings)
        print(described(plan, settings))
        return 0
    if calibration is None:
        where = config.parent / file.sensor.calibration
        raise InvalidValueError("sensor.calibration", str(where), "a file that heft robot calibrate has made")
    sensor = _sensor(sensor_port(file))
    arm = KortexArm(file.kortex())
    with RealRunner(arm, KortexGripper(arm), sensor, placed, settings, confirm=_confirmed) as runner:
        calibration_of(file, config, sensor.identity.serial)
        return _stored(runner.run(trial), trial, file, out)


def action_of(asked: Asked, shape: ObjectShape) -> Action:
    """The action in SI units, the object's frame.

    Raises:
        InvalidValueError: no such grasp, or a value out of range.
    """
    if asked.action == "weigh":
        return Weigh()
    names = [grasp.name for grasp in shape.grasps]
    if asked.grasp is not None and asked.grasp not in names:
        raise InvalidValueError("grasp", asked.grasp, f"one of {', '.join(names)}")
    grasp = 0 if asked.grasp is None else names.index(asked.grasp)
    if asked.action == "slide":
        action: Action = Slide(grasp, math.radians(asked.direction_deg))
        changes = {"speed": asked.speed, "duration": asked.seconds}
    elif asked.action == "accelerate":
        action, changes = Accelerate(grasp), {"hold": asked.seconds}
    else:
        beside = between_particles(shape, shape.grasps[grasp].position) if names else None
        pivot = beside if asked.pivot_mm is None else (asked.pivot_mm[0] / 1e3, asked.pivot_mm[1] / 1e3)
        action = Rotate(grasp, pivot=pivot, back=asked.back)
        changes = {"speed": None if asked.speed is None else math.radians(asked.speed), "duration": asked.seconds}
    return replace(action, **{name: value for name, value in changes.items() if value is not None})


def _place(trial: Trial, asked: Asked) -> Placed:
    """Where the object is to lie; asked of the simulated bench too where its joints would take the same way."""
    if asked.at is not None:
        x, y, degrees = asked.at
        print("the joints' own limits are not known for a place of your own; they are watched while it moves")
        return Placed(x, y, math.radians(degrees))
    SimulationRunner().check(trial)
    x, y, yaw = starting_pose(trial)
    print(f"put the object with its middle at ({x:.3f}, {y:.3f}) m, turned by {_degrees(yaw)} deg, base frame")
    return Placed(float(x), float(y), float(yaw))


def _degrees(angle: float) -> str:
    """From -180 to 180, without a minus before a zero."""
    return f"{math.degrees(math.remainder(angle, math.tau)) + 0.0:.1f}"


def _width(trial: Trial) -> float:
    """Of what is gripped, m."""
    shape, action = trial.object.shape, trial.action
    return (weighing_grasp(shape) if isinstance(action, Weigh) else shape.grasps[action.grasp]).width


def _sensor(port: str) -> WrenchSensor:
    from testbed.robot.robotiq.ft300s import Ft300s  # noqa: PLC0415  a dry run needs no driver

    return Ft300s(port)


def _confirmed(motion: str) -> bool:
    print(motion)
    print(
        "Is the object in its place, the way clear, and a hand on the emergency stop? yes and Enter moves the arm: ",
        end="",
    )
    sys.stdout.flush()
    return sys.stdin.readline().strip().lower() == "yes"


def _stored(trajectory: Trajectory, trial: Trial, file: RobotFile, out: Path) -> int:
    """Keep the record where simulated ones are kept, and say what it came to."""
    asked = {
        "schema": SCHEMA_VERSION,
        "object": object_request(trial.object),
        "action": action_to_dict(trial.action),
        "support": trial.support.name,
        "robot": file.model_dump(),
        "recorded": trajectory.provenance["recorded"],
    }
    key = key_of(asked)
    Store(out).put_trial(key, trial, asked, trajectory)
    print(f"{trajectory.status}{': ' if trajectory.reason else ''}{trajectory.reason}")
    for figure, value in sorted(trajectory.figures.items()):
        if not figure.startswith("bias_"):
            print(f"  {figure} {value:.4g}")
    print(out / "trials" / key)
    return int(not trajectory.ok)
