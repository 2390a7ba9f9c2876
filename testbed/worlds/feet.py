"""Feet: the points on which an object touches the table."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float, Int

from testbed.objects.model import ObjectModel, even_shares
from testbed.validation import freeze_arrays

LEAST_FRICTION = 1e-5
"""Least coefficient of a foot."""
RING = 8
"""Points of a ring."""
HARD = 10.0
"""Stiffness of a rigid body's point of contact over that of a foot: on soft ones a narrow body would roll."""
_TRIES = 200
"""Patterns that are drawn, at most."""
_LEAST_SHARE = 0.3
"""Least load of a foot of an accepted pattern, as a part of an even share."""


@dataclass(frozen=True, eq=False)
class Feet:
    """F points of contact of an object."""

    particle: Int[np.ndarray, "F"]
    """Particle over each foot, or the nearest one; its mass group bears on the foot."""
    position: Float[np.ndarray, "F 2"]
    """Position [m], object frame."""
    height: Float[np.ndarray, "F"]
    """Height by which a foot stands out [m]."""
    stiffness: Float[np.ndarray, "F"]
    """Stiffness relative to a foot under a particle; the feet of a group share that of its particles."""
    friction: Float[np.ndarray, "F 2"]
    """Coefficient of friction along x and y of the table."""

    def __post_init__(self) -> None:
        count = len(self.particle)
        freeze_arrays(self, position=(count, 2), height=(count,), stiffness=(count,), friction=(count, 2))

    @staticmethod
    def of(model: ObjectModel) -> Feet:
        """Feet under all particles in contact, as the estimators assume; a rigid body's points of contact are hard.

        Known feet of a group carry its weight about its own center of mass.
        """
        if model.shape.stands_on_feet:
            count = len(model.shape.feet)
            return Feet.known(model, np.zeros((count, 2)), np.zeros(count))
        shape = model.shape
        particle = np.flatnonzero(shape.friction_group >= 0)
        stiffness = np.where(shape.is_contact[particle], HARD, 1.0)
        still = np.zeros(len(particle))
        return Feet(particle, shape.particles[particle], still, stiffness, _friction(model, particle))

    @staticmethod
    def known(model: ObjectModel, offset: Float[np.ndarray, "F 2"], uneven: Float[np.ndarray, "F"]) -> Feet:
        """Feet of known places; those of a group carry its weight about its own center of mass.

        Args:
            model: an object that stands on feet.
            offset: distance of each foot from its place [m].
            uneven: relative deviation of each foot's load from an even share; its affine component, which would shift
                the load, is removed.
        """
        shape = model.shape
        position, stiffness = shape.particles[shape.feet] + offset, np.ones(len(shape.feet))
        for group in range(shape.n_m):
            own = shape.mass_group[shape.feet] == group
            lever = position[own] - shape.middle_of(group)
            affine = np.column_stack([np.ones(len(lever)), lever])
            left = uneven[own] - affine @ np.linalg.lstsq(affine, uneven[own], rcond=1e-9)[0]
            stiffness[own] = np.maximum(len(lever) * even_shares(lever) + left, _LEAST_SHARE / 3)
        return Feet(shape.feet, position, 0 * stiffness, stiffness, _friction(model, shape.feet))

    @staticmethod
    def drawn(model: ObjectModel, points: int, rng: np.random.Generator) -> Feet:
        """A few points anywhere under each mass group: `points` or one fewer, or a ring.

        The feet of a group carry its weight about its own center of mass on level ground, each at least `_LEAST_SHARE`
        of an even share if such points are found, so that no neighbor holds the group. A body on known points of
        contact keeps them, with random stiffnesses.
        """
        shape, parts = model.shape, []
        if shape.is_contact.any():
            exact = Feet.of(model)
            return replace(exact, stiffness=exact.stiffness * rng.lognormal(0.0, 1.0, len(exact.particle)))
        for group in range(shape.n_m):
            touching = np.flatnonzero((shape.mass_group == group) & (shape.friction_group >= 0))
            if len(touching):
                center = shape.middle_of(group)
                cells = shape.particles[touching]
                nearby, position, share = _pattern(cells, shape.cell, center, points, rng)
                parts.append((touching[nearby], position, share * len(touching)))
        particle, position, stiffness = (np.concatenate(part) for part in zip(*parts, strict=True))
        return Feet(particle, position, np.zeros(len(particle)), stiffness, _friction(model, particle))


def _friction(model: ObjectModel, particle: Int[np.ndarray, "F"]) -> Float[np.ndarray, "F 2"]:
    """Coefficients of friction under particles along x and y, (F, 2)."""
    friction = np.maximum(model.truth.friction[model.shape.friction_group[particle]], LEAST_FRICTION)
    return np.column_stack([friction, friction])


def _pattern(
    cells: np.ndarray, cell: float, center: np.ndarray, points: int, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Index of the cell over each of N points, their positions [m] (N, 2), and their shares of the load."""
    if rng.random() < 1 / 3:
        angle = rng.uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(RING) / RING
        low, high = cells.min(axis=0), cells.max(axis=0)
        radius = rng.uniform(0.5, 0.95) * (high - low + cell) / 2
        wanted = (low + high) / 2 + radius * np.column_stack([np.cos(angle), np.sin(angle)])
        over = np.linalg.norm(wanted[:, None] - cells, axis=2).argmin(axis=1)
        position = cells[over] + np.clip(wanted - cells[over], -cell / 2, cell / 2)
        share = even_shares(position - center)
        return over, position, share if share.min() > 0 else np.full(RING, 1 / RING)
    count = int(rng.integers(points - 1, points + 1))
    for left in reversed(range(_TRIES)):
        over = rng.choice(len(cells), count, replace=len(cells) < count)
        position = cells[over] + rng.uniform(-0.5, 0.5, (count, 2)) * cell
        share = even_shares(position - center)
        if share.min() > _LEAST_SHARE / count:
            return over, position, share
        if not left:
            return over, position, np.full(count, 1 / count)
    raise AssertionError
