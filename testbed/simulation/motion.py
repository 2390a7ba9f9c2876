"""A trial as a tool path in time: approach, grasp, settle, the action itself, release."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from testbed.actions import Accelerate, Rotate, Slide, pivot_of
from testbed.frames import pose_from_point, rotation_2d, transform_point
from testbed.objects import ObjectShape
from testbed.simulation.arm import spline
from testbed.simulation.scene import HOME
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase

WORKSPACE = (0.45, 0.0)
"""Where on the table things happen, m from the arm's base."""
HOVER = 0.06
"""Height over the grasp at which the sensor is zeroed, m."""
RAMP_TIME = 0.4
"""Time to reach constant speed and to stop, s."""
_TARE_TIME, _DESCENT_TIME, _CLOSE_TIME, _OPEN_TIME, _PAUSE = 0.5, 0.8, 0.8, 0.3, 0.3
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


def plan_motion(action: Rotate | Accelerate | Slide, shape: ObjectShape, settings: SimulationSettings) -> Motion:
    """Plan a whole trial: where the object lies, and what the arm and the fingers do at every tick.

    Raises:
        InfeasibleTrialError: part of the path is out of the arm's reach.
    """
    dt = 1.0 / settings.rate
    distance, rate, segment = _profile(action, dt)
    waypoints, object_pose = _tool_waypoints(action, shape, settings.grip.tcp_height, distance.max())
    start = waypoints[0].copy()
    start[2] += HOVER
    descent_path = spline(np.linspace(start, waypoints[0], 4), np.array(HOME))
    q_hover, q_grasp = descent_path(0.0), descent_path(1.0)
    work_path = spline(waypoints, q_grasp)
    q_end = work_path(distance[-1] / distance.max())

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
    hold(Phase.GRASP, q_grasp, _PAUSE, (-0.05, -0.05))
    hold(Phase.GRASP, q_grasp, _CLOSE_TIME, (0.05, 1.0))
    hold(Phase.SETTLE, q_grasp, settings.servo.null_time, (1.0, 1.0), settings.servo.null_gain > 0)
    hold(Phase.SETTLE, q_grasp, _PAUSE, (1.0, 1.0))
    total = distance.max()
    n = len(distance)
    phases = np.where(segment >= 0, Phase.STEADY, Phase.RAMP)
    q, qd = work_path(distance / total), work_path(distance / total, 1) * (rate / total)[:, None]
    for i in range(n):
        parts.append(
            (phases[i], q[i : i + 1], qd[i : i + 1], np.ones(1), segment[i : i + 1], settings.servo.comply_gain > 0)
        )
    hold(Phase.RELEASE, q_end, _PAUSE, (1.0, 0.0))
    hold(Phase.RELEASE, q_end, _OPEN_TIME, (-0.05, -0.05))

    return Motion(
        start=q_hover,
        object_pose=object_pose,
        phase=np.concatenate([np.full(len(p[1]), p[0]) for p in parts]),
        segment=np.concatenate([p[4] for p in parts]),
        q=np.concatenate([p[1] for p in parts]),
        qd=np.concatenate([p[2] for p in parts]),
        grip=np.concatenate([p[3] for p in parts]),
        nulling=np.concatenate([np.full(len(p[1]), p[5]) for p in parts]),
    )


def _profile(action: Rotate | Accelerate | Slide, dt: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distance along the path, its rate, and the steady stretch, at each tick of the action itself."""
    knots = [(0.0, 0.0)]
    spans: list[tuple[float, float]] = []

    def go(speed: float, seconds: float, *, steady: bool = False) -> None:
        begin, end = knots[-1][0], knots[-1][0] + seconds
        knots.append((end, speed))
        if steady:
            spans.append((begin, end))

    if isinstance(action, Accelerate):
        speed = abs(action.start_speed)
        go(speed, RAMP_TIME)
        go(speed, _PAUSE)
        for acceleration in action.accelerations:
            speed += math.copysign(acceleration, acceleration * action.start_speed) * action.hold
            go(speed, action.hold, steady=True)
        go(0.0, RAMP_TIME)
    else:
        there = abs(action.speed)
        for speed in (there, -there) if isinstance(action, Rotate) and action.back else (there,):
            go(speed, RAMP_TIME)
            go(speed, action.duration, steady=True)
            go(0.0, RAMP_TIME)
    times, speeds = np.array(knots).T
    t = np.arange(1, round(times[-1] / dt) + 1) * dt
    rate = np.interp(t, times, speeds)
    fine = np.interp(np.arange(0, len(t) * 10 + 1) * dt / 10, times, speeds)
    distance = np.concatenate([[0.0], np.cumsum((fine[1:] + fine[:-1]) / 2) * dt / 10])[10::10]
    segment = np.full(len(t), -1)
    for i, (begin, end) in enumerate(spans):
        segment[(t > begin + dt / 2) & (t < end + dt / 2)] = i
    return distance, rate, segment


def _tool_waypoints(
    action: Rotate | Accelerate | Slide, shape: ObjectShape, height: float, distance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Tool poses (x, y, z, yaw) evenly along the action's path, and the object's pose at its start.

    Turns and slides are centred: the middle of the path lies at the middle of the workspace.
    """
    grasp = shape.grasps[action.grasp]
    centre = np.array(WORKSPACE)
    if isinstance(action, Slide):
        yaw, n = -grasp.angle, max(math.ceil(distance / _STEP_LINE), 4)
        along = rotation_2d(yaw) @ [math.cos(action.direction), math.sin(action.direction)]
        points = centre + np.linspace(-0.5, 0.5, n + 1)[:, None] * distance * along
        yaws = np.full(n + 1, yaw)
    else:
        signed = math.copysign(distance, action.start_speed if isinstance(action, Accelerate) else action.speed)
        n = max(math.ceil(distance / _STEP_TURN), 4)
        yaws = np.linspace(-0.5, 0.5, n + 1) * signed - grasp.angle
        pivot = pivot_of(action, shape)
        middle = transform_point(pose_from_point(centre, grasp.position, np.array(-grasp.angle)), pivot)
        points = transform_point(pose_from_point(np.tile(middle, (n + 1, 1)), pivot, yaws), grasp.position)
    poses = np.column_stack([points, np.full(n + 1, height), yaws + grasp.angle])
    return poses, pose_from_point(points[0], grasp.position, yaws[0])


def _minimum_jerk(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Smooth 0 to 1 and its derivative."""
    return x**3 * (10 - 15 * x + 6 * x**2), 30 * x**2 * (1 - x) ** 2
