"""Quasi-static pushes of known objects: the fingertip's force balances Coulomb friction, and nothing accelerates.

The object's motion is what the balance leaves: a point that the fingertip drives, and no moment about its contact. The
record has the object's true poses as a camera's stream, and the force of its drag at the fingertip.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Float
from scipy.optimize import brentq

from estimators.testing.analytic_world import HEIGHT, RATE, own_weight_loads, record
from testbed.actions.push import GAP, Push
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.model import ObjectModel
from testbed.sensing.camera import PoseStream
from testbed.trajectory import Phase, Trajectory


@dataclass(frozen=True, eq=False)
class Drag:
    """Coulomb friction under an object that moves in the plane."""

    particles: Float[np.ndarray, "P 2"]
    """Positions [m], object frame."""
    friction: Float[np.ndarray, "P"]
    """Greatest friction of each [N]."""

    @staticmethod
    def of(obj: ObjectModel) -> Drag:
        """Drag of an object each of whose groups rests on its own weight."""
        shape = obj.shape
        friction = np.where(shape.friction_group >= 0, obj.truth.friction[shape.friction_group], 0.0)
        return Drag(shape.particles, friction * own_weight_loads(obj))

    def wrench(self, twist: Float[np.ndarray, "3"], point: Float[np.ndarray, "2"]) -> Float[np.ndarray, "3"]:
        """Force and torque about a point [N, N m] that move it at a twist of that point [m/s, rad/s], object axes."""
        lever = self.particles - point
        velocity = twist[:2] + twist[2] * perpendicular(lever)
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        force = self.friction[:, None] * np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed > 1e-12)
        return np.array([*force.sum(axis=0), cross_2d(lever, force).sum()])

    def pushed(
        self, point: Float[np.ndarray, "2"], velocity: Float[np.ndarray, "2"], normal: Float[np.ndarray, "2"], mu: float
    ) -> Float[np.ndarray, "3"]:
        """Twist of a contact point [m/s, rad/s] that a fingertip drives, object axes.

        It sticks, or slides along the face at the edge of the cone of friction.

        Args:
            point: contact [m], object frame.
            velocity: velocity of the fingertip [m/s].
            normal: unit vector into the face.
            mu: friction of the fingertip against the face.
        """
        speed = float(np.linalg.norm(velocity))
        along = perpendicular(normal)

        def turning(driven: np.ndarray) -> np.ndarray:
            """Twist without a moment about the contact; friction opposes a turn, so there is one."""
            most = 100 * speed / float(np.abs(self.particles - point).max())
            spin = brentq(lambda w: self.wrench(np.array([*driven, w]), point)[2], -most, most, xtol=1e-15)
            return np.array([*driven, spin])

        def slope(twist: np.ndarray) -> float:
            force = self.wrench(twist, point)[:2]
            return math.atan2(force @ along, force @ normal)

        sticks = turning(velocity)
        cone = math.atan(mu)
        if abs(slope(sticks)) <= cone:
            return sticks
        edge = math.copysign(cone, slope(sticks))
        into, aside = float(velocity @ normal), float(velocity @ along)

        def off(slid: float) -> float:
            return slope(turning(into * normal + slid * along)) - edge

        # less of a force along the face goes with less of a motion along it
        way = -math.copysign(1.0, edge) * speed
        far = next(f for f in (1.0, 2.0, 4.0, 8.0, 16.0, 32.0) if off(aside + f * way) * edge < 0)
        slid = np.asarray(brentq(off, aside, aside + far * way, xtol=1e-15))
        return turning(into * normal + slid * along)


def analytic_push(obj: ObjectModel, action: Push, *, mu: float = 0.4) -> Trajectory:
    """Record of a push of an object that lies at the origin as the fingertip meets it.

    It ends where the fingertip comes to the end of the face.

    Args:
        obj: the object, truth included; every group rests on its own weight.
        action: the push.
        mu: friction of the fingertip against the face.
    """
    drag, face, dt = Drag.of(obj), action.face(obj.shape), 1 / RATE
    along = (face.end - face.begin) / face.length
    tips = action.path(obj.shape, GAP + np.arange(0.0, action.length, action.speed * dt))
    pose, found = np.zeros(3), []

    def rate(pose: np.ndarray, tip: np.ndarray, velocity: np.ndarray) -> np.ndarray:
        """Velocity of the object's frame, world axes."""
        turn = rotation_2d(pose[2])
        contact = turn.T @ (tip - pose[:2]) - action.radius * face.normal
        twist = drag.pushed(contact, turn.T @ velocity, -face.normal, mu)
        return np.array([*(turn @ (twist[:2] - twist[2] * perpendicular(contact))), twist[2]])

    for tip, ahead in pairwise(tips):
        if not 0 < (rotation_2d(-pose[2]) @ (tip - pose[:2]) - face.begin) @ along < face.length:
            break
        velocity = (ahead - tip) / dt
        now = rate(pose, tip, velocity)
        found.append((pose, now, tip))
        pose = pose + dt * rate(pose + now * dt / 2, (tip + ahead) / 2, velocity)
    poses, twists, places = (np.array(part) for part in zip(*found, strict=True))
    return _record(obj, action, poses, twists, np.gradient(twists, dt, axis=0, edge_order=2), places)


def steady_pushes(obj: ObjectModel, centers: Float[np.ndarray, "K 2"], *, seconds: float = 0.8) -> list[Trajectory]:
    """Records of pushes in each of which the object turns about one center, at 0.3 rad/s.

    The fingertip goes with the object on the drag's line of action, where it has no moment, on the outline or not.

    Args:
        obj: the object, truth included; every group rests on its own weight.
        centers: centers of rotation [m], object frame.
        seconds: time in contact [s].
    """
    drag, spin, found = Drag.of(obj), 0.3, []
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
    drag, count, none = Drag.of(obj), len(poses), np.zeros((len(poses), 2))
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
