"""Whether an object can be lifted and rocked: asked before anything moves."""

from __future__ import annotations

import math

import mujoco
import numpy as np

from testbed.actions import Lift
from testbed.errors import InfeasibleTrialError
from testbed.frames import rotation_2d
from testbed.gripper import PAD_HEIGHT, PAD_WIDTH
from testbed.objects import GRAVITY, Grasp, ObjectModel
from testbed.simulation.arm import arm_model
from testbed.simulation.motion import Motion
from testbed.simulation.settings import MARGIN, SimulationSettings
from testbed.trial import Trial

FLANGE_PAYLOAD = 4.0
"""What the Gen3 carries at its flange at mid range, kg."""
CLEARANCE = 0.010
"""Least way between table and object while it rocks, m."""
EVERY = 10
"""The joints' torques are looked at once in so many ticks."""


def check_lift(trial: Trial, action: Lift, motion: Motion, settings: SimulationSettings) -> None:
    """Refuse what cannot be lifted.

    Raises:
        InfeasibleTrialError: an object that is not one rigid body, or heavier than the payload, or beyond what the grip
            holds by friction, or that would touch the table, or a joint beyond its working torque.
    """
    obj, grasp = trial.object, trial.object.shape.grasps[action.grasp]
    if not trial.support.is_rigid:
        raise InfeasibleTrialError(
            f"support: on {trial.support.name} the parts hang on vertical slides, and only what is gripped would be "
            "lifted; lift with support rigid"
        )
    payload = FLANGE_PAYLOAD - _below_flange()
    if obj.total_mass > payload:
        raise InfeasibleTrialError(
            f"payload: the object's {obj.total_mass:.3f} kg against {payload:.2f} kg that the arm carries beside "
            "sensor and gripper; use a lighter object"
        )
    reach = np.abs(obj.shape.particles - grasp.position).max(axis=0) + obj.shape.cell / 2
    needed = float(reach.max()) * math.sin(action.tilt) + CLEARANCE
    if needed > action.height:
        raise InfeasibleTrialError(
            f"clearance: tilted by {math.degrees(action.tilt):.1f} deg at {grasp.name} the object needs "
            f"{needed * 1e3:.0f} mm over the table against a lift of {action.height * 1e3:.0f} mm; lift higher, tilt "
            "less or take a block nearer the middle"
        )
    if settings.grip.mode == "friction":
        _check_grip(obj, grasp, action, settings)
    _check_joints(obj, grasp, motion, settings)


def _below_flange() -> float:
    """Mass of sensor and gripper, kg."""
    model = arm_model()
    return float(model.body_mass[model.body("ft/housing").id :].sum())


def _check_grip(obj: ObjectModel, grasp: Grasp, action: Lift, settings: SimulationSettings) -> None:
    """Weight and moments against the pads' friction: an ellipse of force against torsion (Howe and Cutkosky 1996).

    The pads press evenly on the face they meet. The moment across the closing axis makes them carry unlike parts of the
    weight, that about the closing axis twists both.
    """
    grip, weight = settings.grip, obj.total_mass * GRAVITY
    along, across = rotation_2d(-grasp.angle) @ (obj.center_of_mass - grasp.position)
    inertia = obj.inertia_cm + obj.total_mass * (along**2 + across**2)
    top = obj.shape.height if grasp.top is None else grasp.top
    face = min(PAD_WIDTH, grasp.length), min(top, PAD_HEIGHT[1]) - max(grasp.bottom, PAD_HEIGHT[0])
    holds = grip.force * grip.friction
    carried = weight * (0.5 + abs(along) / grasp.width)
    twist = weight * abs(across) + inertia * action.acceleration * (action.tilt > 0)
    twist_held = 2 * holds * _mean_distance(*face)
    used = math.hypot(carried / holds, twist / twist_held)
    if used > MARGIN:
        raise InfeasibleTrialError(
            f"grip: at {grasp.name} the heavier loaded pad would carry {carried:.1f} N and both be twisted by "
            f"{twist:.2f} N m, {100 * used:.0f} % of what a grip of {grip.force:g} N holds ({holds:.0f} N, "
            f"{twist_held:.2f} N m) where {100 * MARGIN:.0f} % may be used; take a block nearer the centre of mass, a "
            "stronger grip (up to 235 N) or a weld"
        )


def _mean_distance(width: float, height: float) -> float:
    """Mean distance of a rectangle's points from its middle, m."""
    x, y = (side * (np.arange(40) + 0.5) / 40 - side / 2 for side in (width, height))
    return float(np.hypot(x[:, None], y).mean())


def _check_joints(obj: ObjectModel, grasp: Grasp, motion: Motion, settings: SimulationSettings) -> None:
    """Torque of every joint along the path: arm in motion, and the object's weight at its centre of mass."""
    model = arm_model()
    data = mujoco.MjData(model)
    limit = model.jnt_actfrcrange[:7, 1]
    hand, tcp = model.body("gripper/base").id, model.site("gripper/tcp").id
    along, across = rotation_2d(-grasp.angle) @ (obj.center_of_mass - grasp.position)
    lever = np.array(
        [along, -across, settings.grip.tcp_height - obj.shape.height / 2]
    )  # in the hand, whose z axis points down
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
                "block nearer the centre of mass"
            )
