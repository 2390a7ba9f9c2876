"""Whether the arm and the gripper can do a trial: asked before anything moves."""

from __future__ import annotations

import mujoco
import numpy as np

from testbed.actions import Lift, Weigh
from testbed.errors import InfeasibleTrialError
from testbed.gripper import PAD_HEIGHT, PAD_WIDTH, STROKE
from testbed.objects import GRAVITY, Grasp
from testbed.profile import Profile
from testbed.simulation.arm import JOINT_SPEED_LIMIT, arm_model
from testbed.simulation.lift_feasibility import check_lift
from testbed.simulation.motion import Motion
from testbed.simulation.resting import resting_loads
from testbed.simulation.settings import MARGIN, SimulationSettings
from testbed.table import EDGES, HIGH, LOW, outline, overhang, overhang_of
from testbed.tool_path import ToolPath
from testbed.trial import Trial

MINIMUM_HEIGHT = 0.010
"""A face from the table up that is lower than this gives the pads too little to hold, m."""


def check_feasible(trial: Trial, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse what the bench cannot do.

    Raises:
        InfeasibleTrialError: too wide or too low to grip, an object that would pass the table's edge, a foot that the
            object's own weight lifts, friction beyond the grip, drag beyond a joint's working torque or speed, or what
            cannot be lifted; the message says by how much and what could be done.
    """
    assert not isinstance(trial.action, Weigh)
    shape = trial.object.shape
    grasp = shape.grasps[trial.action.grasp]
    if grasp.width > STROKE - 0.005:
        raise InfeasibleTrialError(
            f"grip: block {grasp.name} is {grasp.width * 1e3:.0f} mm wide; the gripper opens to "
            f"{STROKE * 1e3:.0f} mm and needs 5 mm of clearance; choose a narrower part"
        )
    top = shape.height if grasp.top is None else grasp.top
    # Below the pads' lower edge a face is of no use; above it, what counts is how much of it they meet
    if top < MINIMUM_HEIGHT + max(grasp.bottom - PAD_HEIGHT[0], 0.0):
        what, needed = f"the object is {top * 1e3:.0f} mm high", f"{MINIMUM_HEIGHT * 1e3:.0f} mm"
        if grasp.bottom > 0:
            what = f"the faces of {grasp.name} are {grasp.bottom * 1e3:.1f} to {top * 1e3:.1f} mm over the table"
            needed = f"{(MINIMUM_HEIGHT - PAD_HEIGHT[0]) * 1e3:.0f} mm of face above that"
        raise InfeasibleTrialError(f"grip: {what}; the pads, 3 mm over the table, need {needed}")
    _check_table(trial, motion, settings)
    _check_rest(trial, settings)
    if isinstance(trial.action, Lift):
        check_lift(trial, trial.action, motion, settings)
    else:
        _check_drag(trial, grasp, motion, settings)
    speed = np.abs(motion.qd) / JOINT_SPEED_LIMIT
    if speed.max() > 1:
        joint = int(speed.max(axis=0).argmax())
        raise InfeasibleTrialError(
            f"speed: joint {joint + 1} would need {speed.max():.2f} of its limit of "
            f"{np.degrees(JOINT_SPEED_LIMIT[joint]):.0f} deg/s; move slower"
        )


def _check_table(trial: Trial, motion: Motion, settings: SimulationSettings) -> None:
    """All of the object stays over the table, where it lies at first and wherever it is moved.

    Nothing in the scene happens at the edge: the plane that feet touch has no end.
    """
    action, shape = trial.action, trial.object.shape
    assert not isinstance(action, Weigh)
    x, y, yaw = motion.object_pose
    if isinstance(action, Lift):
        still = (np.zeros((1, 2)), np.array([[x, y]]), np.array([yaw]), np.zeros(1), np.zeros((1, 2)))
        beyond = overhang(outline(shape), *still)[0]
    else:
        length = Profile.of(action, 1 / settings.rate).length
        beyond = overhang_of(shape, ToolPath.from_object(action, shape, length, motion.object_pose))
    worst = int(beyond.argmax())
    if beyond[worst] > 1e-9:
        raise InfeasibleTrialError(
            f"table: the object's outline would pass the table's {EDGES[worst]} edge by {beyond[worst] * 1e3:.0f} mm; "
            f"all of it must stay within x {LOW[0]:.2f} to {HIGH[0]:.2f} m and y {LOW[1]:.2f} to {HIGH[1]:.2f} m; take "
            "a shorter way, a turn about a point nearer the object, or a block nearer its middle"
        )


def _check_drag(trial: Trial, grasp: Grasp, motion: Motion, settings: SimulationSettings) -> None:
    """Friction under the object against what grip and joints can push."""
    obj, shape = trial.object, trial.object.shape
    friction = np.where(shape.friction_group >= 0, obj.truth.friction[np.maximum(shape.friction_group, 0)], 0.0)
    feet = np.bincount(shape.mass_group[shape.friction_group >= 0], minlength=shape.n_m)
    load = friction * (obj.group_mass / np.maximum(feet, 1))[shape.mass_group] * GRAVITY  # a group's feet carry it all
    drag = float(load.sum())
    torque = float(load @ np.linalg.norm(shape.particles - grasp.position, axis=1))
    grip = settings.grip
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


def _check_rest(trial: Trial, settings: SimulationSettings) -> None:
    """No foot may have to pull: a lifted foot ends the laws by which loads are known."""
    shape = trial.object.shape
    loads = resting_loads(trial.object, trial.support, settings.contact)
    feet = np.flatnonzero(shape.friction_group >= 0)
    worst = feet[loads[feet].argmin()]
    if loads[worst] < -1e-9 * loads[feet].mean():
        x, y = (round(v) for v in shape.particles[worst] * 1e3)
        raise InfeasibleTrialError(
            f"rest: on {trial.support.name} the foot of {shape.group_names[shape.mass_group[worst]]} at ({x}, "
            f"{y}) mm would carry {loads[worst]:.3f} N, that is lift, with {loads[feet].mean():.3f} N on the mean "
            f"foot; {int((loads[feet] < 0).sum())} of {len(feet)} feet lift; give the object feet nearer under its "
            "centre of mass" + ("" if trial.support.is_rigid else ", or use a stiffer support, as rigid")
        )


def _check_torques(motion: Motion, drag: float, torque: float) -> None:
    """Static joint torques at the ends and the middle of the path, with the drag in the worst direction."""
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
