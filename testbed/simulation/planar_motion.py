"""Steady stretches of a motion as a planar scene is driven through them: measured motion in, measured wrench beside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from jaxtyping import Bool, Float, Int

from testbed.frames import rotation_2d
from testbed.simulation.planar_scene import TIMESTEP

SETTLE = 60
"""Steps before the first part of a stretch counts: until the feet carry what a guess of the masses puts on them."""
PART = 2
"""Steps that count of each part of a stretch."""


@dataclass(frozen=True, eq=False)
class PlanarMotion:
    """K steady stretches of S equal parts. Object axes; velocities and moments of and about the grasp point.

    In a steady stretch motion and wrench are constant in the object frame, so that a few steps of each of its parts say
    what all of it would.
    """

    twists: Float[np.ndarray, "K S 3"]
    """Velocity, m/s, and turn rate, rad/s, in each part; of an accelerated stretch at one rate, that of its middle."""
    spin_up: Float[np.ndarray, "K"]
    """Angular acceleration, rad/s^2; speeds go with the turn rate."""
    moment: Float[np.ndarray, "K 2"]
    """Moment of the gripper that tilts the object, about x and y at the table, N m."""
    lift: Float[np.ndarray, "K"]
    """Vertical force of the gripper, N."""
    held: Int[np.ndarray, "K"]
    """Mass group that the lift pulls at."""
    grasp: Float[np.ndarray, "K 2"]
    """Grasp point, m, object frame."""

    def at_each_grasp(self) -> Iterator[tuple[Float[np.ndarray, "2"], slice]]:
        """Runs of stretches about the same point: the point, and which they are."""
        moved = np.flatnonzero(np.any(np.diff(self.grasp, axis=0) != 0, axis=1)) + 1
        for begin, end in pairwise([0, *moved.tolist(), len(self.grasp)]):
            yield self.grasp[begin], slice(begin, end)

    @property
    def counted(self) -> Bool[np.ndarray, "T"]:
        """Which steps count: not those in which the velocity is set to the next part's, nor those after."""
        part = np.r_[[False, False], np.ones(PART, dtype=bool)]
        return np.concatenate([np.zeros(SETTLE, dtype=bool), np.tile(part, self.twists.shape[1])])

    def velocity(self, step: int) -> Float[np.ndarray, "K 3"]:
        """Before a step, object axes."""
        part = max(step - SETTLE - 1, 0) // (PART + 2)
        twist = self.twists[:, min(part, self.twists.shape[1] - 1)]
        since = TIMESTEP * (step - len(self.counted) / 2)
        gained = np.divide(self.spin_up * since, twist[:, 2], out=np.zeros(len(twist)), where=self.spin_up != 0)
        return twist * (1 + gained)[:, None]

    def drive(self) -> Float[np.ndarray, "K T 3"]:
        """Acceleration of the drive at every step, world axes."""
        velocity, yaw = self.velocity(0), np.zeros(len(self.twists))
        given = np.empty((len(yaw), len(self.counted), 3))
        for step in range(given.shape[1]):
            wanted = self.velocity(step + 1)
            yaw = yaw + TIMESTEP * wanted[:, 2]
            wanted[:, :2] = np.einsum("kij,kj->ki", rotation_2d(yaw), wanted[:, :2])
            given[:, step] = (wanted - velocity) / TIMESTEP
            velocity = wanted
        return given

    def controls(self, lifts: int) -> Float[np.ndarray, "K T 5+lifts"]:
        """What the scene's motors are told: the drive, the tilt, and a lift for each of `lifts` slides."""
        drive = self.drive()
        held = np.arange(lifts) == np.minimum(self.held, lifts - 1)[:, None]
        still = np.concatenate([self.moment, held * self.lift[:, None]], axis=1)
        return np.concatenate([drive, np.broadcast_to(still[:, None], (*drive.shape[:2], still.shape[1]))], axis=2)
