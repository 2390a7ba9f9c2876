"""Plan of a trial: pose of the object, and the legs of the tool's path, which the arm follows by twists."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Self

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from testbed.actions.path import WORKSPACE, ToolPath, minimum_jerk
from testbed.errors import InfeasibleTrialError
from testbed.frames import pose_from_point, transform_point
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
    """An `ObjectPose` stated by the user, who has placed the object."""

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
    def tilt_angle(self) -> float:
        """Angle of the approach axis from straight down [rad]."""
        return math.acos(float(np.clip(Rotation.from_rotvec(self.tilt).as_matrix()[2, 2], -1.0, 1.0)))


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
        """Line with a peak speed of `speed` [m/s]."""
        return cls(start, end, yaw, max(1.875 * float(np.linalg.norm(end - start)) / speed, 0.1))

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        x = min(max(time / self.duration, 0.0), 1.0)
        (done, rate), way = minimum_jerk(x), self.end - self.start
        return Target(self.start + done * way, self.yaw, rate / self.duration * way, 0.0)


@dataclass(frozen=True, eq=False)
class Acting:
    """Leg of the action itself."""

    path: ToolPath
    height: float
    """Height of the TCP while holding [m], base frame."""

    @property
    def duration(self) -> float:
        """Duration [s]."""
        return self.path.duration

    def at(self, time: float) -> Target:
        """Target at a time since the leg began [s]."""
        pose, rate = self.path.at(time)
        return Target(pose[:3] + self.height * _UP, float(pose[3]), rate[:3], float(rate[3]), pose[4:], rate[4:])


Leg = Line | Acting
"""A part of the path: pose and velocity of the tool over the time since its begin."""


def sampled(leg: Leg) -> tuple[Float[np.ndarray, "N 3"], Float[np.ndarray, "N 6"], Float[np.ndarray, "N"]]:
    """Positions [m], twists [m/s, rad/s] and tilts from straight down [rad] along a leg."""
    targets = [leg.at(t) for t in np.linspace(0.0, leg.duration, max(math.ceil(leg.duration / 0.05), 2) + 1)]
    twists = [np.append(t.velocity, t.angular_velocity) for t in targets]
    return np.array([t.position for t in targets]), np.array(twists), np.array([t.tilt_angle for t in targets])


@dataclass(frozen=True, eq=False)
class RobotPlan:
    """Plan of a trial."""

    trial: Trial
    grasp: Grasp | None
    """Gripped faces; None for a push."""
    object_pose: Float[np.ndarray, "3"]
    """Planar pose of the object [m, rad], base frame."""
    hover: Pose
    """Pose at which the sensor is tared."""
    descent: Line
    act: Acting | None
    """Leg of the action; None for a weighing."""
    lift_and_down: tuple[Line, ...]
    """Legs of a weighing, else empty."""
    rise: Line

    @property
    def legs(self) -> dict[str, Leg]:
        """Legs in order, by name."""
        work: dict[str, Leg] = {} if self.act is None else {"the action": self.act}
        work |= zip(("lift", "put down"), self.lift_and_down, strict=False)
        return {"down to the object": self.descent, **work, "up again": self.rise}

    def duration(self, settings: RobotSettings) -> float:
        """Approximate duration [s], without the travel to the hover pose."""
        waits = 2 * settings.tare_time + settings.settle_time + 2.0
        return waits + sum(leg.duration for leg in self.legs.values())

    def check(self, settings: RobotSettings) -> None:
        """Check the path against the limits.

        Raises:
            InfeasibleTrialError: a position outside the box, or a speed or a tilt beyond its limit.
        """
        for name, leg in self.legs.items():
            positions, twists, tilts = sampled(leg)
            tilts += settings.null_travel[1] * (tilts > 0)  # the settled grip may be tilted
            for violation in path_violations(settings.limits, positions, twists, tilts):
                raise InfeasibleTrialError(
                    f"limit: {name}: {violation}; choose another place, a shorter, slower or less tilted action, "
                    "or other [limits] of the robot"
                )


def starting_pose(trial: Trial) -> Float[np.ndarray, "3"]:
    """Planar pose of the object [m, rad], shape (3,), for which the path is that of the simulation."""
    if trial.action.moves:
        return trial.action.centered_pose(trial.object.shape, PROFILE_STEP)
    grasp = weighing_grasp(trial.object.shape)
    return pose_from_point(np.array(WORKSPACE), grasp.position, np.array(-grasp.angle))


def weighing_grasp(shape: ObjectShape) -> Grasp:
    """Grasp nearest the origin of the object frame, by which the object is lifted.

    Raises:
        InfeasibleTrialError: the object has no grasp.
    """
    if not shape.grasps:
        raise InfeasibleTrialError("grip: nothing is grippable, so it cannot be lifted; weigh it on a scale")
    return min(shape.grasps, key=lambda grasp: float(np.linalg.norm(grasp.position)))


def gripped(trial: Trial) -> Grasp | None:
    """Grasp of a trial; None for a push.

    Raises:
        InfeasibleTrialError: nothing to grip.
    """
    if not trial.action.moves:
        return weighing_grasp(trial.object.shape)
    return None if trial.action.grasp is None else trial.grasp


def opening(trial: Trial) -> float:
    """Distance between the pads during the motion [m]: the width of the grasp, 0 for a push. Raises as `gripped`."""
    grasp = gripped(trial)
    return 0.0 if grasp is None else grasp.width


def plan_trial(trial: Trial, object_pose: Float[np.ndarray, "3"], settings: RobotSettings) -> RobotPlan:
    """Plan a trial for an object at a planar pose [m, rad], base frame, without a check of the limits.

    Raises:
        InfeasibleTrialError: nothing to grip, or no place for the fingertip of a push.
    """
    shape, action, pose = trial.object.shape, trial.action, np.asarray(object_pose, dtype=float)
    height, grasp, act = settings.table_height + settings.grip_height, gripped(trial), None
    if action.moves:
        action.check_start(shape)
        act = Acting(action.tool_path(shape, pose, PROFILE_STEP, settings.descent_speed), height)
        start = act.at(0.0)
        hold, yaw = start.position, start.yaw
    else:
        assert grasp is not None
        hold, yaw = np.append(transform_point(pose, grasp.position), height), float(pose[2]) + grasp.angle
    hover, lifted = hold + settings.hover * _UP, hold + settings.lift * _UP
    ways = (hold, lifted), (lifted, hold)
    last = act.at(act.duration) if act is not None else Target(hold, yaw, np.zeros(3), 0.0)
    return RobotPlan(
        trial=trial,
        grasp=grasp,
        object_pose=pose,
        hover=Pose(hover, tool_down(yaw, settings)),
        descent=Line.at_most(hover, hold, yaw, settings.descent_speed),
        act=act,
        lift_and_down=() if act else tuple(Line.at_most(*way, yaw, settings.descent_speed) for way in ways),
        rise=Line.at_most(last.position, last.position + settings.hover * _UP, last.yaw, settings.descent_speed),
    )


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
    """Description of the motion for the user: positions, speeds and durations per leg, and the path's bounding box."""
    x, y, yaw = plan.object_pose
    turned = math.degrees(math.remainder(yaw, math.tau))
    place = ", ".join(f"{v:.3f}" for v in plan.hover.position)
    action, shape = plan.trial.action, plan.trial.object.shape
    point = ", ".join(f"{1e3 * v:.0f}" for v in action.hand(shape)[0]) if plan.grasp is None else ""
    where = plan.grasp.name if plan.grasp is not None else f"({point}) mm with closed fingers"
    lines = [
        f"{action.kind} of {plan.trial.object.name} at {where}, {plan.duration(settings):.0f} s",
        f"object: its middle at ({x:.3f}, {y:.3f}) m, turned by {turned:z.1f} deg, base frame of the arm",
        f"travel: to ({place}) m, at most {settings.travel_speed:.2f} m/s; zeroed there for {settings.tare_time:g} s",
    ]
    if (tip := action.fingertip(shape)) is not None:
        below = settings.grip_height - tip.height
        lines.append(
            f"fingers: they close first; the fingertip, of radius {tip.radius * 1e3:g} mm, has its middle "
            f"{below * 1e3:.1f} mm below the tool center point"
        )
    path = []
    for name, leg in plan.legs.items():
        positions, twists, tilts = sampled(leg)
        path.append(positions)
        ends = " to ".join(f"({p[0]:.3f}, {p[1]:.3f}, {p[2]:.3f})" for p in positions[[0, -1]])
        speed, turn = (np.linalg.norm(twists[:, part], axis=1).max() for part in (slice(0, 3), slice(3, 6)))
        lines.append(
            f"{name}: {ends} m in {leg.duration:.1f} s, at most {speed:.3f} m/s and {math.degrees(turn):.1f} deg/s"
            + (f", tilted by up to {math.degrees(tilts.max()):.1f} deg" if tilts.max() > 1e-6 else "")
        )
    low, high = np.concatenate(path).min(axis=0), np.concatenate(path).max(axis=0)
    box = zip("xyz", low, high, settings.limits.low, settings.limits.high, strict=True)
    lines += [f"{axis}: {a:.3f} to {b:.3f} m; allowed {c:.3f} to {d:.3f} m" for axis, a, b, c, d in box]
    return "\n".join(lines)
