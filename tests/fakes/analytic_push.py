"""Quasi-static pushes of known objects: the fingertip's force balances Coulomb friction, and nothing accelerates.

The object's motion is what the balance leaves: a point that the fingertip drives, and no moment about its contact. The
record has the object's true poses as a camera's stream, and the force of its drag at the fingertip.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from estimators.identifiability.quasi_static import Drag
from estimators.testing.analytic_world import HEIGHT, RATE, own_weight_loads, record
from testbed import ObjectModel, Phase, Push, Trajectory
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.sensing.camera import PoseStream


def drag_of(obj: ObjectModel) -> Drag:
    """Drag of an object each of whose groups rests on its own weight."""
    shape = obj.shape
    friction = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0)
    return Drag(shape.particles, friction * own_weight_loads(obj))


def analytic_pushes(obj: ObjectModel, actions: Sequence[Push]) -> list[Trajectory]:
    """Records of pushes, each of an object that lies at the origin as the fingertip meets it, on its own weight.

    One ends where the path slows down, or where the fingertip comes to the end of the face.
    """
    return [
        _record(
            *(obj, action, motion.poses, motion.twists),
            np.gradient(motion.twists, 1 / RATE, axis=0, edge_order=2),
            motion.places,
        )
        for action, motion in zip(actions, drag_of(obj).motion(obj.shape, actions, 1 / RATE), strict=True)
    ]


def steady_pushes(obj: ObjectModel, centers: Float[np.ndarray, "K 2"], *, seconds: float = 0.8) -> list[Trajectory]:
    """Records of pushes in each of which the object turns about one center [m], object frame, at 0.3 rad/s.

    The fingertip goes with the object on the drag's line of action, where it has no moment, on the outline or not.
    """
    drag, spin, found = drag_of(obj), 0.3, []
    yaw = spin * np.arange(round(seconds * RATE)) / RATE
    turn = rotation_2d(yaw)
    for center in np.asarray(centers, dtype=float):
        *force, torque = drag.wrench(np.array([*(-spin * perpendicular(center)), spin]), np.zeros(2))
        point = -torque * perpendicular(np.array(force)) / np.square(force).sum()
        arms = turn @ center
        poses = np.column_stack([center - arms, yaw])
        twists = np.column_stack([-spin * perpendicular(arms), np.full(len(yaw), spin)])
        accelerations = np.column_stack([spin**2 * arms, np.zeros(len(yaw))])
        places = center + turn @ (point - center)
        found.append(_record(obj, Push((0.0, 0.0), 0.0), poses, twists, accelerations, places))
    return found


def _record(
    obj: ObjectModel, action: Push, poses: np.ndarray, twists: np.ndarray, accelerations: np.ndarray, places: np.ndarray
) -> Trajectory:
    """Record of a motion in contact: poses of the object and its rates, world, and places of the fingertip."""
    count, none, com, spin = len(poses), np.zeros((len(poses), 2)), obj.center_of_mass, twists[:, 2]
    turn = rotation_2d(poses[:, 2])
    into = turn.transpose(0, 2, 1)
    point = np.einsum("nij,nj->ni", into, places - poses[:, :2])
    contact = np.einsum("nij,nj->ni", into, twists[:, :2]) + spin[:, None] * perpendicular(point)
    about_com = accelerations[:, 2, None] * perpendicular(com) - spin[:, None] ** 2 * com
    pull = obj.total_mass * (np.einsum("nij,nj->ni", into, accelerations[:, :2]) + about_com)
    wrench = drag_of(obj).wrench(np.column_stack([contact, spin]), point)
    wrench += np.column_stack([pull, obj.inertia_cm * accelerations[:, 2] + cross_2d(com - point, pull)])
    planar = np.column_stack([np.einsum("nij,nj->ni", turn, wrench[:, :2]), wrench[:, 2]])
    moment = obj.shape.height / 2 * np.einsum("nij,nj->ni", turn, pull)
    # nothing tilts but the pull on the mass over the feet
    tilt = np.column_stack([HEIGHT * planar[:, 1] - moment[:, 1], moment[:, 0] - HEIGHT * planar[:, 0]])
    time = np.arange(count) / RATE
    return record(
        count,
        tare=0,
        action=action,
        time_s=time,
        phase=np.full(count, Phase.STEADY),
        segment=np.zeros(count, dtype=int),
        object_pose=poses,
        object_velocity=twists,
        tcp_position=np.column_stack([places, np.full(count, HEIGHT)]),
        tcp_velocity=np.column_stack([np.gradient(places, time, axis=0), none, none]),
        wrench_on_object_world=np.column_stack([planar[:, :2], none[:, 0], tilt, planar[:, 2]]),
        camera=PoseStream(time, poses[:, None]),
    )
