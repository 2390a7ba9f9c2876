"""The paper's measures of how right an answer is: where truth and estimate meet, and nowhere else."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from estimators.dynamics import ParticleModel, inertia_of
from estimators.observations import observe
from estimators.prediction import AffineLoads
from estimators.steady_turn import SteadyTurn
from testbed.errors import InvalidValueError
from testbed.objects import MassDistribution, ObjectShape
from testbed.reduction import steady_samples
from testbed.trajectory import Trajectory

OPEN_LOOP = 1.0
"""Length of the open-loop prediction, s."""


def normalized_absolute_difference(shape: ObjectShape, estimate: MassDistribution, truth: MassDistribution) -> float:
    """NAD, eta_1: sum over particles of |m - m_g| over the total mass; 0 is right, 2 is everything misplaced.

    Raises:
        InvalidValueError: masses that do not fit the shape.
    """
    for name, given in (("estimate.mass", estimate.mass), ("truth.mass", truth.mass)):
        if len(given) != shape.n_m:
            raise InvalidValueError(name, given.tolist(), f"{shape.n_m} numbers, one a mass group")
    count = shape.particles_per_group
    return float(count @ np.abs(estimate.mass - truth.mass) / (count @ truth.mass))


@dataclass(frozen=True)
class ParticleDistance:
    """MPD, eta_2: mean over turns of the mean distance between predicted and measured particles at the end, m."""

    open_loop: float
    """After 1 s of forward simulation from the measured wrench alone."""
    turn: float
    """After the whole turn: every step is predicted from the measured state before it, and the steps add up."""


def mean_particle_distance(
    shape: ObjectShape, estimate: MassDistribution, turns: Sequence[Trajectory]
) -> ParticleDistance | None:
    """Forward simulation of turns that the estimate has not seen; None where no turn is ok.

    As in the paper, wrench and motion are the filtered ones: constant in the object frame over a steady turn. What the
    gripper was measured to press goes into the loads; the object rests on its own weight, as every method assumes.

    Args:
        shape: geometry and groups.
        estimate: mass and friction.
        turns: at constant speed.
    """
    usable = [turn for turn in turns if turn.ok]
    windows = observe(shape, usable)
    if windows is None:
        return None
    model = ParticleModel.of(shape)
    mass, friction = torch.tensor(estimate.mass), torch.tensor(estimate.friction)
    inertia = inertia_of(model, model.particle_mass(mass))
    pressed = model.particle_friction(friction) * AffineLoads.of(shape, model, windows).at(mass).clamp(min=0)
    found = []
    for trial, trajectory in enumerate(usable):
        mine = torch.nonzero(windows.trial == trial).flatten()
        for k, kept in zip(mine, steady_samples(trajectory) if len(mine) else [], strict=True):
            turn = SteadyTurn.of(windows.where(k[None]), trajectory, kept, inertia)
            found.append(
                (turn.open_loop(model, inertia, pressed[k], OPEN_LOOP), turn.stepwise(model, inertia, pressed[k]))
            )
    open_loop, whole = np.mean(found, axis=0)
    return ParticleDistance(float(open_loop), float(whole))
