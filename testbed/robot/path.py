"""Path of a trial: where the object lies, and the legs of the tool over the table, which twists follow."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Protocol, Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.base import TableAction
from testbed.actions.lift import Lift, LiftProfile
from testbed.actions.path import WORKSPACE, Profile, ToolPath, minimum_jerk
from testbed.errors import InfeasibleTrialError
from testbed.frames import perpendicular, pose_from_point, rotation_2d, transform_point
from testbed.objects.model import Grasp, ObjectShape
from testbed.robot.config import RobotSettings
from testbed.robot.interfaces import Pose
from testbed.robot.safety import path_violations
from testbed.trial import Trial

PROFILE_STEP = 0.01
"""Time between ticks of an action's profile and of the record [s]."""
_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class KnownPose:
    """An `ObjectPose`: the place into which a person has put the object."""

    x: float
    """Position [m], base frame."""
    y: float
    """Position [m], base frame."""
    yaw: float
    """Turn [rad], base frame."""

    def read(self) -> tuple[float, float, float]:
        """Planar pose: x, y [m] and yaw [rad]."""
        return self.x, self.y, self.yaw


@dataclass(frozen=True, eq=False)
class Target:
    """Desired pose and velocity of the tool, base frame."""

    position: Float[np.ndarray, "3"]
    """Position of the TCP [m]."""
    yaw: float
    """Yaw of the closing direction [rad]."""
    velocity: Float[np.ndarray, "3"]
    """Velocity of the TCP [m/s]."""
    yaw_rate: float
    """Rate of the yaw [rad/s]."""
    tilt: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Rotation vector that turns the tool from straight down at that yaw [rad], base axes."""
    tilt_rate: Float[np.ndarray, "3"] = field(default_factory=lambda: np.zeros(3))
    """Rate of `tilt`, whose direction is constant [rad/s]."""

    @property
    def angular_velocity(self) -> Float[np.ndarray, "3"]:
        """Angular velocity of the tool [rad/s]."""
        return np.array([0.0, 0.0, self.yaw_rate]) + self.tilt_rate

    @property
    def aside(self) -> float:
        """Angle of the approach axis from straight down [rad]."""
        return math.acos(float(np.clip(Rotation.from_rotvec(self.tilt).as_matrix()[2, 2], -1.0, 1.0)))


class Leg(Protocol):
    """A stretch of the path."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        ...

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        ...


@dataclass(frozen=True, eq=False)
class Line:
    """Straight leg from rest to rest with least jerk, at constant yaw."""

    start: Float[np.ndarray, "3"]
    """First position [m]."""
    end: Float[np.ndarray, "3"]
    """Last position [m]."""
    yaw: float
    """Yaw of the closing direction [rad]."""
    duration: float
    """Duration [s]."""

    @classmethod
    def at_most(cls, start: np.ndarray, end: np.ndarray, yaw: float, speed: float) -> Self:
        """Line of greatest speed `speed` [m/s]."""
        return cls(start, end, yaw, max(1.875 * float(np.linalg.norm(end - start)) / speed, 0.1))

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        x = min(max(time / self.duration, 0.0), 1.0)
        (done, rate), way = minimum_jerk(x), self.end - self.start
        return Target(self.start + done * way, self.yaw, rate / self.duration * way, 0.0)


@dataclass(frozen=True, eq=False)
class Along:
    """Leg of the action itself, at the height of the grip."""

    path: ToolPath
    profile: Profile
    height: float
    """Height of the TCP [m], base frame."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        distance, rate = self.profile.at(time)
        length = self.profile.length
        x, y, yaw = self.path.tool_pose(np.array([distance / length - 0.5]))[0]
        yaw_rate = rate / length * self.path.turn
        velocity = rate / length * self.path.slide + yaw_rate * perpendicular(np.array([x, y]) - self.path.centre)
        return Target(np.array([x, y, self.height]), yaw, np.append(velocity, 0.0), yaw_rate)


@dataclass(frozen=True, eq=False)
class InAir:
    """Leg of a lift: up from where it was gripped, tilts about the TCP, and down again."""

    hold: Float[np.ndarray, "3"]
    """Position of the TCP on the table [m], base frame."""
    yaw: float
    """Yaw of the closing direction while level [rad]."""
    axes: Float[np.ndarray, "3 3"]
    """The object's axes while level, rows, base frame."""
    profile: LiftProfile

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.profile.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        height, rise, angle, rate = self.profile.at(time)
        return Target(self.hold + height * _UP, self.yaw, rise * _UP, 0.0, angle @ self.axes, rate @ self.axes)


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"], Float[np.ndarray, "N"]]:
    """Positions [m], twists [m/s, rad/s] and tilts from straight down [rad] along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, t.angular_velocity) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists), np.array([t.aside for t in targets])


@dataclass(frozen=True, eq=False)
class RobotPlan:
    """Plan of a trial."""

    trial: Trial
    grasp: Grasp
    """Gripped faces."""
    object_pose: Float[np.ndarray, "3"]
    """Planar pose of the object [m, rad], base frame."""
    hover: Pose
    """Pose at which the sensor is tared."""
    descent: Line
    act: Along | InAir | None
    """None for a weighing."""
    lift: Line | None
    """For a weighing only."""
    rise: Line

    @property
    def lift_and_down(self) -> tuple[Line, Line]:
        """Legs of a weighing: up, and down again."""
        assert self.lift is not None
        return self.lift, Line(self.lift.end, self.lift.start, self.lift.yaw, self.lift.duration)

    @property
    def legs(self) -> dict[str, Leg]:
        """Legs in order, by name."""
        work: dict[str, Leg]
        if self.act is not None:
            work = {"the action": self.act}
        else:
            work = dict(zip(("lift", "put down"), self.lift_and_down, strict=True))
        return {"down to the object": self.descent, **work, "up again": self.rise}

    def duration(self, settings: RobotSettings) -> float:
        """Approximate duration [s], without the way to the first place."""
        waits = 2 * settings.tare_time + settings.settle_time + 2.0
        return waits + sum(leg.duration for leg in self.legs.values())

    def check(self, settings: RobotSettings) -> None:
        """Check the path against the limits.

        Raises:
            InfeasibleTrialError: a place outside the box, or a speed or a tilt beyond its limit.
        """
        for name, leg in self.legs.items():
            positions, twists, tilts = sampled(leg)
            tilts += settings.null_travel[1] * (tilts > 0)  # the grip may have settled askew
            for violation in path_violations(settings.limits, positions, twists, tilts):
                raise InfeasibleTrialError(
                    f"limit: {name}: {violation}; choose another place, or a shorter, slower or less tilted action"
                )


def starting_pose(trial: Trial) -> Float[np.ndarray, "3"]:
    """Planar pose of the object [m, rad] that gives the simulation's path."""
    if not isinstance(trial.action, TableAction):  # the rest follows a path over the table
        grasp = gripped(trial)
        return pose_from_point(np.array(WORKSPACE), grasp.position, np.array(-grasp.angle))
    length = trial.action.profile(PROFILE_STEP).length
    path = trial.action.centered_path(trial.object.shape, length)
    return path.object_pose(np.array([-0.5]))[0]


def weighing_grasp(shape: ObjectShape) -> Grasp:
    """Grasp nearest the middle, by which the object is lifted.

    Raises:
        InfeasibleTrialError: there is none.
    """
    if not shape.grasps:
        raise InfeasibleTrialError("grip: nothing is grippable, so it cannot be lifted; weigh it on a scale")
    return min(shape.grasps, key=lambda grasp: float(np.linalg.norm(grasp.position)))


def gripped(trial: Trial) -> Grasp:
    """Grasp of a trial.

    Raises:
        InfeasibleTrialError: a push, or nothing to grip.
    """
    if trial.action.moves and trial.action.grasp is None:
        raise InfeasibleTrialError("push: the robot pushes nothing yet, for want of a camera; push in simulation")
    return trial.grasp if trial.action.moves else weighing_grasp(trial.object.shape)


def plan_trial(trial: Trial, object_pose: Float[np.ndarray, "3"], settings: RobotSettings) -> RobotPlan:
    """Plan of a trial for an object at a planar pose [m, rad], base frame; not checked yet.

    Raises:
        InfeasibleTrialError: nothing to grip.
    """
    shape, action = trial.object.shape, trial.action
    height = settings.table_height + settings.grip_height
    if not isinstance(action, TableAction):  # the rest follows a path over the table
        grasp, act = gripped(trial), None
        x, y = transform_point(object_pose, grasp.position)
        yaw = float(object_pose[2]) + grasp.angle
        if isinstance(action, Lift):
            act = _in_air(trial, action, np.array([x, y, height]), yaw, settings)
    else:
        grasp, profile = shape.grasps[action.grasp], action.profile(PROFILE_STEP)
        path = action.path_from(shape, profile.length, object_pose)
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


def _in_air(trial: Trial, action: Lift, hold: np.ndarray, yaw: float, settings: RobotSettings) -> InAir:
    shape, axes = trial.object.shape, np.eye(3)
    axes[:2, :2] = rotation_2d(yaw - shape.grasps[action.grasp].angle).T
    profile = action.profile(PROFILE_STEP, action.clear_height(shape), settings.descent_speed)
    return InAir(hold, yaw, axes, profile)


def tool_down(yaw: float, settings: RobotSettings) -> Float[np.ndarray, "4"]:
    """Orientation of the arm's tool frame, wxyz, with its z axis down and the pads closing along `yaw` [rad]."""
    turn = Rotation.from_euler("ZXZ", [yaw, math.pi, -settings.closing_angle])
    return turn.as_quat(scalar_first=True)


def closing_yaw(orientation: Float[np.ndarray, "N 4"], settings: RobotSettings) -> Float[np.ndarray, "N"]:
    """Yaw of the closing direction of a tool frame [rad], shape (N,): the inverse of `tool_down`."""
    c, s = math.cos(settings.closing_angle), math.sin(settings.closing_angle)
    along = Rotation.from_quat(orientation, scalar_first=True).apply([c, s, 0.0])
    return np.arctan2(along[..., 1], along[..., 0])


def described(plan: RobotPlan, settings: RobotSettings) -> str:
    """The motion in words, a line per leg: places, speeds, times, and the path's distance from its limits."""
    x, y, yaw = plan.object_pose
    turned = math.degrees(math.remainder(yaw, math.tau))
    place = ", ".join(f"{v:.3f}" for v in plan.hover.position)
    lines = [
        f"{plan.trial.action.kind} of {plan.trial.object.name} at {plan.grasp.name}, {plan.duration(settings):.0f} s",
        f"object: its middle at ({x:.3f}, {y:.3f}) m, turned by {turned:.1f} deg, base frame of the arm",
        f"travel: to ({place}) m, at most {settings.travel_speed:.2f} m/s; zeroed there for {settings.tare_time:g} s",
    ]
    everywhere = []
    for name, leg in plan.legs.items():
        positions, twists, tilts = sampled(leg)
        everywhere.append(positions)
        ends = " to ".join(f"({p[0]:.3f}, {p[1]:.3f}, {p[2]:.3f})" for p in positions[[0, -1]])
        speed, turn = (np.linalg.norm(twists[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6)))
        lines.append(
            f"{name}: {ends} m in {leg.duration:.1f} s, at most {speed:.3f} m/s and {math.degrees(turn):.1f} deg/s"
            + (f", tilted by up to {math.degrees(tilts.max()):.1f} deg" if tilts.max() > 1e-6 else "")
        )
    low, high = np.concatenate(everywhere).min(axis=0), np.concatenate(everywhere).max(axis=0)
    box = zip("xyz", low, high, settings.limits.low, settings.limits.high, strict=True)
    return "\n".join(
        lines + [f"{axis}: {a:.3f} to {b:.3f} m; allowed {c:.3f} to {d:.3f} m" for axis, a, b, c, d in box]
    )
