"""Inertial parameters of the parts of an object, each of one density, in the object frame."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from estimators.inertial.body import InertialParameters, steiner
from estimators.inertial.semidefinite import Ellipsoid
from testbed.objects.model import ObjectModel, ObjectShape, Solid


def column_parts(shape: ObjectShape) -> tuple[InertialParameters, ...]:
    """Parameters of every mass group as upright columns of its cells' material, 1 kg each."""
    sides = np.array([shape.cell, shape.cell, shape.height])
    own = np.diag((sides**2).sum() - sides**2) / 12
    parts = []
    for group in range(shape.n_m):
        inside = shape.mass_group == group
        places = np.column_stack([shape.particles[inside], np.full(inside.sum(), shape.height / 2)])
        points = InertialParameters.of_points(places, shape.fill[inside] / shape.fill[inside].sum())
        parts.append(InertialParameters(points.mass, points.center_of_mass, points.inertia + own))
    return tuple(parts)


def solid_parts(solids: Sequence[Solid]) -> tuple[InertialParameters, ...]:
    """Parameters of every solid, of its own mass."""
    return tuple(_of_solid(solid) for solid in solids)


def true_body(obj: ObjectModel) -> InertialParameters:
    """Parameters of the object as simulated: of its solids, or of its columns."""
    parts = solid_parts(obj.solids) if obj.solids else column_parts(obj.shape)
    vectors = [part.vector / part.mass * mass for part, mass in zip(parts, obj.group_mass, strict=True)]
    return InertialParameters.of_vector(np.sum(vectors, axis=0))


def ellipsoid_of(shape: ObjectShape) -> Ellipsoid:
    """Ellipsoid around the box of the object's cells."""
    low, high = shape.particles.min(axis=0) - shape.cell / 2, shape.particles.max(axis=0) + shape.cell / 2
    return Ellipsoid.around(np.array([*low, 0.0]), np.array([*high, shape.height]))


def _of_solid(solid: Solid) -> InertialParameters:
    """Parameters of a solid, by tetrahedra from the origin: int x x^T = v (sum_i x_i x_i^T + s s^T) / 20."""
    corners = solid.vertices[solid.faces]
    volume = np.linalg.det(corners) / 6 * solid.mass / solid.volume
    sums = corners.sum(axis=1)
    second = np.einsum("f,fci,fcj->ij", volume, corners, corners) + np.einsum("f,fi,fj->ij", volume, sums, sums)
    second /= 20
    about = np.trace(second) * np.eye(3) - second
    center = volume @ sums / 4 / solid.mass
    return InertialParameters(solid.mass, center, about - solid.mass * steiner(center))
