"""What masses and friction say the sensor should feel, sample by sample: to be held against what it felt."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from jaxtyping import Float

from estimators.dynamics import ParticleModel
from estimators.observations import observe
from estimators.prediction import AffineLoads, WrenchModel
from testbed.objects import MassDistribution, ObjectShape
from testbed.reduction import steady_samples
from testbed.trajectory import Trajectory

PIVOT_ERROR = 2e-4
"""How well the centre of a turn is taken to be known, m; as the estimators take it."""


def predicted_wrenches(
    shape: ObjectShape, distribution: MassDistribution, trajectories: Sequence[Trajectory]
) -> list[Float[np.ndarray, "T 3"]]:
    """Force x, y (N) and torque about the grasp point (N m), object axes, that the measured motion takes.

    Every mass group rests on its own weight, and on what the gripper was measured to press or lift.

    Args:
        shape: geometry.
        distribution: the truth, or an answer.
        trajectories: of one object; what is left out of estimates is NaN, as is all outside steady stretches.
    """
    predicted = [np.full((len(t.time_s), 3), np.nan) for t in trajectories]
    windows = observe(shape, trajectories)
    if windows is None:
        return predicted
    model = ParticleModel.of(shape)
    wrenches = WrenchModel.of(model, windows, AffineLoads.of(shape, model, windows), PIVOT_ERROR).wrench(
        torch.tensor(distribution.mass), torch.tensor(distribution.friction)
    )
    for index in sorted(set(windows.trial.tolist())):
        rows = wrenches[windows.trial == index].numpy()
        for kept, row in zip(steady_samples(trajectories[index]), rows, strict=True):
            predicted[index][kept] = row
    return predicted
