"""Motion of the arm in a trial: inverse kinematics by mink, and joint targets, phases and grip at every tick."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import mink
import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from testbed.actions.base import Action
from testbed.actions.path import PAUSE, ToolPath, minimum_jerk
from testbed.errors import InfeasibleTrialError
from testbed.objects.model import STROKE, ObjectShape
from testbed.simulation.scene import HOME, attach_arm
from testbed.simulation.settings import SimulationSettings
from testbed.trajectory import Phase, Tool

JOINT_SPEED_LIMIT = np.radians([80, 80, 80, 80, 70, 70, 70])
"""Joint speed limits of the Gen3 [rad/s], shape (7,)."""
HOVER = 0.06
"""Height over the grasp at which the sensor is zeroed [m]."""
_TARE_TIME, _DESCENT_TIME, _CLOSE_TIME, _OPEN_TIME = 0.5, 0.8, 0.8, 0.3
_TOLERANCE = 1e-7
_ITERATIONS = 100
_DAMPING = np.array([1e-4] * 6 + [1e-6] + [1e-4] * 2)
"""Damping of joints and fingers, shape (9,): the arm is redundant, and turns the tool by its last joint first."""


@lru_cache(maxsize=1)
def arm_model() -> mujoco.MjModel:
    """Model of arm, sensor and gripper alone, compiled once a process."""
    spec = mujoco.MjSpec()
    attach_arm(spec)
    return spec.compile()


def joint_path(poses: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Joint angles through tool poses [rad], shape (N, 7), continuous along the path.

    Args:
        poses: x, y, z of the TCP [m] and yaw of the closing direction [rad], world frame, for a tool that points down,
            (N, 4); or with the rotation vector that tilts the tool from there [rad], world frame, (N, 7).
        start: joint angles to start the search from [rad], (7,).

    Raises:
        InfeasibleTrialError: a pose out of reach or beyond a joint's range.
    """
    path, q = np.empty((len(poses), 7)), tuple(start)
    for i, pose in enumerate(poses):
        q = _solve(tuple(np.round(pose if pose[4:].any() else pose[:4], 9)), tuple(np.round(q, 9)))
        path[i] = q
    return path


@lru_cache(maxsize=4096)
def _solve(pose: tuple[float, ...], start: tuple[float, ...]) -> tuple[float, ...]:
    """Joint angles of one pose from nearby angles; cached, since trials share their approach."""
    model = arm_model()
    configuration = mink.Configuration(model)
    full = configuration.q.copy()
    full[:7] = start
    configuration.update(full)
    task = mink.FrameTask("gripper/tcp", "site", position_cost=1.0, orientation_cost=0.3)
    damping = mink.DampingTask(model, cost=_DAMPING[: model.nv])
    down = mink.SO3.from_z_radians(pose[3]) @ mink.SO3.from_x_radians(np.pi)
    tool = mink.SO3.exp(np.array(pose[4:])) @ down if pose[4:] else down
    task.set_target(mink.SE3.from_rotation_and_translation(tool, np.array(pose[:3])))
    limits = [mink.ConfigurationLimit(model)]
    for _ in range(_ITERATIONS):
        if np.abs(task.compute_error(configuration)).max() < _TOLERANCE:
            return tuple(configuration.q[:7])
        velocity = mink.solve_ik(configuration, [task, damping], dt=1.0, solver="daqp", limits=limits)
        configuration.integrate_inplace(velocity, 1.0)
    error = np.abs(task.compute_error(configuration)).max()
    tilt = f", tilted by {np.degrees(np.linalg.norm(pose[4:])):.1f} deg" if pose[4:] else ""
    raise InfeasibleTrialError(
        f"reach: the arm cannot put the tool at x={pose[0]:.3f} y={pose[1]:.3f} z={pose[2]:.3f} m, "
        f"yaw {np.degrees(pose[3]):.0f} deg{tilt} (misses by {error:.3g}); "
        "choose a nearer pivot or a shorter slide"
    )


def gripper_tool(width: float) -> Tool:
    """Gripper as the tool below the sensor, in the sensor frame, with its pads `width` apart [m]."""
    model = arm_model()
    data = mujoco.MjData(model)
    for finger in ("gripper/left_finger", "gripper/right_finger"):
        data.qpos[model.joint(finger).qposadr[0]] = (STROKE - width) / 2
    mujoco.mj_forward(model, data)
    site = data.site("ft/wrench")
    axes = site.xmat.reshape(3, 3)
    root = model.body("gripper/base").id
    parts = [b for b in range(model.nbody) if root in (b, model.body_parentid[b])]
    mass = model.body_mass[parts].sum()
    com = model.body_mass[parts] @ data.xipos[parts] / mass
    inertia = np.zeros((3, 3))
    for body in parts:
        turn = data.ximat[body].reshape(3, 3)
        offset = data.xipos[body] - com
        inertia += turn @ np.diag(model.body_inertia[body]) @ turn.T
        inertia += model.body_mass[body] * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    tcp = data.site("gripper/tcp").xpos
    return Tool(
        mass=float(mass),
        com=axes.T @ (com - site.xpos),
        inertia=axes.T @ inertia @ axes,
        tcp=axes.T @ (tcp - site.xpos),
    )


def joints_along(path: ToolPath, height: float, start: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Joint angles [rad] and speeds [rad/s] at the N ticks of a path, each (N, 7).

    Args:
        path: path of the tool.
        height: height of the TCP where the grip holds, m.
        start: joint angles near its start, rad, (7,).
    """
    first, *others = path.ways
    offset = np.array([0.0, 0.0, height, 0.0, 0.0, 0.0, 0.0])
    curve = CubicSpline(first.knots, joint_path(offset + first.pose(first.knots), start))
    q, qd = curve(first.parameter), curve(first.parameter, 1) * first.rate[:, None]
    offset, end = offset + first.pose(first.knots[-1:]), curve(first.knots[-1])
    for way in others:
        before, after = way.knots[way.knots < 0], way.knots[way.knots > 0]
        down, up = (joint_path(offset + way.pose(knots), end) for knots in (before[::-1], after))
        curve = CubicSpline(way.knots, np.concatenate([down[::-1], end[None], up]))
        moved = (way.parameter != 0) | (way.rate != 0)
        q[moved] = curve(way.parameter[moved])
        qd[moved] = curve(way.parameter[moved], 1) * way.rate[moved, None]
    return q, qd


@dataclass(frozen=True, eq=False)
class Motion:
    """Joint targets and grip at the N ticks of a record."""

    action: Action
    """Action of the trial."""
    start: np.ndarray
    """Initial joint angles [rad], shape (7,)."""
    object_pose: np.ndarray
    """Initial planar pose of the object [m, m, rad], world, shape (3,)."""
    center: tuple[float, float]
    """`Action.center`."""
    phase: np.ndarray
    """`Phase`, shape (N,)."""
    segment: np.ndarray
    """Steady stretch, shape (N,); -1 outside."""
    q: np.ndarray
    """Joint targets [rad], shape (N, 7)."""
    qd: np.ndarray
    """Joint speeds [rad/s], shape (N, 7)."""
    grip: np.ndarray
    """Grip force over that of the settings, from -1 (opening) to 1, shape (N,)."""
    nulling: np.ndarray
    """True while load and tilt are nulled, shape (N,)."""


def plan_motion(
    action: Action,
    shape: ObjectShape,
    settings: SimulationSettings,
    start: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Motion:
    """Plan a trial: pose of the object, and motion of arm and fingers at every tick.

    Args:
        action: what to do.
        shape: geometry as stated.
        settings: rate, grip height and servo.
        start: shift of the whole path from the middle of the workspace, and its turn about the TCP [m, m, rad].

    Raises:
        InvalidValueError: nothing moves.
        InfeasibleTrialError: part of the path is out of the arm's reach, or a fingertip meets no face.
    """
    dt = 1.0 / settings.rate
    pose = action.centered_pose(shape, dt, start)
    path = action.tool_path(shape, pose, dt)
    up = np.array([0.0, 0.0, 1.0, 0.0])
    grasped = path.start[:4] + settings.grip.tcp_height * up
    down = np.linspace(grasped + HOVER * up, grasped, 4)
    descent_path = CubicSpline(np.linspace(0.0, 1.0, 4), joint_path(down, np.array(HOME)))
    q_hover, q_grasp = descent_path(0.0), descent_path(1.0)
    q, qd = joints_along(path, settings.grip.tcp_height, q_grasp)
    servo = settings.servo
    complies = not action.in_air and (servo.null_gain if action.pushes else servo.comply_gain) > 0

    parts: list[tuple[np.ndarray, ...]] = []

    def add(phase: Phase, q: np.ndarray, qd: np.ndarray, grip: tuple[float, float], nulling: bool = False) -> None:
        n = len(q)
        outside = np.full(n, -1)
        parts.append((np.full(n, phase), outside, q, qd, np.linspace(*grip, n), np.full(n, nulling)))

    def hold(phase: Phase, q: np.ndarray, seconds: float, grip: tuple[float, float], nulling: bool = False) -> None:
        n = max(round(seconds / dt), 1)
        add(phase, np.tile(q, (n, 1)), np.zeros((n, 7)), grip, nulling)

    n = round(_DESCENT_TIME / dt)
    s, sd = minimum_jerk(np.arange(1, n + 1) / n)
    ready, full = (0.05, 0.05) if action.pushes else (-0.05, 1.0)
    hold(Phase.TARE, q_hover, _TARE_TIME, (ready, ready))
    add(Phase.APPROACH, descent_path(s), descent_path(s, 1) * sd[:, None] / _DESCENT_TIME, (ready, ready))
    hold(Phase.GRASP, q_grasp, PAUSE, (ready, ready))
    if not action.pushes:
        hold(Phase.GRASP, q_grasp, _CLOSE_TIME, (0.05, 1.0))
        hold(Phase.SETTLE, q_grasp, settings.servo.null_time, (1.0, 1.0), settings.servo.null_gain > 0)
        hold(Phase.SETTLE, q_grasp, PAUSE, (1.0, 1.0))
    phases = np.where(path.segment >= 0, Phase.STEADY, Phase.RAMP)
    parts.append((phases, path.segment, q, qd, np.full(len(q), full), np.full(len(q), complies)))
    if not action.pushes:
        hold(Phase.RELEASE, q[-1], PAUSE, (1.0, 0.0))
        hold(Phase.RELEASE, q[-1], _OPEN_TIME, (-0.05, -0.05))
    joined = map(np.concatenate, zip(*parts, strict=True))
    x, y = action.center(shape)
    return Motion(action, q_hover, pose, (x, y), *joined)
