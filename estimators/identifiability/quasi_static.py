"""Quasi-static pushes: motion of an object whose Coulomb friction balances the force of a fingertip."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from testbed.actions.path import RAMP_TIME
from testbed.actions.push import Push
from testbed.frames import cross_2d, perpendicular, rotation_2d
from testbed.objects.model import ObjectShape

_MOST_STEPS = 100


class PushedMotion(NamedTuple):
    """Motion of an object from the origin, at N times after the first contact of the fingertip; world axes."""

    time_s: Float[np.ndarray, "N"]
    """Time since the fingertip met it [s]."""
    poses: Float[np.ndarray, "N 3"]
    """Pose of its frame [m, m, rad]."""
    twists: Float[np.ndarray, "N 3"]
    """Rates of the pose [m/s, m/s, rad/s]."""
    places: Float[np.ndarray, "N 2"]
    """Center of the fingertip [m]."""


@dataclass(frozen=True, eq=False)
class Drag:
    """Coulomb friction under an object that moves in the plane."""

    particles: Float[np.ndarray, "P 2"]
    """Positions [m], object frame."""
    friction: Float[np.ndarray, "P"]
    """Greatest friction of each [N]."""
    tolerance: float = 1e-15
    """Tolerance of the angles of a motion [rad]."""

    def wrench(
        self, twist: Float[np.ndarray, "... 3"], point: Float[np.ndarray, "... 2"]
    ) -> Float[np.ndarray, "... 3"]:
        """Force and torque about `point` [N, N m] for its twist [m/s, rad/s], object axes."""
        x, y = (self.particles[:, axis] - np.asarray(point)[..., axis, None] for axis in (0, 1))
        along_x, along_y = self._forces(x, y, twist)
        return np.stack([each.sum(axis=-1) for each in (along_x, along_y, x * along_y - y * along_x)], -1)

    def _forces(self, x: np.ndarray, y: np.ndarray, twist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Force along each axis on every particle at x, y [m] from the point that moves at a twist [N]."""
        u, v = twist[..., 0, None] - twist[..., 2, None] * y, twist[..., 1, None] + twist[..., 2, None] * x
        speed = np.hypot(u, v)
        share = np.divide(self.friction, speed, out=np.zeros_like(speed), where=speed > 1e-12)
        return share * u, share * v

    def pushed(
        self,
        point: Float[np.ndarray, "C 2"],
        velocity: Float[np.ndarray, "C 2"],
        normal: Float[np.ndarray, "C 2"],
        mu: Float[np.ndarray, "C"],
    ) -> Float[np.ndarray, "C 3"]:
        """Twists of the contact points of C pushes [m/s, rad/s], object axes.

        A contact sticks, or slides along the face at the edge of the cone of friction.

        Args:
            point: contacts [m], object frame.
            velocity: velocities of the fingertips [m/s].
            normal: unit vectors into the faces.
            mu: friction of each fingertip against its face.
        """
        into, across = (velocity * normal).sum(axis=1), cross_2d(normal, velocity)
        begun = np.arctan2(across, into)
        found, slope = self._turning(point, normal, begun)
        cone = np.arctan(mu)
        slides = np.flatnonzero(np.abs(slope) > cone)
        if len(slides):
            at, inwards = point[slides], normal[slides]
            edge = np.copysign(cone, slope)[slides]
            # the limit surface is convex, so the force turns in the same sense as the velocity of the contact
            far = -np.copysign(math.pi / 2, edge)
            way = _roots(
                lambda way, each: self._turning(at[each], inwards[each], way)[1] - edge[each],
                *(begun[slides], far, self.tolerance),
            )
            found[slides] = self._turning(at, inwards, way)[0]
        return found * into[:, None]

    def _turning(
        self, point: np.ndarray, normal: np.ndarray, way: np.ndarray
    ) -> tuple[Float[np.ndarray, "C 3"], Float[np.ndarray, "C"]]:
        """Twists without moment about contacts, and the angles of the forces to the normals [rad].

        A contact's velocity has the angle `way` [rad] to its normal, and 1 m/s along it.
        """
        cos, sin = np.cos(way)[:, None], np.sin(way)[:, None]
        heading = cos * normal + sin * perpendicular(normal)
        x, y = (self.particles[:, axis] - point[:, axis, None] for axis in (0, 1))
        size = np.maximum(np.abs(x), np.abs(y)).max(axis=1)

        def twist(turn: np.ndarray, each: np.ndarray) -> np.ndarray:
            return np.column_stack([np.cos(turn)[:, None] * heading[each], np.sin(turn) / size[each]])

        def moment(turn: np.ndarray, each: np.ndarray) -> np.ndarray:
            arm_x, arm_y = x[each], y[each]
            along_x, along_y = self._forces(arm_x, arm_y, twist(turn, each))
            return (arm_x * along_y - arm_y * along_x).sum(axis=1)  # most calls need the moment alone

        quarter = np.full(len(way), math.pi / 2)
        still = twist(_roots(moment, -quarter, quarter, self.tolerance), np.arange(len(way)))
        force = self.wrench(still, point)[:, :2]
        into = np.maximum((still[:, :2] * normal).sum(axis=1, keepdims=True), 1e-300)
        return still / into, np.arctan2(cross_2d(normal, force), (force * normal).sum(axis=1))

    def motion(self, shape: ObjectShape, pushes: Sequence[Push], step: float) -> list[PushedMotion]:
        """Motions under pushes, each of the object at the origin, sampled every `step` s.

        A motion ends where the path slows down, or where the fingertip reaches the end of the face.
        """
        lengths = [p.length - p.speed * RAMP_TIME / 2 for p in pushes]
        ways = [
            p.path(shape, p.gap + np.arange(0.0, way, p.speed * step)) for p, way in zip(pushes, lengths, strict=True)
        ]
        sides = [p.face(shape) for p in pushes]
        normal = np.array([side.normal for side in sides])
        begin, length = np.array([side.begin for side in sides]), np.array([side.length for side in sides])
        along = np.array([(side.end - side.begin) / side.length for side in sides])
        radius, mu = (np.array([getattr(p, name) for p in pushes]) for name in ("radius", "friction"))
        tips = np.array([np.pad(way, ((0, max(map(len, ways)) - len(way)), (0, 0)), mode="edge") for way in ways])
        samples = np.array([len(way) for way in ways])

        def rates(each: np.ndarray, pose: np.ndarray, tip: np.ndarray, velocity: np.ndarray) -> np.ndarray:
            """Velocities of the object's frame, world axes."""
            into = rotation_2d(-pose[:, 2])
            contact = np.einsum("cij,cj->ci", into, tip - pose[:, :2]) - radius[each, None] * normal[each]
            driven = np.einsum("cij,cj->ci", into, velocity)
            twist = self.pushed(contact, driven, -normal[each], mu[each])
            origin = twist[:, :2] - twist[:, 2:] * perpendicular(contact)
            return np.column_stack([np.einsum("cji,cj->ci", into, origin), twist[:, 2]])

        pose, each = np.zeros((len(pushes), 3)), np.arange(len(pushes))
        found: list[list[tuple[np.ndarray, np.ndarray, np.ndarray]]] = [[] for _ in pushes]
        for sample in range(tips.shape[1] - 1):
            tip, ahead = tips[:, sample], tips[:, sample + 1]
            place = np.einsum("cij,cj->ci", rotation_2d(-pose[each, 2]), tip[each] - pose[each, :2])
            on = ((place - begin[each]) * along[each]).sum(axis=1)
            each = each[(on > 0) & (on < length[each]) & (samples[each] > sample + 1)]
            if not len(each):
                break
            velocity = (ahead - tip)[each] / step
            now = rates(each, pose[each], tip[each], velocity)
            for index, rate in zip(each, now, strict=True):
                found[index].append((pose[index].copy(), rate, tip[index]))
            middle = pose[each] + now * step / 2
            pose[each] += step * rates(each, middle, (tip + ahead)[each] / 2, velocity)
        return [_motion(rows, step) for rows in found]


def _motion(rows: list[tuple[np.ndarray, np.ndarray, np.ndarray]], step: float) -> PushedMotion:
    poses, twists, places = (np.array([row[k] for row in rows]).reshape(-1, n) for k, n in enumerate((3, 3, 2)))
    return PushedMotion(step * np.arange(len(rows)), poses, twists, places)


def _roots(
    function: Callable[[np.ndarray, np.ndarray], np.ndarray], low: np.ndarray, high: np.ndarray, tolerance: float
) -> np.ndarray:
    """Roots of functions of (values, indices) between bounds at which each differs in sign, by false position."""
    found, each = high.copy(), np.arange(len(high))
    at_low, at_high = function(low, each), function(high, each)
    for _ in range(_MOST_STEPS):
        rise = at_high - at_low
        middle = high - np.divide(at_high * (high - low), rise, out=np.zeros_like(high), where=rise != 0)
        found[each] = middle
        open_ = np.abs(middle - high) > tolerance
        if not open_.any():
            break
        if not open_.all():
            each, low, high, middle, at_low, at_high = (v[open_] for v in (each, low, high, middle, at_low, at_high))
        value = function(middle, each)
        across = value * at_high < 0
        low, at_low = np.where(across, high, low), np.where(across, at_high, at_low / 2)  # Illinois
        high, at_high = middle, value
    return found
