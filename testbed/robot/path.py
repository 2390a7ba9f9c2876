"""Legs: stretches of the tool's path that are followed by twists."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.base import Lift, Weigh
from testbed.actions.path import WORKSPACE, Profile, ToolPath
from testbed.errors import InfeasibleTrialError
from testbed.frames import perpendicular, pose_from_point, transform_point
from testbed.objects.model import Grasp, ObjectShape
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import Pose
from testbed.robot.safety import path_violations
from testbed.trial import Trial


@dataclass(frozen=True, eq=False)
class Target:
    """Where the tool should be and how it should move, base frame."""

    position: Float[np.ndarray, "3"]
    """Of the TCP, m."""
    yaw: float
    """Of the closing direction, rad."""
    velocity: Float[np.ndarray, "3"]
    """m/s."""
    yaw_rate: float
    """rad/s."""


class Leg(Protocol):
    """A stretch of the path, followed by twists."""

    @property
    def duration(self) -> float:
        """s."""
        ...

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        ...


@dataclass(frozen=True, eq=False)
class Line:
    """Straight, from rest to rest with least jerk, the yaw kept."""

    start: Float[np.ndarray, "3"]
    """m."""
    end: Float[np.ndarray, "3"]
    """m."""
    yaw: float
    """rad."""
    duration: float
    """s."""

    @classmethod
    def at_most(cls, start: np.ndarray, end: np.ndarray, yaw: float, speed: float) -> Self:
        """The line whose greatest speed is `speed`, m/s."""
        return cls(start, end, yaw, max(1.875 * float(np.linalg.norm(end - start)) / speed, 0.1))

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        x = min(max(time / self.duration, 0.0), 1.0)
        done, rate = x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2 / self.duration
        way = self.end - self.start
        return Target(self.start + done * way, self.yaw, rate * way, 0.0)


@dataclass(frozen=True, eq=False)
class Along:
    """The action itself: along its path at the height of the grip."""

    path: ToolPath
    profile: Profile
    height: float
    """Of the TCP in the base frame, m."""

    @property
    def duration(self) -> float:
        """s."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """The target at a time since the leg began, s."""
        distance, rate = self.profile.at(time)
        length = self.profile.length
        x, y, yaw = self.path.tool_pose(np.array([distance / length - 0.5]))[0]
        yaw_rate = rate / length * self.path.turn
        velocity = rate / length * self.path.slide + yaw_rate * perpendicular(np.array([x, y]) - self.path.centre)
        return Target(np.array([x, y, self.height]), yaw, np.append(velocity, 0.0), yaw_rate)


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"]]:
    """Positions, m, and twists, m/s and rad/s, all along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, [0.0, 0.0, t.yaw_rate]) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists)


PROFILE_STEP = 0.01
"""Time between the ticks of an action's profile, s: the record's."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True, eq=False)
class RobotPlan:
    """Where a trial takes the tool."""

    trial: Trial
    grasp: Grasp
    """The faces that are gripped."""
    object_pose: Float[np.ndarray, "3"]
    """Where the object lies, planar pose, m and rad, base frame."""
    hover: Pose
    """Where the sensor is zeroed."""
    descent: Line
    act: Along | None
    """None for a weighing."""
    lift: Line | None
    """For a weighing only."""
    rise: Line

    @property
    def lift_and_down(self) -> tuple[Line, Line]:
        """How a weighing lifts the object, and puts it down again."""
        assert self.lift is not None
        return self.lift, Line(self.lift.end, self.lift.start, self.lift.yaw, self.lift.duration)

    @property
    def legs(self) -> dict[str, Leg]:
        """What is followed by twists, in order, by name."""
        work: dict[str, Leg]
        if self.act is not None:
            work = {"the action": self.act}
        else:
            work = dict(zip(("lift", "put down"), self.lift_and_down, strict=True))
        return {"down to the object": self.descent, **work, "up again": self.rise}

    def duration(self, settings: RobotSettings) -> float:
        """About how long it takes, without the way to the first place, s."""
        waits = 2 * settings.tare_time + settings.settle_time + 2.0
        return waits + sum(leg.duration for leg in self.legs.values())

    def check(self, settings: RobotSettings) -> None:
        """Refuse what passes a limit.

        Raises:
            InfeasibleTrialError: a place outside the box, or a speed beyond its limit.
        """
        for name, leg in self.legs.items():
            positions, twists = sampled(leg)
            for violation in path_violations(settings.limits, positions, twists):
                raise InfeasibleTrialError(
                    f"limit: {name}: {violation}; choose another place, a shorter or a slower action"
                )


def starting_pose(trial: Trial) -> Float[np.ndarray, "3"]:
    """Where to put the object so that its trial is the simulated bench's: planar pose, m and rad.

    Raises:
        InfeasibleTrialError: a lift.
    """
    if isinstance(trial.action, Lift):
        raise _not_lifted()
    if isinstance(trial.action, Weigh):
        grasp = weighing_grasp(trial.object.shape)
        return pose_from_point(np.array(WORKSPACE), grasp.position, np.array(-grasp.angle))
    length = Profile.of(trial.action, PROFILE_STEP).length
    path = ToolPath.centred(trial.action, trial.object.shape, length, WORKSPACE)
    return path.object_pose(np.array([-0.5]))[0]


def weighing_grasp(shape: ObjectShape) -> Grasp:
    """The grasp nearest the middle: where the object is taken to be lifted.

    Raises:
        InfeasibleTrialError: there is none.
    """
    if not shape.grasps:
        raise InfeasibleTrialError("grip: nothing is grippable, so it cannot be lifted; weigh it on a scale")
    return min(shape.grasps, key=lambda grasp: float(np.linalg.norm(grasp.position)))


def plan_trial(trial: Trial, object_pose: Float[np.ndarray, "3"], settings: RobotSettings) -> RobotPlan:
    """Plan a trial for an object that lies at a planar pose, m and rad, base frame; nothing is checked yet.

    Raises:
        InfeasibleTrialError: a lift.
    """
    shape, action = trial.object.shape, trial.action
    height = settings.table_height + settings.grip_height
    if isinstance(action, Lift):
        raise _not_lifted()
    if isinstance(action, Weigh):
        grasp, act = weighing_grasp(shape), None
        x, y = transform_point(object_pose, grasp.position)
        yaw = float(object_pose[2]) + grasp.angle
    else:
        grasp, profile = shape.grasps[action.grasp], Profile.of(action, PROFILE_STEP)
        path = ToolPath.from_object(action, shape, profile.length, object_pose)
        act = Along(path, profile, height)
        x, y, yaw = path.tool_pose(np.array([-0.5]))[0]
    hold = np.array([x, y, height])
    hover, lifted = hold + settings.hover * _UP, hold + settings.lift * _UP
    last = act.at(act.duration) if act is not None else Target(hold, yaw, np.zeros(3), 0.0)
    return RobotPlan(
        trial=trial,
        grasp=grasp,
        object_pose=np.asarray(object_pose, dtype=float),
        hover=Pose(hover, tool_down(yaw, settings)),
        descent=Line.at_most(hover, hold, yaw, settings.descent_speed),
        act=act,
        lift=Line.at_most(hold, lifted, yaw, settings.descent_speed) if act is None else None,
        rise=Line.at_most(last.position, last.position + settings.hover * _UP, last.yaw, settings.descent_speed),
    )


def _not_lifted() -> InfeasibleTrialError:
    return InfeasibleTrialError(
        "lift: the real arm keeps its tool straight down and does not rock what it holds; lift in simulation, or "
        "weigh, turn and slide"
    )


def tool_down(yaw: float, settings: RobotSettings) -> Float[np.ndarray, "4"]:
    """Orientation of the arm's tool frame, wxyz, with its z axis down and the pads closing along `yaw` (rad)."""
    turn = Rotation.from_euler("ZXZ", [yaw, math.pi, -settings.closing_angle])
    return turn.as_quat(scalar_first=True)


def closing_yaw(orientation: Float[np.ndarray, "N 4"], settings: RobotSettings) -> Float[np.ndarray, "N"]:
    """Yaw of the closing direction of a tool frame, rad, (N,): the inverse of `tool_down`."""
    c, s = math.cos(settings.closing_angle), math.sin(settings.closing_angle)
    along = Rotation.from_quat(orientation, scalar_first=True).apply([c, s, 0.0])
    return np.arctan2(along[..., 1], along[..., 0])


def described(plan: RobotPlan, settings: RobotSettings) -> str:
    """The motion in words, a line a leg: places, speeds, times, and how near the path comes to its limits."""
    x, y, yaw = plan.object_pose
    turned = math.degrees(math.remainder(yaw, math.tau))
    place = ", ".join(f"{v:.3f}" for v in plan.hover.position)
    lines = [
        f"{type(plan.trial.action).__name__.lower()} of {plan.trial.object.name} at {plan.grasp.name}, "
        f"{plan.duration(settings):.0f} s",
        f"object: its middle at ({x:.3f}, {y:.3f}) m, turned by {turned:.1f} deg, base frame of the arm",
        f"travel: to ({place}) m, at most {settings.travel_speed:.2f} m/s; zeroed there for {settings.tare_time:g} s",
    ]
    everywhere = []
    for name, leg in plan.legs.items():
        positions, twists = sampled(leg)
        everywhere.append(positions)
        ends = " to ".join(f"({p[0]:.3f}, {p[1]:.3f}, {p[2]:.3f})" for p in positions[[0, -1]])
        speed, turn = (np.linalg.norm(twists[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6)))
        lines.append(
            f"{name}: {ends} m in {leg.duration:.1f} s, at most {speed:.3f} m/s and {math.degrees(turn):.1f} deg/s"
        )
    low, high = np.concatenate(everywhere).min(axis=0), np.concatenate(everywhere).max(axis=0)
    box = zip("xyz", low, high, settings.limits.low, settings.limits.high, strict=True)
    return "\n".join(
        lines + [f"{axis}: {a:.3f} to {b:.3f} m; allowed {c:.3f} to {d:.3f} m" for axis, a, b, c, d in box]
    )
