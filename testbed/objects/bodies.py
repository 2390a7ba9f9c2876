"""Rigid bodies of an object: the whole, or each link of a chain, as boxes with mass, center and inertia."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float

from testbed.errors import InvalidValueError
from testbed.objects.model import MassDistribution, ObjectShape
from testbed.validation import freeze_arrays


@dataclass(frozen=True, eq=False)
class Box:
    """Box of even density, its sides along the object's axes."""

    name: str
    """Name of the block, with a number if it has several boxes."""
    center: Float[np.ndarray, "3"]
    """Center [m], frame of the object or of its link, z from the table, shape (3,)."""
    size: Float[np.ndarray, "3"]
    """Sides [m], shape (3,)."""
    mass: float
    """Mass [kg]."""
    group: int
    """Mass group."""
    friction: float | None
    """Friction coefficient under it; None if it does not touch the table."""


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Mass properties of a rigid body, frame of the object or of its link, z from the table."""

    mass: float
    """Mass [kg]."""
    center: Float[np.ndarray, "3"]
    """Center of mass [m]."""
    inertia: Float[np.ndarray, "3 3"]
    """Inertia about the center of mass [kg m^2]."""

    def __post_init__(self) -> None:
        freeze_arrays(self, center=(3,), inertia=(3, 3))

    @staticmethod
    def of(boxes: Sequence[Box]) -> RigidBody:
        """Rigid body of all boxes."""
        mass = np.array([box.mass for box in boxes])
        centers = np.array([box.center for box in boxes])
        total = float(mass.sum())
        center = mass @ centers / total
        inertia = np.zeros((3, 3))
        for box in boxes:
            sides, off = box.size**2, box.center - center
            own = np.diag(sides.sum() - sides) / 12
            inertia += box.mass * (own + off @ off * np.eye(3) - np.outer(off, off))
        return RigidBody(total, center, inertia)


AIR = 0.001
"""Height over the table of boxes that do not touch it [m], so that no simulator applies friction to them; a tenth of
the height of a flat object."""


def boxes_of(shape: ObjectShape, distribution: MassDistribution) -> list[Box]:
    """Boxes: one per mass group whose cells, of equal fill, form a rectangle of one friction; else one per cell."""
    boxes, air, is_foot = [], min(AIR, shape.height / 10), np.isin(np.arange(len(shape.particles)), shape.feet)
    for group, name in enumerate(shape.group_names):
        own = shape.mass_group == group
        inside, feet = np.flatnonzero(own & ~is_foot), np.flatnonzero(own & is_foot)
        low, high = shape.particles[inside].min(axis=0), shape.particles[inside].max(axis=0)
        cells = np.rint((high - low) / shape.cell) + 1
        under = np.full(len(inside), shape.friction_group[feet[0]]) if len(feet) else shape.friction_group[inside]
        even = len(set(under.tolist())) == 1 and np.ptp(shape.fill[inside]) == 0
        parts = [inside] if even and int(cells.prod()) == len(inside) else list(inside[:, None])
        for index, part in enumerate(parts):
            low, high = shape.particles[part].min(axis=0), shape.particles[part].max(axis=0)
            friction = int(under[index])
            bottom = air if friction < 0 else 0.0
            boxes.append(
                Box(
                    name if len(parts) == 1 else f"{name}_{index}",
                    np.array([*(low + high) / 2, (shape.height + bottom) / 2]),
                    np.array([*(high - low + shape.cell), shape.height - bottom]),
                    float(distribution.mass[group] * shape.fill[part].sum()),
                    group,
                    None if friction < 0 else float(distribution.friction[friction]),
                )
            )
    return boxes


@dataclass(frozen=True, eq=False)
class Link:
    """Rigid part of an object: the whole of a rigid one, or a link of a chain."""

    name: str
    """Name: the object's of the first, then link_1, link_2."""
    origin: Float[np.ndarray, "3"]
    """Origin of its frame [m], object frame, shape (3,): on its hinge; zero of the first."""
    boxes: tuple[Box, ...]
    """Its boxes, in its frame."""
    hinge: str
    """Name of the vertical hinge at its origin, to the link before: hinge_0, hinge_1; empty of the first."""
    hinge_friction: float
    """Torque of Coulomb friction of that hinge [N m]."""

    @property
    def body(self) -> RigidBody:
        """Mass properties, in its frame."""
        return RigidBody.of(self.boxes)


def links_of(
    name: str, shape: ObjectShape, distribution: MassDistribution, hinge_friction: Sequence[float] = ()
) -> list[Link]:
    """Links of an object in the order of its chain; a rigid object has one.

    Args:
        name: the object's name.
        shape: its geometry.
        distribution: its masses and frictions.
        hinge_friction: torque of Coulomb friction of each hinge [N m].

    Raises:
        InvalidValueError: a link without mass, which no simulator accepts.
    """
    places, link_of_group = np.zeros((1, 3)), np.zeros(shape.n_m, dtype=int)
    if shape.chain is not None:
        places = np.pad(shape.chain.hinges, ((1, 0), (0, 1)))  # the first link keeps the object's frame
        link_of_group = shape.chain.link
    boxes, links = boxes_of(shape, distribution), []
    for index, (origin, torque) in enumerate(zip(places, (0.0, *hinge_friction), strict=True)):
        own = [box for box in boxes if link_of_group[box.group] == index]
        link_name, hinge = (f"link_{index}", f"hinge_{index - 1}") if index else (name, "")
        if sum(box.mass for box in own) <= 0:
            raise InvalidValueError("mass", f"{link_name} of 0 kg", "a mass > 0 in every link")
        placed = tuple(replace(box, center=box.center - origin) for box in own)
        links.append(Link(link_name, origin, placed, hinge, float(torque)))
    return links
