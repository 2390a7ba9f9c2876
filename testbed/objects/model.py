"""Objects: known shape, unknown mass distribution, and both together.

Planar, in the object frame: origin at the mean of the particles, SI units.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial import KDTree

from testbed.errors import InvalidValueError
from testbed.objects.chain import Chain, checked_torques
from testbed.validation import ReadOnlyArrays, check_positive_fields, freeze_arrays, frozen_array, is_number

GRAVITY = 9.81
"""Magnitude of gravity [m/s^2]."""
STROKE = 0.085
"""Opening of the gripper, a Robotiq 2F-85 [m]."""
PAD_WIDTH = 0.022
"""Width of its pads [m]."""
PAD_HEIGHT = (0.003, 0.040)
"""Lower and upper edge of its pads over the table while they hold [m]."""
MINIMUM_HEIGHT = 0.010
"""Least height of a face from the table up that the pads can hold [m]."""
LEAST_FACE = 0.003
"""Least height of a face that begins over the table, above the pads' lower edge [m]; simulated pads hold it."""
FINGER_DEPTH = 0.008
"""Thickness of a finger along the closing direction at its pads [m]."""
TOUCH = 0.001
"""Distance within which a surface touches the table, and a soft pad a face [m]."""
SPARE_OPENING = 0.005
"""Opening that a gripper needs beyond the width of a grasp [m]."""


@dataclass(frozen=True)
class Hand:
    """Size of a parallel gripper, by default a Robotiq 2F-85."""

    stroke: float = STROKE
    """Opening between the pads [m]."""
    finger_width: float = PAD_WIDTH
    """Width of a finger across the closing direction [m]."""
    finger_depth: float = FINGER_DEPTH
    """Thickness of a finger along the closing direction [m]."""

    def __post_init__(self) -> None:
        check_positive_fields(self, "stroke", "finger_width", "finger_depth")

    def takes(self, width: float) -> bool:
        """True if faces `width` [m] apart fit between the open pads."""
        return width <= self.stroke - SPARE_OPENING + 1e-9

    @property
    def nothing(self) -> str:
        """Reason why it finds no grasp on an object."""
        return (
            "no two opposite free faces, of a block, a row of blocks or a mesh, have room for the fingers of a hand "
            f"that opens to {self.stroke * 1e3:g} mm"
        )


ROBOTIQ_2F85 = Hand()
"""Hand of the simulated robot."""


@dataclass(frozen=True, eq=False)
class Grasp(ReadOnlyArrays):
    """Grasp of a parallel gripper: pads on two opposite faces."""

    name: str
    """Name, such as that of the block it holds."""
    position: Float[np.ndarray, "2"]
    """Midpoint between the pads [m], object frame: the place of the TCP."""
    angle: float
    """Direction along which the pads close [rad], object frame."""
    width: float
    """Distance between the two gripped faces [m]."""
    length: float
    """Length of the gripped faces [m]."""
    bottom: float = 0.0
    """Lower edge of the gripped faces over the table [m]."""
    top: float | None = None
    """Upper edge of the gripped faces over the table [m]; None is the object's height."""
    opening: float | None = None
    """Opening between the pads as they come down and let go [m], where there is no room for all; None is the stroke."""

    def __post_init__(self) -> None:
        freeze_arrays(self, position=(2,))
        if not is_number(self.angle):
            raise InvalidValueError("Grasp.angle", self.angle, "a finite number, rad")
        check_positive_fields(self, "width", "length")
        if self.opening is not None and not (is_number(self.opening) and self.opening >= self.width):
            raise InvalidValueError(
                "Grasp.opening", self.opening, f"a finite number >= width ({self.width:g} m), or None"
            )
        if not (is_number(self.bottom) and self.bottom >= 0):
            raise InvalidValueError("Grasp.bottom", self.bottom, "a finite number >= 0, m")
        if self.top is not None and not (is_number(self.top) and self.top > self.bottom):
            raise InvalidValueError("Grasp.top", self.top, f"a finite number > bottom ({self.bottom:g} m), or None")

    def moved(self, offset: Float[np.ndarray, "2"]) -> Grasp:
        """The same grasp at another place, `offset` further [m]."""
        return replace(self, position=self.position + offset)


@dataclass(frozen=True, eq=False)
class ObjectShape(ReadOnlyArrays):
    """Known part of an object: geometry and grouping, never mass or friction."""

    particles: Float[np.ndarray, "P 2"]
    """Centers of the square cells of the object [m], object frame."""
    mass_group: Int[np.ndarray, "P"]
    """Index of each particle's mass group, 0 to n_m - 1 (G_m of the paper)."""
    friction_group: Int[np.ndarray, "P"]
    """Index of each particle's friction group, 0 to n_mu - 1 (G_mu); -1 where it does not touch the table."""
    cell: float
    """Side of a particle's cell [m]."""
    height: float
    """Height of the object [m]."""
    grasps: tuple[Grasp, ...] = ()
    """Grasps of a parallel gripper."""
    group_names: tuple[str, ...] = ()
    """Names of the mass groups; "m0", "m1", ... if left out."""
    fill: Float[np.ndarray, "P"] = field(default_factory=lambda: np.ones(0))
    """Material in each cell over the mean of its group; 1 for the cells of blocks, and if left out."""
    chain: Chain | None = None
    """Links of an articulated object; None of a rigid one."""
    sides: Float[np.ndarray, "K 2 2"] = field(default_factory=lambda: np.ones((0, 2, 2)))
    """Begin and end of each straight side of the outline [m], the object on the left; the cells' sides if left out."""
    stands_on_feet: bool = False
    """True if the points of contact are feet of each mass group, which may rest on its own weight; False if one rigid
    body rests on them, or there are none."""

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
        check_positive_fields(self, "cell", "height")
        names = self.group_names or tuple(f"m{i}" for i in range(mass_group.max() + 1))
        if len(names) != mass_group.max() + 1:
            raise InvalidValueError(
                "ObjectShape.group_names", names, f"{mass_group.max() + 1} names, one per mass group"
            )
        if self.chain is not None and len(self.chain.link) != len(names):
            raise InvalidValueError("ObjectShape.chain", self.chain.link.tolist(), f"{len(names)} links, one per group")
        fill = frozen_array("ObjectShape.fill", self.fill if len(self.fill) else np.ones(count), (count,))
        means = np.bincount(mass_group, fill) / np.bincount(mass_group)
        if (fill < 0).any() or not np.allclose(means, 1.0, rtol=1e-9):
            allowed = "numbers >= 0 with a mean of 1 in each mass group"
            raise InvalidValueError("ObjectShape.fill", f"means {means.tolist()}, least {fill.min():g}", allowed)
        checked = {"particles": particles, "mass_group": mass_group, "friction_group": friction_group, "fill": fill}
        others = {"sides": frozen_array("ObjectShape.sides", self.sides, (None, 2, 2)), "group_names": tuple(names)}
        for name, value in (checked | others | {"grasps": tuple(self.grasps)}).items():
            object.__setattr__(self, name, value)

    @property
    def n_m(self) -> int:
        """Number of mass groups."""
        return int(self.mass_group.max()) + 1

    @property
    def n_mu(self) -> int:
        """Number of friction groups."""
        return int(self.friction_group.max()) + 1

    @property
    def friction_names(self) -> tuple[str, ...]:
        """Name of each friction: `friction`, or numbered where there are several."""
        return ("friction",) if self.n_mu == 1 else tuple(f"friction {k}" for k in range(self.n_mu))

    @property
    def particles_per_group(self) -> Int[np.ndarray, "n_m"]:
        """Number of particles in each mass group, (n_m,)."""
        return np.bincount(self.mass_group, minlength=self.n_m)

    @property
    def feet_per_group(self) -> Int[np.ndarray, "n_m"]:
        """Number of particles of each mass group that touch the table, (n_m,)."""
        return np.bincount(self.mass_group[self.friction_group >= 0], minlength=self.n_m)

    @property
    def is_contact(self) -> Bool[np.ndarray, "P"]:
        """True for particles that are points of contact alone: they touch, and have no material."""
        return (self.friction_group >= 0) & (self.fill == 0)

    @property
    def cells(self) -> Int[np.ndarray, "C"]:
        """Particles that have material, all but the points of contact."""
        return np.flatnonzero(~self.is_contact)

    def cells_of(self, group: int) -> Int[np.ndarray, "C"]:
        """Particles of a mass group that have material."""
        return self.cells[self.mass_group[self.cells] == group]

    def middle_of(self, group: int) -> Float[np.ndarray, "2"]:
        """Center of mass of a mass group's particles [m]."""
        own = self.mass_group == group
        return np.average(self.particles[own], axis=0, weights=self.fill[own])

    @property
    def is_uneven(self) -> bool:
        """True if material fills some cell in part, at a height in it that the cells do not determine."""
        fill = self.fill[self.cells]
        return bool((fill < fill.max()).any())

    @property
    def neighbors(self) -> list[tuple[int, int]]:
        """Pairs of mass groups with particles one cell apart."""
        near = KDTree(self.particles[self.cells]).query_pairs(1.01 * self.cell, output_type="ndarray")
        pairs = np.sort(self.mass_group[self.cells][near], axis=1)
        return [(int(a), int(b)) for a, b in np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)]

    @property
    def feet(self) -> Int[np.ndarray, "F"]:
        """Particles that are feet of mass groups, whose places are known."""
        return np.flatnonzero(self.is_contact & self.stands_on_feet)

    @property
    def stands_in_groups(self) -> bool:
        """True if every mass group touches the table by itself, and may rest on its own weight."""
        apart = self.stands_on_feet or not self.is_contact.any()
        return apart and len(np.unique(self.mass_group[self.friction_group >= 0])) == self.n_m

    def pressed(self, grasp: Grasp) -> tuple[int, int]:
        """Mass groups under the two pads of a grasp, against the closing direction first."""
        closing = np.array([np.cos(grasp.angle), np.sin(grasp.angle)])
        faces = grasp.position + np.outer([-1.0, 1.0], closing) * max(grasp.width - self.cell, 0.0) / 2
        one, other = np.linalg.norm(self.particles - faces[:, None], axis=-1).argmin(axis=1)
        return int(self.mass_group[one]), int(self.mass_group[other])

    def per_group(self, of_particles: Float[np.ndarray, "... P"]) -> Float[np.ndarray, "... n_m"]:
        """Sum over the particles of each group, weighted by `fill`: the effect of a mean particle mass of 1."""
        return (of_particles * self.fill) @ np.eye(self.n_m)[self.mass_group]


def check_shape(shape: object) -> None:
    """Raise InvalidValueError unless `shape` is an ObjectShape."""
    if not isinstance(shape, ObjectShape):
        raise InvalidValueError("shape", shape, "an ObjectShape, such as `shape` of an object that is loaded")


@dataclass(frozen=True, eq=False)
class MassDistribution(ReadOnlyArrays):
    """Mass and friction of every group: the truth, or an estimate."""

    mass: Float[np.ndarray, "n_m"]
    """Mean mass of one particle of each mass group [kg], shape (n_m,)."""
    friction: Float[np.ndarray, "n_mu"]
    """Coulomb friction coefficient of each friction group."""

    def __post_init__(self) -> None:
        for name in ("mass", "friction"):
            values = frozen_array(f"MassDistribution.{name}", getattr(self, name), (None,))
            if (values < 0).any():
                raise InvalidValueError(f"MassDistribution.{name}", values.tolist(), "numbers >= 0")
            object.__setattr__(self, name, values)

    def group_mass(self, shape: ObjectShape) -> Float[np.ndarray, "n_m"]:
        """Mass of each group [kg].

        Raises:
            InvalidValueError: a shape with another number of groups.
        """
        if len(self.mass) != shape.n_m:
            raise InvalidValueError(
                "shape", f"one of {shape.n_m} mass groups", f"one of {len(self.mass)}, as the masses"
            )
        return self.mass * shape.particles_per_group


@dataclass(frozen=True, eq=False)
class Solid:
    """A body of even density within a closed surface of triangles, which face outwards."""

    vertices: Float[np.ndarray, "V 3"]
    """Vertices [m], object frame, z from the table."""
    faces: Int[np.ndarray, "F 3"]
    """Triangles: indices into the vertices, anticlockwise from outside."""
    mass: float
    """Mass [kg]."""

    def __post_init__(self) -> None:
        freeze_arrays(self, vertices=(None, 3))
        faces = np.array(self.faces)
        if faces.ndim != 2 or faces.shape[1:] != (3,) or not np.issubdtype(faces.dtype, np.integer):
            raise InvalidValueError("Solid.faces", f"shape {faces.shape}", "integers of shape (n, 3)")
        if len(faces) == 0 or faces.min() < 0 or faces.max() >= len(self.vertices):
            raise InvalidValueError("Solid.faces", faces.tolist(), f"indices from 0 to {len(self.vertices) - 1}")
        check_positive_fields(self, "mass")
        faces.flags.writeable = False
        object.__setattr__(self, "faces", faces)
        if self.volume <= 0:
            raise InvalidValueError("Solid.faces", f"a volume of {self.volume:g} m^3", "triangles that face outwards")

    @property
    def volume(self) -> float:
        """Volume [m^3]."""
        return float(self._tetrahedra[1].sum())

    @property
    def center_of_mass(self) -> Float[np.ndarray, "3"]:
        """Center of mass [m], object frame, shape (3,)."""
        corners, volume = self._tetrahedra
        return volume @ corners.sum(axis=1) / 4 / self.volume

    @property
    def inertia_z(self) -> float:
        """Inertia about the vertical axis through its center of mass [kg m^2]."""
        corners, volume = self._tetrahedra
        planar = corners[:, :, :2]
        squares = ((planar**2).sum(axis=1) + planar.sum(axis=1) ** 2).sum(axis=1) / 20
        return float(self.mass * (volume @ squares / self.volume - self.center_of_mass[:2] @ self.center_of_mass[:2]))

    @property
    def _tetrahedra(self) -> tuple[Float[np.ndarray, "F 3 3"], Float[np.ndarray, "F"]]:
        """Corners of every triangle, and the signed volume of the tetrahedron that it makes with the origin."""
        corners = self.vertices[self.faces]
        return corners, np.linalg.det(corners) / 6


@dataclass(frozen=True, eq=False)
class ObjectModel(ReadOnlyArrays):
    """Shape together with its true mass distribution, for simulations; estimators have no access to the latter."""

    name: str
    """Name in files and tables."""
    shape: ObjectShape
    """Part known to an estimator."""
    truth: MassDistribution = field(repr=False)
    """Unknown part: masses and frictions."""
    solids: tuple[Solid, ...] = field(default=(), repr=False)
    """Body of each mass group of a mesh, more exact than its particles; empty for blocks."""
    masses_known: bool = True
    """False if no masses are given: those of `truth` are placeholders, and no estimate is compared with them."""
    hinge_friction: tuple[float, ...] = ()
    """Torque of Coulomb friction of each hinge of the chain [N m]; none if left out."""

    def __post_init__(self) -> None:
        for given, expected, what in (
            (self.truth.mass, self.shape.n_m, "mass"),
            (self.truth.friction, self.shape.n_mu, "friction"),
        ):
            if len(given) != expected:
                raise InvalidValueError(
                    f"ObjectModel.truth.{what}", given.tolist(), f"{expected} numbers, one per group"
                )
        if self.total_mass <= 0:
            raise InvalidValueError("ObjectModel.truth.mass", self.truth.mass.tolist(), "a total mass > 0")
        torques = checked_torques("ObjectModel.hinge_friction", self.hinge_friction, self.shape.chain)
        object.__setattr__(self, "hinge_friction", torques)
        object.__setattr__(self, "solids", tuple(self.solids))
        if self.solids:
            masses = [solid.mass for solid in self.solids]
            if len(masses) != self.shape.n_m or not np.allclose(masses, self.group_mass, rtol=1e-9, atol=0):
                raise InvalidValueError(
                    "ObjectModel.solids", f"masses {masses}", f"one per mass group, of {self.group_mass.tolist()} kg"
                )

    def on_feet(self, feet: Sequence[Float[np.ndarray, "F 2"]]) -> ObjectModel:
        """The object on feet of known places, in place of its cells.

        Args:
            feet: places of the feet of each mass group [m], object frame.

        Raises:
            InvalidValueError: a group that does not touch the table, rests on more than one friction, or does not have
                its center of mass between its feet.
        """
        shape, under = self.shape, []
        for group, (name, places) in enumerate(zip(shape.group_names, feet, strict=True)):
            touching = set(shape.friction_group[shape.mass_group == group].tolist()) - {-1}
            if len(touching) != 1:
                raise InvalidValueError("feet", name, "groups that touch the table, each with one friction")
            under.append(touching.pop())
            middle = shape.middle_of(group)
            if even_shares(places - middle).min() <= 0:
                given = f"{name}, with its center of mass at ({middle[0] * 1e3:.1f}, {middle[1] * 1e3:.1f}) mm"
                raise InvalidValueError("feet", given, "feet around the center of mass of each group")
        group = np.repeat(np.arange(shape.n_m), [len(places) for places in feet])
        cells = shape.particles_per_group
        growth = (cells + np.bincount(group, minlength=shape.n_m)) / cells
        standing = replace(
            shape,
            particles=np.concatenate([shape.particles, *feet]),
            mass_group=np.append(shape.mass_group, group),
            friction_group=np.append(np.full(len(shape.particles), -1), np.array(under)[group]),
            fill=np.append(shape.fill * growth[shape.mass_group], np.zeros(len(group))),
            stands_on_feet=True,
        )
        return replace(self, shape=standing, truth=replace(self.truth, mass=self.truth.mass / growth))

    @property
    def particle_mass(self) -> Float[np.ndarray, "P"]:
        """Mass of each particle [kg], shape (P,)."""
        return self.truth.mass[self.shape.mass_group] * self.shape.fill

    @property
    def total_mass(self) -> float:
        """Total mass M of Eq. mass [kg]."""
        return float(sum(solid.mass for solid in self.solids) if self.solids else self.particle_mass.sum())

    @property
    def center_of_mass(self) -> Float[np.ndarray, "2"]:
        """Center of mass c of Eq. com [m], object frame, shape (2,); that of the solids, if any."""
        if self.solids:
            return np.sum([s.mass * s.center_of_mass[:2] for s in self.solids], axis=0) / self.total_mass
        return self.particle_mass @ self.shape.particles / self.total_mass

    @property
    def inertia_cm(self) -> float:
        """Inertia I_cm of Eq. inertia [kg m^2], with the inertia m cell^2 / 6 of each solid cell added.

        With solids, it is their inertia.
        """
        if self.solids:
            center = self.center_of_mass
            return sum(s.inertia_z + s.mass * float(np.sum((s.center_of_mass[:2] - center) ** 2)) for s in self.solids)
        offsets = self.shape.particles - self.center_of_mass
        return float(self.particle_mass @ (np.sum(offsets**2, axis=1) + self.shape.cell**2 / 6))

    @property
    def group_mass(self) -> Float[np.ndarray, "n_m"]:
        """Mass of each mass group [kg], shape (n_m,)."""
        return self.truth.group_mass(self.shape)


def even_shares(lever: Float[np.ndarray, "N 2"]) -> Float[np.ndarray, "N"]:
    """Most even shares of a load over points at levers from it, (N,); all -1 if the points cannot carry it."""
    matrix, wanted = np.vstack([np.ones(len(lever)), lever.T]), np.array([1.0, 0.0, 0.0])
    share = np.linalg.lstsq(matrix, wanted, rcond=1e-9)[0]
    return share if np.allclose(matrix @ share, wanted, atol=1e-9) else np.full(len(lever), -1.0)


def _checked_groups(name: str, values: np.ndarray, count: int, lowest: int) -> np.ndarray:
    array = np.asarray(values)
    if array.shape != (count,) or not np.issubdtype(array.dtype, np.integer):
        raise InvalidValueError(name, values, f"{count} integers, one per particle")
    present = np.unique(array[array >= 0])
    if array.min() < lowest or not np.array_equal(present, np.arange(len(present))):
        raise InvalidValueError(
            name, np.unique(array).tolist(), f"indices from {lowest}, every index up to the largest in use"
        )
    array = array.astype(np.int64)
    array.flags.writeable = False
    return array
