"""`heft robot trial`: one trial on the real arm: planned, shown, confirmed, run, stored."""

from __future__ import annotations

import inspect
import math
import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import numpy as np
import tyro

from testbed.errors import InvalidValueError

if TYPE_CHECKING:
    from testbed.actions.base import Action
    from testbed.actions.push import Push
    from testbed.objects.model import ObjectShape
    from testbed.robot.camera.interface import ObjectCamera
    from testbed.robot.config import RobotFile
    from testbed.robot.path import KnownPose
    from testbed.trajectory import Trajectory
    from testbed.trial import Trial

Kind = Literal["rotate", "slide", "accelerate", "lift", "stop_and_go", "push", "weigh"]
_PLACE = "at", "at_seen"
_USED: dict[Kind, tuple[str, ...]] = {
    "rotate": ("grasp", "seconds", "speed", "pivot", "back", *_PLACE),
    "slide": ("grasp", "seconds", "speed", "direction", *_PLACE),
    "accelerate": ("grasp", "seconds", *_PLACE),
    "lift": ("grasp", "seconds", "tilt", *_PLACE),
    "stop_and_go": ("grasp", "seconds", "tilt", *_PLACE),
    "push": ("speed", "point", "direction", "curvature", "length", "radius", *_PLACE),
    "weigh": ("weight",),
}
"""Options of `trial` that each action uses, but for those that all use."""
_TO_OUTLINE = 0.003
"""Distance by which a point is taken onto the outline [m]."""


def trial(
    object_: Annotated[str, tyro.conf.Positional, tyro.conf.arg(name="object", metavar="OBJECT")],
    *,
    action: Kind = "rotate",
    grasp: Annotated[str | None, tyro.conf.arg(metavar="NAME")] = None,
    seconds: Annotated[float | None, tyro.conf.arg(metavar="S")] = None,
    speed: Annotated[float | None, tyro.conf.arg(metavar="V")] = None,
    pivot: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None,
    point: Annotated[tuple[float, float] | None, tyro.conf.arg(metavar="X Y")] = None,
    direction: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None,
    curvature: Annotated[float, tyro.conf.arg(metavar="C")] = 0.0,
    length: Annotated[float, tyro.conf.arg(metavar="M")] = 0.1,
    radius: Annotated[float, tyro.conf.arg(metavar="M")] = 0.006,
    tilt: Annotated[float | None, tyro.conf.arg(metavar="DEG")] = None,
    back: bool = True,
    at: Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y DEG")] = None,
    at_seen: bool = False,
    weight: Annotated[float | None, tyro.conf.arg(metavar="KG")] = None,
    support: Annotated[str | None, tyro.conf.arg(metavar="SUPPORT")] = None,
    config: Annotated[Path, tyro.conf.arg(metavar="FILE")] = Path("robot.toml"),
    out: Annotated[Path, tyro.conf.arg(metavar="DIR")] = Path("results/robot"),
    dry_run: bool = False,
) -> None:
    """Run one trial on the real arm and store it. The motion is shown first and starts only after you type yes.

    Exit code: 1 if the trial is unusable.

    Examples: heft robot trial L2 --grasp A2 --dry-run
              heft robot trial L2 --grasp A2 --speed 5 --seconds 2 --out results/lab
              heft robot trial L2 --action push --point 0 -25 --at-seen --out results/lab
              heft robot trial L2 --action weigh --weight 1.8 --out results/lab
              heft estimate results/lab

    Args:
        object_: name in the library, or path to a TOML file.
        action: kind of action; lift rocks the object in the air, stop_and_go holds it there at several tilts,
            push moves closed fingers against a face and needs a camera.
        grasp: grasp by name (see heft show); default: the first.
        seconds: duration at constant speed, or at rest in the air; default: that of the action.
        speed: speed of a turn, deg/s, or of a slide or a push, m/s.
        pivot: center of a turn, mm from the object's middle; default: between particles beside the grasp.
        point: point of the outline where a push makes contact, mm from the object's middle; default: longest face.
        direction: direction of a slide or a push in the object frame; default: along x, or into the face.
        curvature: curvature of a push's path, positive to the left, rad/m.
        length: length of a push.
        radius: radius of the fingertip that pushes.
        tilt: maximum tilt of a lift, up to tilt_deg of the robot file; default: that of the action.
        back: turn back again in the same grasp.
        at: position of the object's middle, m, and its yaw, in the arm's base frame; default: as in simulation.
        at_seen: plan from the object pose seen by the camera.
        weight: reading of a scale, kg; only with --action weigh, which moves nothing.
        support: support of the object, if known: own_weight, rigid, or a stiffness in N/m; default: rigid for an object
            with contact points, otherwise own_weight.
        config: robot file.
        out: results folder.
        dry_run: show the motion without connecting to any device.
    """
    _check_used(action, locals())
    from testbed.objects.files import load_object
    from testbed.objects.model import SPARE_OPENING
    from testbed.robot.config import calibration_of
    from testbed.robot.interfaces import MonotonicClock
    from testbed.robot.path import described, opening, plan_trial
    from testbed.robot.registry import build_arm, build_gripper, build_sensor, gripper_class, load_robot_file
    from testbed.robot.runner import RealRunner, read_off, seen_place
    from testbed.trial import Trial, support_of
    from testbed.validation import check_kilograms

    file = load_robot_file(config)
    model = load_object(object_, measured=True, hand=file.gripper.hand)
    if action not in ("weigh", "push") and not model.shape.grasps:
        raise InvalidValueError("OBJECT", model.name, f"an object that can be gripped: {file.gripper.hand.nothing}")
    if weight is not None:
        check_kilograms("--weight", weight)
        if dry_run:
            raise InvalidValueError("--weight", "with --dry-run, which writes nothing", "one of the two")
    if action == "push":
        move: Action = push_of(model.shape, point, direction, curvature, length, radius, speed)
    else:
        move = action_of(model.shape, action, grasp, seconds, speed, pivot, direction or 0.0, tilt, back=back)
    planned = Trial(model, move, support_of(model.shape, support))
    hand = file.gripper.hand
    if planned.action.grasp is not None and not hand.takes(planned.grasp.width):
        given = f"{planned.grasp.name}, {planned.grasp.width * 1e3:.0f} mm across"
        raise InvalidValueError(
            "--grasp", given, f"{SPARE_OPENING * 1e3:.0f} mm less than the hand's {hand.stroke * 1e3:g} mm"
        )
    if weight is not None:
        _store(read_off(weight), planned, file, out)
        return
    if at_seen and (dry_run or at is not None):
        other = "--dry-run, which connects to nothing" if dry_run else "--at"
        raise InvalidValueError("--at-seen", f"with {other}", "one of the two")
    camera = None if dry_run else _camera(file, planned, at_seen=at_seen)
    place = seen_place(camera, MonotonicClock(), planned) if camera is not None and at_seen else _place(planned, at)
    calibration = None if dry_run else calibration_of(file, config)
    settings = file.settings(calibration, gripper_class(file).data_sheet(opening(planned)))
    if dry_run:
        plan = plan_trial(planned, np.array(place.read()), settings)
        plan.check(settings)
        print(described(plan, settings))
        return
    if calibration is None:
        path = config.parent / file.sensor.calibration
        raise InvalidValueError("sensor.calibration", str(path), "a file that heft robot calibrate has made")
    sensor, arm, raw = build_sensor(file), build_arm(file), out / "raw"
    gripper = build_gripper(file, arm)
    with RealRunner(arm, gripper, sensor, place, settings, confirm=_confirmed, camera=camera, raw=raw) as runner:
        calibration_of(file, config, sensor.identity.serial)
        file.check_arm(arm.identity)
        _store(runner.run(planned), planned, file, out)


def _check_used(action: Kind, given: Mapping[str, object]) -> None:
    """Raise InvalidValueError for an option, by its value, that the action does not use."""
    usual = inspect.signature(trial).parameters
    for name in dict.fromkeys(name for used in _USED.values() for name in used):
        if name not in _USED[action] and given[name] != usual[name].default:
            users = " or ".join(kind for kind, used in _USED.items() if name in used)
            option = f"--{name.replace('_', '-')}"
            raise InvalidValueError(option, given[name], f"none with --action {action}: {users} uses it")


def action_of(
    shape: ObjectShape,
    kind: Kind,
    grasp: str | None = None,
    seconds: float | None = None,
    speed: float | None = None,
    pivot_mm: tuple[float, float] | None = None,
    direction_deg: float = 0.0,
    tilt_deg: float | None = None,
    *,
    back: bool = True,
) -> Action:
    """Action from the command line's units.

    Raises:
        InvalidValueError: no such grasp, or a value out of range.
    """
    from estimators.action_selection.rank import between_particles
    from testbed.actions.accelerate import Accelerate
    from testbed.actions.lift import Lift
    from testbed.actions.rotate import Rotate
    from testbed.actions.slide import Slide
    from testbed.actions.weigh import Weigh

    if kind == "weigh":
        return Weigh()
    names = [g.name for g in shape.grasps]
    if grasp is not None and grasp not in names:
        raise InvalidValueError("--grasp", grasp, f"one of {', '.join(names)}")
    index = 0 if grasp is None else names.index(grasp)
    if kind == "slide":
        action: Action = Slide(index, math.radians(direction_deg))
        changes = {"speed": speed, "duration": seconds}
    elif kind == "accelerate":
        action, changes = Accelerate(index), {"hold": seconds}
    elif kind in ("lift", "stop_and_go"):
        make = Lift if kind == "lift" else Lift.stop_and_go
        tilt = make(index).tilt if tilt_deg is None else math.radians(tilt_deg)
        return make(index, tilt=tilt, hold=make(index).hold if seconds is None else seconds)
    else:
        beside = between_particles(shape, shape.grasps[index].position) if names else None
        pivot = beside if pivot_mm is None else (pivot_mm[0] / 1e3, pivot_mm[1] / 1e3)
        action = Rotate(index, pivot=pivot, back=back)
        changes = {"speed": None if speed is None else math.radians(speed), "duration": seconds}
    return replace(action, **{name: value for name, value in changes.items() if value is not None})


def push_of(
    shape: ObjectShape,
    point_mm: tuple[float, float] | None = None,
    direction_deg: float | None = None,
    curvature: float = 0.0,
    length: float = 0.1,
    radius: float = 0.006,
    speed: float | None = None,
) -> Push:
    """Push from the command line's units; straight into the face at its point, unless a direction is given.

    Raises:
        InvalidValueError: a point away from the outline, or a value out of range.
    """
    from testbed.actions.push import Push
    from testbed.objects.faces import face_at, faces

    if point_mm is None:
        face = max(faces(shape), key=lambda side: side.length)
        point = (face.begin + face.end) / 2
    else:
        point = np.array(point_mm) / 1e3
        face, away = face_at(shape, point)
        if away > _TO_OUTLINE:
            raise InvalidValueError("--point", list(point_mm), f"a point of the outline, {away * 1e3:.1f} mm away")
        point = point - ((point - face.begin) @ face.normal) * face.normal
    x, y = point.tolist()
    into = math.atan2(-face.normal[1], -face.normal[0]) if direction_deg is None else math.radians(direction_deg)
    push = Push((x, y), into, curvature, length=length, radius=radius)
    return push if speed is None else replace(push, speed=speed)


def _camera(file: RobotFile, planned: Trial, *, at_seen: bool) -> ObjectCamera | None:
    """The robot file's camera, if the trial needs one."""
    from testbed.robot.registry import build_camera

    if not (planned.action.needs_camera(planned.object.shape) or at_seen):
        return None
    camera = build_camera(file)
    if camera is None:
        raise InvalidValueError(
            "camera.model", None, 'a camera in the robot file, as model = "udp": it sees what the hand does not hold'
        )
    return camera


def _place(planned: Trial, at: tuple[float, float, float] | None) -> KnownPose:
    """Place of the object: the user's, or the simulation's, whose joints then take the same way."""
    from testbed.robot.path import KnownPose, starting_pose
    from testbed.simulation.runner import SimulationRunner

    if at is not None:
        print("the joints' own limits are not known for a place of your own; they are watched while it moves")
        return KnownPose(at[0], at[1], math.radians(at[2]))
    SimulationRunner().check(planned)
    x, y, yaw = (float(v) for v in starting_pose(planned))
    degrees = math.degrees(math.remainder(yaw, math.tau))
    print(f"put the object with its middle at ({x:.3f}, {y:.3f}) m, turned by {degrees:z.1f} deg, base frame")
    return KnownPose(x, y, yaw)


def _confirmed(motion: str) -> bool:
    print(motion)
    print(
        "Is the object in place, the path clear, a hand on the emergency stop? Type yes and Enter to move the arm: ",
        end="",
        flush=True,
    )
    return sys.stdin.readline().strip().lower() == "yes"


def _store(trajectory: Trajectory, planned: Trial, file: RobotFile, out: Path) -> None:
    """Store the record like a simulated one, and print its status; exit code 1 if it is no data."""
    from scenarios.results.store import Store, key_of, record_request
    from testbed.robot.interfaces import RobotError

    request = record_request(planned) | {"robot": file.to_dict(), "recorded": trajectory.provenance["recorded"]}
    key = key_of(request)
    print(f"{trajectory.status}{': ' if trajectory.reason else ''}{trajectory.reason}")
    try:
        Store(out).put_trial(key, planned, request, trajectory)
    except OSError as error:
        left = f"; what came is in {out / 'raw' / raw}" if (raw := trajectory.provenance.get("raw")) else ""
        raise RobotError(f"{out}: the trial cannot be stored: {error.strerror}{left}") from None
    for figure, value in sorted(trajectory.figures.items()):
        if not figure.startswith("bias_"):
            print(f"  {figure} {value:.4g}")
    print(out / "trials" / key)
    if not trajectory.ok:
        sys.exit(1)
