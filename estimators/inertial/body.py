"""Inertial parameters of a rigid body: numbers, vector of linear parameters, and pseudo-inertia."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.validation import frozen_array

SIZE = 10
"""Number of inertial parameters."""
_PLACES = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
"""Entries of the inertia that the vector holds, in order."""


@dataclass(frozen=True, eq=False)
class InertialParameters:
    """Mass, center of mass and inertia of a rigid body."""

    mass: float
    """M, kg."""
    center_of_mass: Float[np.ndarray, "3"]
    """c, m."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the center of mass, kg m^2."""

    def __post_init__(self) -> None:
        for name, size in (("center_of_mass", (3,)), ("inertia", (3, 3))):  # NaN where a motion does not show them
            of_class = f"InertialParameters.{name}"
            object.__setattr__(self, name, frozen_array(of_class, getattr(self, name), size, finite=False))

    @staticmethod
    def of_vector(vector: Float[np.ndarray, "10"]) -> InertialParameters:
        """The parameters of a `vector`; its mass must not be zero."""
        mass, center, about = float(vector[0]), vector[1:4] / vector[0], _inertia(vector)
        return InertialParameters(mass, center, about - mass * steiner(center))

    @staticmethod
    def of_points(places: Float[np.ndarray, "P 3"], masses: Float[np.ndarray, "P"]) -> InertialParameters:
        """The parameters of point masses."""
        squares = np.einsum("p,pi,pj->ij", masses, places, places)
        about = np.trace(squares) * np.eye(3) - squares
        entries = [about[place] for place in _PLACES]
        return InertialParameters.of_vector(np.concatenate([[masses.sum()], masses @ places, entries]))

    @property
    def vector(self) -> Float[np.ndarray, "10"]:
        """Linear parameters of a wrench: m, m c, and the inertia about the origin as xx, xy, xz, yy, yz, zz."""
        about = self.inertia + self.mass * steiner(self.center_of_mass)
        return np.concatenate([[self.mass], self.mass * self.center_of_mass, [about[place] for place in _PLACES]])

    @property
    def consistent(self) -> bool:
        """True if a body of positive density can have these parameters: the pseudo-inertia is positive definite."""
        return bool(np.linalg.eigvalsh(pseudo_inertia(self.vector))[0] > 0)

    def moved(self, rotation: Float[np.ndarray, "3 3"], origin: Float[np.ndarray, "3"]) -> InertialParameters:
        """Parameters in another frame, with axes `rotation` (columns) and `origin` [m] given in the present one."""
        center = rotation.T @ (self.center_of_mass - origin)
        return InertialParameters(self.mass, center, rotation.T @ self.inertia @ rotation)


def pseudo_inertia(vector: Float[np.ndarray, "10"]) -> Float[np.ndarray, "4 4"]:
    """Matrix [[Sigma, m c], [m c, m]], second moments Sigma = tr(I) / 2 - I (Wensing, Kim, Slotine 2018)."""
    about = _inertia(vector)
    whole = np.zeros((4, 4))
    whole[:3, :3] = np.trace(about) / 2 * np.eye(3) - about
    whole[:3, 3] = whole[3, :3] = vector[1:4]
    whole[3, 3] = vector[0]
    return whole


def shift_map(lever: Float[np.ndarray, "3"]) -> Float[np.ndarray, "10 10"]:
    """Map from a body's vector to that about a point at `lever` (m), axes kept."""
    columns = []
    for one in np.eye(SIZE):
        m, first, about = one[0], one[1:4], _inertia(one)
        moved = (
            about
            + m * steiner(lever)
            - (2 * first @ lever * np.eye(3) - np.outer(first, lever) - np.outer(lever, first))
        )
        columns.append(np.concatenate([[m], first - m * lever, [moved[place] for place in _PLACES]]))
    return np.column_stack(columns)


def _inertia(vector: Float[np.ndarray, "10"]) -> Float[np.ndarray, "3 3"]:
    xx, xy, xz, yy, yz, zz = vector[4:]
    return np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])


def steiner(c: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3 3"]:
    """Inertia about the origin of a unit point mass at c."""
    return c @ c * np.eye(3) - np.outer(c, c)
