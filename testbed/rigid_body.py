"""A mass distribution as one rigid body: mass, centre and inertia in space, from the boxes that it is made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from testbed.arrays import frozen_array
from testbed.objects import MassDistribution, ObjectShape


@dataclass(frozen=True, eq=False)
class Box:
    """A box of even density, its sides along the object's axes."""

    name: str
    """The block's, or the block's and a number."""
    center: Float[np.ndarray, "3"]
    """m, object frame, z from the table."""
    size: Float[np.ndarray, "3"]
    """Sides, m."""
    mass: float
    """kg."""
    group: int
    """Mass group."""
    friction: float | None
    """Under it; None where it does not touch the table."""


@dataclass(frozen=True, eq=False)
class RigidBody:
    """Inertial properties, object frame, z from the table."""

    mass: float
    """kg."""
    center: Float[np.ndarray, "3"]
    """Of mass, m."""
    inertia: Float[np.ndarray, "3 3"]
    """About the centre of mass, kg m^2."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "center", frozen_array("RigidBody.center", self.center, (3,)))
        object.__setattr__(self, "inertia", frozen_array("RigidBody.inertia", self.inertia, (3, 3)))

    @staticmethod
    def of(boxes: Sequence[Box]) -> RigidBody:
        """All boxes as one body."""
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

    @property
    def pseudo_inertia(self) -> Float[np.ndarray, "4 4"]:
        """Positive definite for every body that can exist (Wensing, Kim and Slotine 2018)."""
        second = np.trace(self.inertia) / 2 * np.eye(3) - self.inertia + self.mass * np.outer(self.center, self.center)
        first = self.mass * self.center
        return np.block([[second, first[:, None]], [first[None], np.array([[self.mass]])]])


def boxes_of(shape: ObjectShape, distribution: MassDistribution) -> list[Box]:
    """A box a mass group where its cells, all alike, fill a rectangle of one friction; else a box a cell."""
    boxes = []
    for group, name in enumerate(shape.group_names):
        inside = np.flatnonzero(shape.mass_group == group)
        low, high = shape.particles[inside].min(axis=0), shape.particles[inside].max(axis=0)
        cells = np.rint((high - low) / shape.cell) + 1
        frictions = set(shape.friction_group[inside].tolist())
        even = len(frictions) == 1 and (shape.fill[inside] == 1).all()
        parts = [inside] if even and int(cells.prod()) == len(inside) else list(inside[:, None])
        for index, part in enumerate(parts):
            low, high = shape.particles[part].min(axis=0), shape.particles[part].max(axis=0)
            under = int(shape.friction_group[part[0]])
            boxes.append(
                Box(
                    name if len(parts) == 1 else f"{name}_{index}",
                    np.array([*(low + high) / 2, shape.height / 2]),
                    np.array([*(high - low + shape.cell), shape.height]),
                    float(distribution.mass[group] * shape.fill[part].sum()),
                    group,
                    None if under < 0 else float(distribution.friction[under]),
                )
            )
    return boxes
