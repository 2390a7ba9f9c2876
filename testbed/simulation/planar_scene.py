"""A scene for identification: the object alone, driven in the plane by its measured motion, feet under its particles.

A drive that nothing holds back moves the grasp point along x, y and yaw; a wrist sensor between the drive and the
object feels what that takes. What the gripper carries is put in by motors: its moment tilts the object, its lift pulls
at the mass group between the fingers. Contacts are the bench's, on a harder foundation.
"""

from __future__ import annotations

import mujoco
import numpy as np
from jaxtyping import Float

from testbed.objects import GRAVITY, ObjectModel
from testbed.simulation.object_scene import add_feet, foot_stiffness, set_solver, soften_feet
from testbed.simulation.settings import ContactSettings
from testbed.trial import Support

TIMESTEP = 0.001
"""Physics step, s: at twice it the feet of a light guess shake."""
CONTACT = ContactSettings(sag=1e-4, impedance=1e-3)
"""Of the feet: it settles in a third of the bench's time."""
ARENA = 2**22
"""Of a simulation, bytes: a tenth is used, and the toolbox keeps many at once, each MuJoCo's own 14 MB large."""
DRIVE = 1e6
"""Inertia of the drive, kg and kg m^2: the drag of an object does not slow it down."""
FORCE, TORQUE = "wrist_force", "wrist_torque"
"""Sensors: what the drive does to the object, object axes, about the grasp point."""


def planar_scene(guess: ObjectModel, support: Support, grasp: Float[np.ndarray, "2"]) -> mujoco.MjSpec:
    """The scene, not yet compiled: geoms `cell_<particle>` have the masses, pairs `foot_<particle>` the frictions.

    Args:
        guess: shape, and the masses and frictions that it is first built with.
        support: own weight, or rigid.
        grasp: point that is driven, m, object frame. A contact in MuJoCo leaves out the centripetal acceleration about
            the joints, and where a foot hardly moves that is not small: a turn is best driven from near its centre.
    """
    spec = mujoco.MjSpec()
    spec.memory = ARENA
    set_solver(spec, TIMESTEP, CONTACT)
    spec.option.tolerance = 1e-20  # slopes are differences of 1e-8
    spec.worldbody.add_geom(name="top", type=mujoco.mjtGeom.mjGEOM_PLANE, size=(1, 1, 0.1), contype=0, conaffinity=0)
    add_feet(spec, guess, _add_groups(spec, _add_drive(spec), guess, support, grasp), CONTACT)
    return spec


def compiled(spec: mujoco.MjSpec, guess: ObjectModel) -> mujoco.MjModel:
    """The model of a scene whose masses or frictions may have changed: every foot of the same stiffness again."""
    model = spec.compile()
    feet = np.flatnonzero(guess.shape.friction_group >= 0)
    soften_feet(model, guess, feet, np.array([model.geom(f"foot_{particle}").id for particle in feet]), CONTACT)
    return model


def sinking(guess: ObjectModel, support: Support) -> Float[np.ndarray, "lifts"]:
    """How far each vertical slide of the scene sinks under the weights that are guessed, m."""
    if support.is_rigid:
        return np.array([CONTACT.sag])
    shape = guess.shape
    feet = np.bincount(shape.mass_group[shape.friction_group >= 0], minlength=shape.n_m)
    return guess.group_mass * GRAVITY / feet / foot_stiffness(guess, CONTACT)


def _add_drive(spec: mujoco.MjSpec) -> mujoco.MjsBody:
    """Drive, wrist and tilt; the body that the mass groups hang on, its frame on the table under the grasp point."""
    hand = _weightless(spec.worldbody.add_body(name="hand"))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, kind, axis in (("x", slide, (1, 0, 0)), ("y", slide, (0, 1, 0)), ("yaw", hinge, (0, 0, 1))):
        hand.add_joint(name=name, type=kind, axis=axis, armature=DRIVE)
        _add_motor(spec, name, DRIVE)
    hand.add_site(name="wrist")
    for name, kind in ((FORCE, mujoco.mjtSensor.mjSENS_FORCE), (TORQUE, mujoco.mjtSensor.mjSENS_TORQUE)):
        spec.add_sensor(name=name, type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname="wrist")
    plate = _weightless(hand.add_body(name="plate"))
    for name, axis in (("roll", (1, 0, 0)), ("pitch", (0, 1, 0))):
        plate.add_joint(name=name, type=hinge, axis=axis)
        _add_motor(spec, name)
    return plate


def _add_groups(
    spec: mujoco.MjSpec, plate: mujoco.MjsBody, guess: ObjectModel, support: Support, grasp: np.ndarray
) -> list[mujoco.MjsBody]:
    """The body of each mass group, on a vertical slide of its own; under a rigid body one for all."""
    shape, bodies = guess.shape, []
    for group in range(1 if support.is_rigid else shape.n_m):
        body = plate.add_body(name=f"group_{group}", pos=(*-grasp, shape.height / 2))
        body.add_joint(name=f"lift_{group}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1))
        _add_motor(spec, f"lift_{group}")
        bodies.append(body)
    bodies = bodies * shape.n_m if support.is_rigid else bodies
    for particle, (x, y) in enumerate(shape.particles):
        bodies[shape.mass_group[particle]].add_geom(
            name=f"cell_{particle}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, 0),
            size=(shape.cell / 2, shape.cell / 2, shape.height / 2),
            mass=guess.particle_mass[particle],
            contype=0,
            conaffinity=0,
        )
    return bodies


def _weightless(body: mujoco.MjsBody) -> mujoco.MjsBody:
    """A body of no mass that counts, for joints to be on."""
    body.explicitinertial, body.mass, body.inertia = True, 1e-9, (1e-12,) * 3
    return body


def _add_motor(spec: mujoco.MjSpec, joint: str, gear: float = 1.0) -> None:
    motor = spec.add_actuator(name=joint, target=joint, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gear[0] = gear
