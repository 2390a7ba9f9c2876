"""Quasi-static pushes of known objects: the fingertip's force balances Coulomb friction, and nothing accelerates.

The object's motion is what the balance leaves: a point that the fingertip drives, and no moment about its contact. The
record has the object's true poses as a camera's stream, and the force of its drag at the fingertip.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from estimators.identifiability.quasi_static import Drag
from estimators.testing.analytic_world import HEIGHT, RATE, own_weight_loads, record
from testbed.actions.push import Push
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.model import ObjectModel
from testbed.sensing.camera import PoseStream
from testbed.trajectory import Phase, Trajectory


def drag_of(obj: ObjectModel) -> Drag:
    """Drag of an object each of whose groups rests on its own weight."""
    shape = obj.shape
    friction = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0)
    return Drag(shape.particles, friction * own_weight_loads(obj))


def analytic_push(obj: ObjectModel, action: Push) -> Trajectory:
    """Record of a push of an object that lies at the origin as the fingertip meets it.

    It ends where the path slows down, or where the fingertip comes to the end of the face.

    Args:
        obj: the object, truth included; every group rests on its own weight.
        action: the push.
    """
    motion = drag_of(obj).motion(obj.shape, [action], 1 / RATE)[0]
    accelerations = np.gradient(motion.twists, 1 / RATE, axis=0, edge_order=2)
    return _record(obj, action, motion.poses, motion.twists, accelerations, motion.places)


def steady_pushes(obj: ObjectModel, centers: Float[np.ndarray, "K 2"], *, seconds: float = 0.8) -> list[Trajectory]:
    """Records of pushes in each of which the object turns about one center, at 0.3 rad/s.

    The fingertip goes with the object on the drag's line of action, where it has no moment, on the outline or not.

    Args:
        obj: the object, truth included; every group rests on its own weight.
        centers: centers of rotation [m], object frame.
        seconds: time in contact [s].
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
    obj: ObjectModel,
    action: Push,
    poses: np.ndarray,
    twists: np.ndarray,
    accelerations: np.ndarray,
    places: np.ndarray,
) -> Trajectory:
    """Record of a motion in contact: poses of the object and its rates, world, and places of the fingertip."""
    drag, count, none = drag_of(obj), len(poses), np.zeros((len(poses), 2))
    planar, moment = np.zeros((count, 3)), np.zeros((count, 2))
    for index, (pose, twist, acceleration, place) in enumerate(zip(poses, twists, accelerations, places, strict=True)):
        turn, spin = rotation_2d(pose[2]), twist[2]
        point = turn.T @ (place - pose[:2])
        wrench = drag.wrench(np.array([*(turn.T @ twist[:2] + spin * perpendicular(point)), spin]), point)
        com = obj.center_of_mass
        pull = obj.total_mass * (turn.T @ acceleration[:2] + acceleration[2] * perpendicular(com) - spin**2 * com)
        wrench += [*pull, obj.inertia_cm * acceleration[2] + cross_2d(com - point, pull)]
        planar[index] = [*(turn @ wrench[:2]), wrench[2]]
        moment[index] = turn @ (obj.shape.height / 2 * pull)
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
