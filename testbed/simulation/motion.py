"""A trial as a tool path in time: approach, grasp, settle, the action itself, release."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from testbed.actions import Lift, Slide, TableAction
from testbed.frames import pose_from_point
from testbed.lift_profile import LiftProfile
from testbed.objects import ObjectShape
from testbed.profile import PAUSE, Profile
from testbed.simulation.arm import spline
from testbed.simulation.lifting import lifted_joints
from testbed.simulation.scene import HOME
from testbed.simulation.settings import SimulationSettings
from testbed.tool_path import WORKSPACE, ToolPath
from testbed.trajectory import Phase

HOVER = 0.06
"""Height over the grasp at which the sensor is zeroed, m."""
_TARE_TIME, _DESCENT_TIME, _CLOSE_TIME, _OPEN_TIME = 0.5, 0.8, 0.8, 0.3
_STEP_TURN, _STEP_LINE = math.radians(10), 0.025


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint targets and grip at every record tick, N ticks."""

    start: np.ndarray
    """Joint angles to start from, (7,)."""
    object_pose: np.ndarray
    """Where the object lies, planar pose, (3,)."""
    phase: np.ndarray
    """`Phase`, (N,)."""
    segment: np.ndarray
    """Steady stretch, (N,), -1 outside."""
    q: np.ndarray
    """Joint targets, rad, (N, 7)."""
    qd: np.ndarray
    """Joint speeds, rad/s, (N, 7)."""
    grip: np.ndarray
    """Part of the grip force, -1 (opening) to 1, (N,)."""
    nulling: np.ndarray
    """Whether load and tilt are being nulled, (N,) bool."""
    in_the_air: bool
    """Whether the object leaves the table."""


def plan_motion(action: TableAction | Lift, shape: ObjectShape, settings: SimulationSettings) -> Motion:
    """Plan a whole trial: where the object lies, and what the arm and the fingers do at every tick.

    Raises:
        InfeasibleTrialError: part of the path is out of the arm's reach.
    """
    dt = 1.0 / settings.rate
    lifts = isinstance(action, Lift)
    work = _lifting(action, shape, settings) if lifts else _on_table(action, shape, settings)
    start = work.hold.copy()
    start[2] += HOVER
    descent_path = spline(np.linspace(start, work.hold, 4), np.array(HOME))
    q_hover, q_grasp = descent_path(0.0), descent_path(1.0)
    q, qd = work.joints(q_grasp)

    parts: list[tuple[Phase, np.ndarray, np.ndarray, np.ndarray, np.ndarray, bool]] = []

    def hold(phase: Phase, q: np.ndarray, seconds: float, grip: tuple[float, float], nulling: bool = False) -> None:
        n = max(round(seconds / dt), 1)
        parts.append((phase, np.tile(q, (n, 1)), np.zeros((n, 7)), np.linspace(*grip, n), np.full(n, -1), nulling))

    n = round(_DESCENT_TIME / dt)
    s, sd = _minimum_jerk(np.arange(1, n + 1) / n)
    hold(Phase.TARE, q_hover, _TARE_TIME, (-0.05, -0.05))
    parts.append(
        (
            Phase.APPROACH,
            descent_path(s),
            descent_path(s, 1) * sd[:, None] / _DESCENT_TIME,
            np.full(n, -0.05),
            np.full(n, -1),
            False,
        )
    )
    hold(Phase.GRASP, q_grasp, PAUSE, (-0.05, -0.05))
    hold(Phase.GRASP, q_grasp, _CLOSE_TIME, (0.05, 1.0))
    hold(Phase.SETTLE, q_grasp, settings.servo.null_time, (1.0, 1.0), settings.servo.null_gain > 0)
    hold(Phase.SETTLE, q_grasp, PAUSE, (1.0, 1.0))
    phases = np.where(work.segment >= 0, Phase.STEADY, Phase.RAMP)
    for i in range(len(q)):
        parts.append((phases[i], q[i : i + 1], qd[i : i + 1], np.ones(1), work.segment[i : i + 1], work.complies))
    hold(Phase.RELEASE, q[-1], PAUSE, (1.0, 0.0))
    hold(Phase.RELEASE, q[-1], _OPEN_TIME, (-0.05, -0.05))

    return Motion(
        start=q_hover,
        object_pose=work.object_pose,
        phase=np.concatenate([np.full(len(p[1]), p[0]) for p in parts]),
        segment=np.concatenate([p[4] for p in parts]),
        q=np.concatenate([p[1] for p in parts]),
        qd=np.concatenate([p[2] for p in parts]),
        grip=np.concatenate([p[3] for p in parts]),
        nulling=np.concatenate([np.full(len(p[1]), p[5]) for p in parts]),
        in_the_air=lifts,
    )


@dataclass(frozen=True, eq=False)
class _Work:
    """The action itself, between grasp and release."""

    hold: np.ndarray
    """Tool pose at which it grips: x, y, z, yaw, (4,)."""
    object_pose: np.ndarray
    """Where the object lies, planar pose, (3,)."""
    segment: np.ndarray
    """Steady stretch of every tick, (N,), -1 outside."""
    joints: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]
    """From the joint angles at the grip to those of every tick, rad, and their speeds, rad/s, (N, 7)."""
    complies: bool
    """Whether load and tilt are nulled meanwhile."""


def _on_table(action: TableAction, shape: ObjectShape, settings: SimulationSettings) -> _Work:
    """Turns and slides are centred: the middle of the path lies at the middle of the workspace."""
    profile = Profile.of(action, 1.0 / settings.rate)
    distance, rate, total = profile.distance, profile.rate, profile.length
    path = ToolPath.centred(action, shape, total, WORKSPACE)
    n = max(math.ceil(total / (_STEP_LINE if isinstance(action, Slide) else _STEP_TURN)), 4)
    part = np.linspace(-0.5, 0.5, n + 1)
    tool = path.tool_pose(part)
    waypoints = np.column_stack([tool[:, :2], np.full(n + 1, settings.grip.tcp_height), tool[:, 2]])

    def joints(q_grasp: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        along = spline(waypoints, q_grasp)
        return along(distance / total), along(distance / total, 1) * (rate / total)[:, None]

    complies = settings.servo.comply_gain > 0
    return _Work(waypoints[0], path.object_pose(part)[0], profile.segment, joints, complies)


def _lifting(action: Lift, shape: ObjectShape, settings: SimulationSettings) -> _Work:
    """The TCP stays over the middle of the workspace, the pads closing along x."""
    profile = LiftProfile.of(action, 1.0 / settings.rate)
    grasp = shape.grasps[action.grasp]
    hold = np.array([*WORKSPACE, settings.grip.tcp_height, 0.0])
    pose = pose_from_point(hold[:2], grasp.position, np.array(-grasp.angle))
    return _Work(
        hold, pose, profile.segment, lambda q_grasp: lifted_joints(action, profile, hold, pose[2], q_grasp), False
    )


def _minimum_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth 0 to 1 and its derivative."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2
