"""Objects: what is known of them (shape), what is asked (mass and friction), and both together.

Planar, in the object frame: origin at the mean of the particles, SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Float, Int

from testbed.arrays import check_positive, frozen_array, is_number
from testbed.errors import InvalidValueError

GRAVITY = 9.81
"""Magnitude of gravity, m/s^2."""


@dataclass(frozen=True, eq=False)
class Grasp:
    """One way for a parallel gripper to take the object: pads on two opposite faces."""

    name: str
    """What the user calls it: the block it holds."""
    position: Float[np.ndarray, "2"]
    """Midpoint between the pads, m, object frame; the TCP is put here."""
    angle: float
    """Direction along which the pads close, rad, object frame."""
    width: float
    """Distance between the two gripped faces, m."""
    length: float
    """Length of the gripped faces, m."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "position", frozen_array("Grasp.position", self.position, (2,)))
        if not is_number(self.angle):
            raise InvalidValueError("Grasp.angle", self.angle, "a finite number, rad")
        for name in ("width", "length"):
            check_positive(f"Grasp.{name}", getattr(self, name))


@dataclass(frozen=True, eq=False)
class ObjectShape:
    """All that an estimator is told about an object: geometry and grouping, never mass or friction."""

    particles: Float[np.ndarray, "P 2"]
    """Centres of the square cells that the object is made of, m, object frame."""
    mass_group: Int[np.ndarray, "P"]
    """Index of each particle's mass group, 0 to n_m - 1 (G_m of the paper)."""
    friction_group: Int[np.ndarray, "P"]
    """Index of each particle's friction group, 0 to n_mu - 1 (G_mu); -1 where it does not touch the table."""
    cell: float
    """Side of a particle's cell, m."""
    height: float
    """Height of the object, m."""
    grasps: tuple[Grasp, ...] = ()
    """Where a parallel gripper can take it."""
    group_names: tuple[str, ...] = ()
    """What the user calls each mass group; "m0", "m1", ... if left out."""

    def __post_init__(self) -> None:
        particles = frozen_array("ObjectShape.particles", self.particles, (None, 2))
        count = len(particles)
        if count == 0:
            raise InvalidValueError("ObjectShape.particles", "none", "at least one particle")
        mass_group = _checked_groups("ObjectShape.mass_group", self.mass_group, count, lowest=0)
        friction_group = _checked_groups("ObjectShape.friction_group", self.friction_group, count, lowest=-1)
        if friction_group.max() < 0:
            raise InvalidValueError(
                "ObjectShape.friction_group", "-1 everywhere", "at least one particle in contact (>= 0)"
            )
        check_positive("ObjectShape.cell", self.cell)
        check_positive("ObjectShape.height", self.height)
        names = self.group_names or tuple(f"m{i}" for i in range(mass_group.max() + 1))
        if len(names) != mass_group.max() + 1:
            raise InvalidValueError("ObjectShape.group_names", names, f"{mass_group.max() + 1} names, one a mass group")
        object.__setattr__(self, "particles", particles)
        object.__setattr__(self, "mass_group", mass_group)
        object.__setattr__(self, "friction_group", friction_group)
        object.__setattr__(self, "grasps", tuple(self.grasps))
        object.__setattr__(self, "group_names", tuple(names))

    @property
    def n_m(self) -> int:
        """Number of mass groups."""
        return int(self.mass_group.max()) + 1

    @property
    def n_mu(self) -> int:
        """Number of friction groups."""
        return int(self.friction_group.max()) + 1

    @property
    def particles_per_group(self) -> Int[np.ndarray, "n_m"]:
        """Number of particles in each mass group, (n_m,)."""
        return np.bincount(self.mass_group, minlength=self.n_m)


@dataclass(frozen=True, eq=False)
class MassDistribution:
    """Mass and friction of every group: the truth, or an answer."""

    mass: Float[np.ndarray, "n_m"]
    """Mass of one particle of each mass group, kg."""
    friction: Float[np.ndarray, "n_mu"]
    """Coulomb friction coefficient of each friction group."""

    def __post_init__(self) -> None:
        for name in ("mass", "friction"):
            values = frozen_array(f"MassDistribution.{name}", getattr(self, name), (None,))
            if (values < 0).any():
                raise InvalidValueError(f"MassDistribution.{name}", values.tolist(), "numbers >= 0")
            object.__setattr__(self, name, values)


@dataclass(frozen=True, eq=False)
class ObjectModel:
    """A shape together with its true mass distribution: what a simulation needs and an estimator never sees."""

    name: str
    shape: ObjectShape
    truth: MassDistribution = field(repr=False)

    def __post_init__(self) -> None:
        for given, expected, what in (
            (self.truth.mass, self.shape.n_m, "mass"),
            (self.truth.friction, self.shape.n_mu, "friction"),
        ):
            if len(given) != expected:
                raise InvalidValueError(f"ObjectModel.truth.{what}", given.tolist(), f"{expected} numbers, one a group")
        if self.total_mass <= 0:
            raise InvalidValueError("ObjectModel.truth.mass", self.truth.mass.tolist(), "a total mass > 0")

    @property
    def particle_mass(self) -> Float[np.ndarray, "P"]:
        """Mass of each particle, kg, (P,)."""
        return self.truth.mass[self.shape.mass_group]

    @property
    def total_mass(self) -> float:
        """M of Eq. mass, kg."""
        return float(self.particle_mass.sum())

    @property
    def center_of_mass(self) -> Float[np.ndarray, "2"]:
        """c of Eq. com, m, object frame, (2,)."""
        return self.particle_mass @ self.shape.particles / self.total_mass

    @property
    def inertia_cm(self) -> float:
        """I_cm of Eq. inertia, kg m^2, with each cell's own inertia m cell^2 / 6 added: cells are solid, not points."""
        offsets = self.shape.particles - self.center_of_mass
        return float(self.particle_mass @ (np.sum(offsets**2, axis=1) + self.shape.cell**2 / 6))

    @property
    def group_mass(self) -> Float[np.ndarray, "n_m"]:
        """Mass of each whole mass group (a block), kg, (n_m,)."""
        return self.truth.mass * self.shape.particles_per_group


def _checked_groups(name: str, values: np.ndarray, count: int, lowest: int) -> np.ndarray:
    array = np.asarray(values)
    if array.shape != (count,) or not np.issubdtype(array.dtype, np.integer):
        raise InvalidValueError(name, values, f"{count} integers, one a particle")
    present = np.unique(array[array >= 0])
    if array.min() < lowest or not np.array_equal(present, np.arange(len(present))):
        raise InvalidValueError(
            name, np.unique(array).tolist(), f"indices from {lowest}, every index up to the largest in use"
        )
    array = array.astype(np.int64)
    array.flags.writeable = False
    return array
