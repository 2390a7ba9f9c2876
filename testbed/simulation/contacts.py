"""Contacts of feet with the table, their loads at rest, and contacts of a fingertip with the faces of an object."""

from __future__ import annotations

import math
from collections.abc import Sequence
from copy import copy

import mujoco
import numpy as np
from jaxtyping import Float

from testbed.actions.base import Fingertip
from testbed.objects.faces import faces
from testbed.objects.model import GRAVITY, ObjectModel, ObjectShape
from testbed.simulation.settings import ContactSettings, GripSettings
from testbed.trial import Support
from testbed.worlds.feet import Feet

_TIP_DAMPING = 20.0
"""Rate at which a fingertip's friction opposes slip [1/s]. As under a foot, slip causes lift; at a large rate it makes
the fingertip bounce along its face."""
_THIN = 2.5e-4
"""Half the depth of a thin face's box [m]."""
UNSEEN = {"mass": 0, "group": 4, "contype": 0, "conaffinity": 0}
_MOTION_SENSORS = {
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "orientation": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    "velocity": mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    "angular_velocity": mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
}


def resting_loads(obj: ObjectModel, support: Support, contact: ContactSettings) -> Float[np.ndarray, "P"]:
    """Load on every particle at rest [N], shape (P,); 0 without contact, negative where a foot would have to pull.

    The foundation has even stiffness. All groups share one tilt; each has a height of its own (own weight), a height
    joined to its neighbors' by springs, or the common height (rigid). A group's weight acts at its center of mass.
    """
    feet, loads = Feet.of(obj), np.zeros(len(obj.shape.particles))
    loads[feet.particle] = _at_rest(obj, support, contact, feet, obj.shape)[1] * _stiffness(obj, feet, contact)
    return loads


def lay_level(
    spec: mujoco.MjSpec, obj: ObjectModel, support: Support, contact: ContactSettings, feet: Feet, joined: ObjectShape
) -> None:
    """Set contact margins and spring lengths such that the object lies level at rest.

    A contact in MuJoCo acts halfway between the two surfaces: lower under a heavy group than under a light one. The
    margin of each contact therefore equals the depth by which its foot sinks at rest, so that the foot stays at the
    height of the table. For links, which turn and share a tilt, it equals the mean depth of the group.

    Args:
        spec: scene with feet, and with springs between groups.
        obj: the object.
        support: support of its weight.
        contact: softness of the foundation.
        feet: points of contact.
        joined: shape whose groups touch where springs join them.
    """
    height, sink = _at_rest(obj, support, contact, feet, joined)
    if obj.shape.chain is not None:
        group = obj.shape.mass_group[feet.particle]
        sink = (np.bincount(group, sink) / np.bincount(group))[group]
    for index, depth in enumerate(sink):
        spec.pair(f"foot_{index}").margin = max(depth, 0.0)
        spec.geom(f"foot_{index}").pos[2] -= min(depth, 0.0)
    if support.stiffness > 0 and not support.is_rigid:
        for a, b in joined.neighbors:
            spec.tendon(f"spring_{a}_{b}").springlength = [height[a] - height[b]] * 2


def _at_rest(
    obj: ObjectModel, support: Support, contact: ContactSettings, feet: Feet, joined: ObjectShape
) -> tuple[Float[np.ndarray, "G"], Float[np.ndarray, "F"]]:
    """Depths by which each group sinks at the middle of all feet, and each foot [m]; negative where a foot would pull.

    Arguments as for `lay_level`; a rigid body is one group.
    """
    group = np.zeros(len(feet.particle), dtype=int) if support.is_rigid else obj.shape.mass_group[feet.particle]
    groups = 1 if support.is_rigid else obj.shape.n_m
    middle = feet.position.mean(axis=0)
    length = float(np.abs(feet.position - middle).max()) or 1.0  # tilts in the unit of depths
    design = np.column_stack([np.eye(groups)[group], (feet.position - middle) / length])
    matrix = design.T @ (_stiffness(obj, feet, contact)[:, None] * design)
    if not support.is_rigid:
        for a, b in joined.neighbors:
            matrix[[a, b], [a, b]] += support.stiffness
            matrix[[a, b], [b, a]] -= support.stiffness
    weight = [obj.total_mass * GRAVITY] if support.is_rigid else obj.group_mass * GRAVITY
    loads = np.append(weight, obj.total_mass * GRAVITY * (obj.center_of_mass - middle) / length)
    # A straight row of feet does not determine the tilt across it: in the least-norm solution it is 0
    solution = np.linalg.lstsq(matrix, loads, rcond=1e-12)[0]
    return solution[:groups], design @ solution


def _stiffness(obj: ObjectModel, feet: Feet, contact: ContactSettings) -> Float[np.ndarray, "F"]:
    """Stiffness of each foot [N/m]."""
    return feet.stiffness * foot_stiffness(obj, contact)


def add_feet(
    spec: mujoco.MjSpec,
    obj: ObjectModel,
    frames: Sequence[mujoco.MjsBody | mujoco.MjsFrame],
    contact: ContactSettings,
    feet: Feet,
) -> None:
    """Add feet to the frames of their mass groups, and their contacts: geoms and pairs `foot_<index>`."""
    shape = obj.shape
    for index, particle in enumerate(feet.particle.tolist()):
        x, y = feet.position[index]
        along_x, along_y = feet.friction[index]
        frames[int(shape.mass_group[particle])].add_geom(
            name=f"foot_{index}",
            type=mujoco.mjtGeom.mjGEOM_SPHERE,
            size=(contact.foot_radius, 0, 0),
            mass=0,
            group=3,
            pos=(x, y, contact.foot_radius - shape.height / 2 - feet.height[index]),
            contype=0,
            conaffinity=0,
            rgba=(0.2, 0.2, 0.2, 1),
        )
        spec.add_pair(
            name=f"foot_{index}",
            geomname1=f"foot_{index}",
            geomname2="top",
            condim=3,
            friction=[along_y, along_x, 0, 0, 0],  # on a level top, the first tangent of a contact is along y
        )


def foot_stiffness(obj: ObjectModel, contact: ContactSettings) -> float:
    """Nominal stiffness of a foot [N/m], at which the object sinks by `sag` under its own weight."""
    return obj.total_mass * GRAVITY / int((obj.shape.friction_group >= 0).sum()) / contact.sag


def soften_feet(model: mujoco.MjModel, obj: ObjectModel, feet: Feet, contact: ContactSettings) -> np.ndarray:
    """Set the stiffness and damping of each foot's contact; returns the geom ids of the feet, shape (n_feet,).

    MuJoCo's stiffness is per unit of effective mass, which only the compiled model knows: a static contact with
    impedance d carries f = k r d / ((1 - d) A), with k in 1/s^2 and A the inverse effective mass.
    """
    d = contact.impedance
    geoms = np.array([model.geom(f"foot_{index}").id for index in range(len(feet.particle))])
    newtons_per_metre = _stiffness(obj, feet, contact)
    for index, inverse_mass in enumerate(_inverse_masses(model, geoms, d)):
        stiffness = newtons_per_metre[index] * (1 - d) * inverse_mass / d
        pair = model.pair(f"foot_{index}")
        pair.solref[:] = -stiffness * d, -2 * math.sqrt(stiffness) * d
        pair.solimp[:2] = d
        model.pair_solreffriction[pair.id] = -1e-6, -contact.friction_damping * d
    return geoms


def _inverse_masses(model: mujoco.MjModel, geoms: np.ndarray, impedance: float) -> np.ndarray:
    """Inverse effective mass of each foot [1/kg], shape (n_feet,)."""
    inverse = model.body_invweight0[model.geom_bodyid[geoms], 0].copy()
    slides = [j for j in range(model.njnt) if model.joint(j).name.startswith("slide_")]
    if not any(model.tendon(t).name.startswith("spring_") for t in range(model.ntendon)):
        return inverse
    # A spring adds to the effective mass in a step: read it from the contacts, at a negligible stiffness
    soft, data = copy(model), mujoco.MjData(model)
    for index in range(len(geoms)):
        pair = soft.pair(f"foot_{index}")
        pair.solref[:], pair.solimp[:2] = (-1e-12, -1e-12), impedance
    data.qpos[soft.jnt_qposadr[slides]] = -1e-9 * np.arange(1, len(slides) + 1)
    mujoco.mj_forward(soft, data)
    for touch in data.contact:
        inverse[np.isin(geoms, touch.geom)] = data.efc_R[touch.efc_address] * impedance / (1 - impedance)
    return inverse


def add_tip(spec: mujoco.MjSpec, tip: Fingertip, tcp_height: float) -> None:
    """Add a round fingertip on a peg below the TCP, without contacts.

    Args:
        spec: scene with arm.
        tip: fingertip: a ball, or a disc if the radius is at least the height.
        tcp_height: height of the TCP over the table [m].
    """
    x, y, z = spec.site("gripper/tcp").pos
    radius, _, height = tip
    below = z + tcp_height - height
    visible = UNSEEN | {"group": 2, "rgba": (0.9, 0.2, 0.1, 1.0)}
    hand, ball, peg = spec.body("gripper/base"), mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CYLINDER
    low = radius >= height
    hand.add_geom(name="fingertip", type=ball, pos=(x, y, below), size=(radius, 0, 0), **(UNSEEN if low else visible))
    hand.add_geom(name="peg", type=peg, fromto=(x, y, z, x, y, below), size=(radius / 2, 0, 0), **visible)
    if low:
        hand.add_geom(name="disc", type=peg, pos=(x, y, below), size=(radius, height / 2, 0), **visible)


def add_fingertip(
    spec: mujoco.MjSpec, shape: ObjectShape, frames: list[mujoco.MjsFrame], tip: Fingertip, grip: GripSettings
) -> None:
    """Add a round fingertip on a peg below the TCP, a box behind each face, contacts, and sensors of the motion.

    The box of a face is as deep as a cell, so that a face has no seams; if the outline is not that of the cells, it is
    thin, for sharp corners. Contacts are those of a ball; for a low object the ball is hidden, and a disc is drawn.

    Args:
        spec: scene with arm and object.
        shape: geometry of the object.
        frames: frame of every mass group, at the object's middle.
        tip: radius, friction and height of the fingertip.
        grip: height of the TCP, and damping of a contact.
    """
    add_tip(spec, tip, grip.tcp_height)
    depth = shape.cell / 2 if not len(shape.sides) else _THIN
    for index, face in enumerate(faces(shape)):
        x, y = (face.begin + face.end) / 2 - face.normal * depth
        angle = math.atan2(face.normal[1], face.normal[0])
        frames[face.group].add_geom(
            name=f"face_{index}",
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, 0),
            quat=(math.cos(angle / 2), 0, 0, math.sin(angle / 2)),
            size=(depth, face.length / 2, shape.height / 2),
            **UNSEEN,
        )
        spec.add_pair(
            geomname1="fingertip",
            geomname2=f"face_{index}",
            condim=3,
            friction=[tip.friction, tip.friction, 0, 0, 0],
            solref=(0.004, grip.pad_damping),
            solreffriction=(-1e-6, -_TIP_DAMPING),
            solimp=[0.95, 0.99, 0.001, 0.5, 2],
        )
    for name, kind in _MOTION_SENSORS.items():
        spec.add_sensor(name=f"object/{name}", type=kind, objtype=mujoco.mjtObj.mjOBJ_XBODY, objname="object")
