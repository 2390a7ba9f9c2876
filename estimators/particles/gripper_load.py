"""Load of the gripper on the object: vertical force and moments, with the sensor's likely error taken off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

TURNED, SWUNG = np.array([0.0064, 0.0027, 0.0027]), np.array([0.14, 6e-4, 6e-4])
"""Change of a nulled gripper's lift, N, and moment, N m, between directions of a turn, and as it accelerates."""


@dataclass(frozen=True, eq=False)
class GripperLoad:
    """Load of the gripper in K windows, from the measured wrench."""

    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, fz, N."""
    moment: Float[Tensor, "K 2"]
    """Moment that the feet supply beyond the object's own weight: (sum x N, sum y N) about the grasp point, N m."""
    held: Int[Tensor, "K 2"]
    """Mass groups under the two pads, each of which carries half the lift."""
    point: Float[Tensor, "K 2"]
    """Grasp point, m, object frame."""

    @property
    def carried(self) -> Float[Tensor, "K 3"]:
        """Lift and moment, N and N m."""
        return torch.cat([self.lift[:, None], self.moment], -1)

    @staticmethod
    def none() -> GripperLoad:
        """Load of a gripper that carries nothing, in one window."""
        lift, pair = torch.zeros(1, dtype=torch.float64), torch.zeros(1, 2, dtype=torch.float64)
        return GripperLoad(lift, pair, torch.zeros(1, 2, dtype=torch.int64), pair)


def load_map(height: float) -> np.ndarray:
    """Map from a wrench to the gripper's load (fz, t_y + h f_x, -t_x + h f_y), (3, 6)."""
    return np.array([[0, 0, 1, 0, 0, 0], [height, 0, 0, 0, 1, 0], [0, height, 0, -1, 0, 0]], dtype=float)


def likely_load(
    load: Float[np.ndarray, "K 3"],
    bias: Float[np.ndarray, "K 3"],
    noise: Float[np.ndarray, "K 3"],
    trial: Int[np.ndarray, "K"],
    accelerated: Bool[np.ndarray, "K"],
    nulled: Float[np.ndarray, "3"],
    pushed: Bool[np.ndarray, "K"],
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
    """Loads of K windows with the sensor's likely error taken off, and the parts of mean and change that were kept.

    Both a trial's mean load and its change from window to window are drawn towards zero by how much of their scatter
    the sensor explains (empirical Bayes): a gripper that carries less than the sensor can tell is better taken to carry
    nothing. Either has to stand out by two standard errors, or it is taken to scatter as a nulled gripper's.

    Args:
        load: measured loads, N and N m.
        bias: variance of the error that a trial's windows have in common.
        noise: variance of each window's own error.
        trial: trial that each window is from.
        accelerated: True for windows of an accelerated turn: an arm that swings carries loads of another size.
        nulled: mean load of a nulled gripper over a trial, one standard deviation.
        pushed: True for windows of a push: a fingertip's load is not nulled, and taken as measured.
    """
    likely, kept, followed = load.copy(), np.ones_like(load), np.ones_like(load)
    for rows, changes in ((accelerated, SWUNG), (~accelerated & ~pushed, TURNED)):
        if not rows.any():
            continue
        some = load[rows]
        trials, index = np.unique(trial[rows], return_inverse=True)
        mean, together = np.eye(len(trials))[index].T, np.bincount(index)
        mean = mean / together[:, None]
        common = mean @ some
        change, free = some - common[index], max(len(some) - len(trials), 1)
        explained = (mean @ bias[rows] + mean @ noise[rows] / together[:, None]).mean(axis=0)
        kept[rows] = _real_part((common**2).mean(axis=0), explained, len(trials), nulled)
        followed[rows] = _real_part((change**2).sum(axis=0) / free, noise[rows].mean(axis=0), free, changes)
        likely[rows] = kept[rows] * common[index] + followed[rows] * change
    return likely, kept, followed


def _real_part(scatter: np.ndarray, error: np.ndarray, count: int, least: np.ndarray) -> np.ndarray:
    """Part of a scatter over `count` values that is no error of the sensor: 1 where there is no error."""
    real = np.maximum(scatter - (1 + 2 * np.sqrt(2 / count)) * error, least**2)
    return np.where(error > 0, real / np.maximum(real + error, 1e-300), 1.0)
