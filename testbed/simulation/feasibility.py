"""Feasibility of a trial before anything moves: grip, table, support, drag, lift, joint torques and speeds."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from testbed.actions.base import Fingertip
from testbed.actions.path import EDGES, HIGH, LOW, outline, overhang_of
from testbed.errors import InfeasibleTrialError
from testbed.frames import rotation_2d
from testbed.objects.model import (
    GRAVITY,
    LEAST_FACE,
    MINIMUM_HEIGHT,
    PAD_HEIGHT,
    PAD_WIDTH,
    ROBOTIQ_2F85,
    SPARE_OPENING,
    Grasp,
    ObjectModel,
)
from testbed.simulation.contacts import resting_loads
from testbed.simulation.motion import JOINT_SPEED_LIMIT, Motion, arm_model
from testbed.simulation.settings import MARGIN, GripSettings, SimulationSettings
from testbed.trial import Trial

FLANGE_PAYLOAD = 4.0
"""Payload of the Gen3 at its flange at mid range [kg]."""
EVERY = 10
"""Ticks between two checks of the joints' torques."""


def check_feasible(trial: Trial, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse an infeasible trial.

    Raises:
        InfeasibleTrialError: an object that is too wide or too low to grip, passes the table's edge, rests with a
            lifted foot, or cannot be lifted; friction beyond the grip; drag beyond a joint's working torque; or a joint
            beyond its speed limit. The message says by how much, and what to change.
    """
    if (tip := trial.action.fingertip(trial.object.shape)) is not None:
        _check_push(trial, tip, motion, settings)
        _check_speed(motion)
        return
    shape, grasp = trial.object.shape, trial.grasp
    if not ROBOTIQ_2F85.takes(grasp.width):
        raise InfeasibleTrialError(
            f"grip: block {grasp.name} is {grasp.width * 1e3:.0f} mm wide; the gripper opens to "
            f"{ROBOTIQ_2F85.stroke * 1e3:.0f} mm and needs {SPARE_OPENING * 1e3:.0f} mm of clearance; choose a "
            "narrower part"
        )
    top = shape.height if grasp.top is None else grasp.top
    # Only the part of a face above the pads' lower edge counts
    if top < (max(grasp.bottom, PAD_HEIGHT[0]) + LEAST_FACE - 1e-9 if grasp.bottom > 0 else MINIMUM_HEIGHT):
        what, needed = f"the object is {top * 1e3:.0f} mm high", f"{MINIMUM_HEIGHT * 1e3:.0f} mm"
        if grasp.bottom > 0:
            what = f"the faces of {grasp.name} are {grasp.bottom * 1e3:.1f} to {top * 1e3:.1f} mm over the table"
            needed = f"{LEAST_FACE * 1e3:.0f} mm of face above that"
        raise InfeasibleTrialError(f"grip: {what}; the pads, 3 mm over the table, need {needed}")
    _check_table(trial, motion, settings)
    loads = resting_loads(trial.object, trial.support, settings.contact)
    _check_rest(trial, loads)
    if trial.action.in_air:  # no friction; the grip carries the weight
        _check_lift(trial, grasp, motion, settings)
    else:
        _check_drag(trial, _drags(trial, loads), grasp, motion, settings.grip)
    _check_speed(motion)


def _check_push(trial: Trial, tip: Fingertip, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse a push that starts inside the object, passes the table's edge, or has too much drag."""
    shape = trial.object.shape
    trial.action.check_start(shape)
    # However the object turns, it stays within its diameter of the fingertip
    reach = float(np.linalg.norm(outline(shape)[:, None] - outline(shape)[None], axis=2).max()) + tip.radius
    (way,) = trial.action.tool_path(shape, motion.object_pose, 1 / settings.rate).ways
    path = way.pose(way.knots)[:, :2]
    beyond = (np.array(LOW) - path + reach).max(), (path + reach - np.array(HIGH)).max()
    if max(beyond) > 0:
        raise InfeasibleTrialError(
            f"table: the object might pass the table's edge by {max(beyond) * 1e3:.0f} mm; push it less far"
        )
    loads = resting_loads(trial.object, trial.support, settings.contact)
    _check_rest(trial, loads)
    _check_torques(motion, float(_drags(trial, loads).sum()), 0.0)


def _check_speed(motion: Motion) -> None:
    speed = np.abs(motion.qd) / JOINT_SPEED_LIMIT
    if speed.max() > 1:
        joint = int(speed.max(axis=0).argmax())
        raise InfeasibleTrialError(
            f"speed: joint {joint + 1} would need {speed.max():.2f} times its limit of "
            f"{np.degrees(JOINT_SPEED_LIMIT[joint]):.0f} deg/s; move slower"
        )


def _check_table(trial: Trial, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse an object that passes the table's edge: the plane of the scene is infinite."""
    shape = trial.object.shape
    beyond = overhang_of(shape, trial.action.planar_path(shape, motion.object_pose, 1 / settings.rate))
    worst = int(beyond.argmax())
    if beyond[worst] > 1e-9:
        raise InfeasibleTrialError(
            f"table: the object's outline would pass the table's {EDGES[worst]} edge by {beyond[worst] * 1e3:.0f} mm; "
            f"all of it must stay within x {LOW[0]:.2f} to {HIGH[0]:.2f} m and y {LOW[1]:.2f} to {HIGH[1]:.2f} m; take "
            "a shorter way, a turn about a point nearer the object, or a block nearer its middle"
        )


def _check_drag(trial: Trial, drags: np.ndarray, grasp: Grasp, motion: Motion, grip: GripSettings) -> None:
    """Refuse friction under the object beyond the grip or the joint torques."""
    drag = float(drags.sum())
    torque = float(drags @ np.linalg.norm(trial.object.shape.particles - grasp.position, axis=1))
    if grip.mode == "friction":
        holds = {
            "drag": (drag, 2 * grip.force * min(grip.friction, 1.0), "N"),
            "torque": (torque, grip.force * min(PAD_WIDTH, grasp.length), "N m"),
        }
        for what, (needed, held, unit) in holds.items():
            if needed > MARGIN * held:
                raise InfeasibleTrialError(
                    f"grip: {what} of up to {needed:.2f} {unit} at block {grasp.name} against {MARGIN * held:.2f} "
                    f"that a grip of {grip.force:g} N holds; take a block nearer the middle, a stronger grip (up to "
                    "235 N) or a weld"
                )
    _check_torques(motion, drag, torque)


def _drags(trial: Trial, loads: np.ndarray) -> np.ndarray:
    """Friction under every particle [N], shape (P,), from its load at rest [N]."""
    group = trial.object.shape.friction_group
    return np.where(group >= 0, trial.object.truth.friction[np.maximum(group, 0)], 0.0) * loads.clip(min=0.0)


def _check_rest(trial: Trial, loads: np.ndarray) -> None:
    """Refuse a foot that would have to pull: the laws of the loads do not hold with a lifted foot.

    An object with guessed masses is not refused: the real one rests on the table.
    """
    if not trial.object.masses_known:
        return
    shape = trial.object.shape
    feet = np.flatnonzero(shape.friction_group >= 0)
    worst = feet[loads[feet].argmin()]
    if loads[worst] < -1e-9 * loads[feet].mean():
        x, y = (round(v) for v in shape.particles[worst] * 1e3)
        raise InfeasibleTrialError(
            f"rest: on {trial.support.name} the foot of {shape.group_names[shape.mass_group[worst]]} at ({x}, "
            f"{y}) mm would carry {loads[worst]:.3f} N, that is lift, with {loads[feet].mean():.3f} N on the mean "
            f"foot; {int((loads[feet] < 0).sum())} of {len(feet)} feet lift; give the object feet nearer under its "
            "center of mass" + ("" if trial.support.is_rigid else ", or use a stiffer support, as rigid")
        )


def _check_torques(motion: Motion, drag: float, torque: float) -> None:
    """Check static joint torques at the ends and the middle of the path, with the drag in the worst direction."""
    model = arm_model()
    data = mujoco.MjData(model)
    jacobian = np.zeros((6, model.nv))
    limit = model.jnt_actfrcrange[:7, 1]
    for q in motion.q[[0, len(motion.q) // 2, -1]]:
        data.qpos[:7] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_jacSite(model, data, jacobian[:3], jacobian[3:], model.site("gripper/tcp").id)
        lever = np.hypot(jacobian[0, :7], jacobian[1, :7])
        needed = np.abs(data.qfrc_bias[:7]) + lever * drag + np.abs(jacobian[5, :7]) * torque
        over = needed / limit
        if over.max() > 1:
            joint = int(over.argmax())
            raise InfeasibleTrialError(
                f"torque: joint {joint + 1} would need up to {needed[joint]:.1f} N m of its {limit[joint]:g} N m to "
                f"push a drag of {drag:.1f} N and {torque:.2f} N m; use a lighter object or less friction"
            )


def _check_lift(trial: Trial, grasp: Grasp, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse a lift of an object in parts, or beyond payload, grip or joint torques."""
    obj = trial.object
    if not trial.support.is_rigid:
        raise InfeasibleTrialError(
            f"support: on {trial.support.name} the parts hang on vertical slides, and only what is gripped would be "
            "lifted; lift with support rigid"
        )
    model = arm_model()
    payload = FLANGE_PAYLOAD - float(model.body_mass[model.body("ft/housing").id :].sum())  # sensor and gripper
    if obj.total_mass > payload:
        raise InfeasibleTrialError(
            f"payload: the object's {obj.total_mass:.3f} kg against {payload:.2f} kg that the arm carries beside "
            "sensor and gripper; use a lighter object"
        )
    if settings.grip.mode == "friction":
        _check_grip(obj, grasp, trial.action.tilt_acceleration, settings)
    _check_joints(obj, grasp, motion, settings)


def _check_grip(obj: ObjectModel, grasp: Grasp, acceleration: float, settings: SimulationSettings) -> None:
    """Check weight and moments against the pads' limit surface, an ellipse of force and torsion (Howe, Cutkosky 1996).

    The pads press evenly on the face they meet. The moment across the closing axis divides the weight unevenly between
    them; the moment about the closing axis twists both.
    """
    grip, weight = settings.grip, obj.total_mass * GRAVITY
    along, across = rotation_2d(-grasp.angle) @ (obj.center_of_mass - grasp.position)
    inertia = obj.inertia_cm + obj.total_mass * (along**2 + across**2)
    top = obj.shape.height if grasp.top is None else grasp.top
    face = min(PAD_WIDTH, grasp.length), min(top, PAD_HEIGHT[1]) - max(grasp.bottom, PAD_HEIGHT[0])
    holds = grip.force * grip.friction
    carried = weight * (0.5 + abs(along) / grasp.width)
    twist = weight * abs(across) + inertia * acceleration
    twist_held = 2 * holds * _mean_distance(*face)
    used = math.hypot(carried / holds, twist / twist_held)
    if used > MARGIN:
        raise InfeasibleTrialError(
            f"grip: at {grasp.name} the heavier loaded pad would carry {carried:.1f} N and both be twisted by "
            f"{twist:.2f} N m, {100 * used:.0f} % of what a grip of {grip.force:g} N holds ({holds:.0f} N, "
            f"{twist_held:.2f} N m) where {100 * MARGIN:.0f} % may be used; take a block nearer the center of mass, a "
            "stronger grip (up to 235 N) or a weld"
        )


def _mean_distance(width: float, height: float) -> float:
    """Mean distance of a rectangle's points from its middle [m]."""
    x, y = (side * (np.arange(40) + 0.5) / 40 - side / 2 for side in (width, height))
    return float(np.hypot(x[:, None], y).mean())


def _check_joints(obj: ObjectModel, grasp: Grasp, motion: Motion, settings: SimulationSettings) -> None:
    """Check joint torques along the path, from the motion of the arm and the object's weight."""
    model = arm_model()
    data = mujoco.MjData(model)
    limit = model.jnt_actfrcrange[:7, 1]
    hand, tcp = model.body("gripper/base").id, model.site("gripper/tcp").id
    along, across = rotation_2d(-grasp.angle) @ (obj.center_of_mass - grasp.position)
    # In the frame of the hand, whose z axis points down
    lever = np.array([along, -across, settings.grip.tcp_height - obj.shape.height / 2])
    qdd = np.gradient(motion.qd, 1 / settings.rate, axis=0)
    jacobian, inertial, qacc = np.zeros((3, model.nv)), np.zeros(model.nv), np.zeros(model.nv)
    for tick in range(0, len(motion.q), EVERY):
        data.qpos[:7], data.qvel[:7], qacc[:7] = motion.q[tick], motion.qd[tick], qdd[tick]
        mujoco.mj_forward(model, data)
        point = data.site_xpos[tcp] + data.site_xmat[tcp].reshape(3, 3) @ lever
        mujoco.mj_jac(model, data, jacobian, None, point, hand)
        mujoco.mj_mulM(model, data, inertial, qacc)
        needed = np.abs(data.qfrc_bias + inertial + obj.total_mass * GRAVITY * jacobian[2])[:7]
        if (needed > limit).any():
            joint = int((needed / limit).argmax())
            raise InfeasibleTrialError(
                f"torque: joint {joint + 1} would need up to {needed[joint]:.1f} N m of its {limit[joint]:g} N m to "
                f"lift {obj.total_mass:.2f} kg at {grasp.name}; use a lighter object, rock it more gently or take a "
                "block nearer the center of mass"
            )
