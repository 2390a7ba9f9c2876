"""The arm's kinematics: tool poses over the table to joint angles, by mink on the arm alone."""

from __future__ import annotations

from functools import lru_cache

import mink
import mujoco
import numpy as np
from scipy.interpolate import CubicSpline

from testbed.errors import InfeasibleTrialError
from testbed.gripper import STROKE
from testbed.simulation.scene import arm_spec
from testbed.trajectory import Tool

JOINT_SPEED_LIMIT = np.radians([80, 80, 80, 80, 70, 70, 70])
"""Joint speed limits of the Gen3, rad/s, (7,)."""
_TOLERANCE = 1e-7
_ITERATIONS = 100
# The arm has one joint more than it needs: turn the tool with the last one, and leave the fingers alone.
_MOVE_LAST_JOINT_FIRST = np.array([1e-4] * 6 + [1e-6] + [1e-4] * 2)


@lru_cache(maxsize=1)
def arm_model() -> mujoco.MjModel:
    """Arm, sensor and gripper alone, compiled once a process."""
    return arm_spec().compile()


def joint_path(poses: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Joint angles through tool poses, the tool pointing straight down or turned away from that.

    Args:
        poses: x, y, z of the TCP, m, and yaw of the closing direction, rad, world frame, (N, 4); or with the rotation
            vector, rad, world frame, by which the tool is turned away from pointing straight down, (N, 7).
        start: joint angles to start the search from, rad, (7,).

    Returns:
        Joint angles, rad, (N, 7), continuous along the path.

    Raises:
        InfeasibleTrialError: a pose out of reach or beyond a joint's range.
    """
    path, q = np.empty((len(poses), 7)), tuple(start)
    for i, pose in enumerate(poses):
        q = _solve(tuple(np.round(pose, 9)), tuple(np.round(q, 9)))
        path[i] = q
    return path


@lru_cache(maxsize=4096)
def _solve(pose: tuple[float, ...], start: tuple[float, ...]) -> tuple[float, ...]:
    """One pose from nearby angles; cached, since trials share their approach."""
    model = arm_model()
    configuration = mink.Configuration(model)
    full = configuration.q.copy()
    full[:7] = start
    configuration.update(full)
    task = mink.FrameTask("gripper/tcp", "site", position_cost=1.0, orientation_cost=0.3)
    damping = mink.DampingTask(model, cost=_MOVE_LAST_JOINT_FIRST[: model.nv])
    turned = _tool_down(pose[3]) if len(pose) == 4 else mink.SO3.exp(np.array(pose[4:])) @ _tool_down(pose[3])
    task.set_target(mink.SE3.from_rotation_and_translation(turned, np.array(pose[:3])))
    limits = [mink.ConfigurationLimit(model)]
    for _ in range(_ITERATIONS):
        if np.abs(task.compute_error(configuration)).max() < _TOLERANCE:
            return tuple(configuration.q[:7])
        velocity = mink.solve_ik(configuration, [task, damping], dt=1.0, solver="daqp", limits=limits)
        configuration.integrate_inplace(velocity, 1.0)
    left = np.abs(task.compute_error(configuration)).max()
    raise InfeasibleTrialError(
        f"reach: the arm cannot put the tool at x={pose[0]:.3f} y={pose[1]:.3f} z={pose[2]:.3f} m, "
        f"yaw {np.degrees(pose[3]):.0f} deg{_told_tilt(pose[4:])} (misses by {left:.3g}); "
        "choose a nearer pivot or a shorter slide"
    )


def _told_tilt(turn: tuple[float, ...]) -> str:
    return f", turned by {np.degrees(np.linalg.norm(turn)):.1f} deg" if turn else ""


def _tool_down(yaw: float) -> mink.SO3:
    return mink.SO3.from_z_radians(yaw) @ mink.SO3.from_x_radians(np.pi)


def spline(poses: np.ndarray, start: np.ndarray) -> CubicSpline:
    """Joint angles as a smooth function of a path parameter that runs over 0..1 through `poses` (N, 4)."""
    return CubicSpline(np.linspace(0.0, 1.0, len(poses)), joint_path(poses, start))


def gripper_tool(width: float) -> Tool:
    """The gripper as the sensor carries it, its pads `width` (m) apart, in the sensor frame."""
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
