"""What the gripper is likely to carry, of what the sensor says that it carries."""

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
    """What the gripper carries, from the measured wrench: K windows."""

    lift: Float[Tensor, "K"]
    """Vertical force of the gripper on the object, fz, N."""
    moment: Float[Tensor, "K 2"]
    """What the feet must supply beyond the object's own weight: (sum x N, sum y N) about the grasp point, N m."""
    held: Int[Tensor, "K"]
    """Mass group between the fingers."""
    point: Float[Tensor, "K 2"]
    """Grasp point, m, object frame."""

    @property
    def carried(self) -> Float[Tensor, "K 3"]:
        """Lift and moment, N and N m."""
        return torch.cat([self.lift[:, None], self.moment], -1)

    @staticmethod
    def none(count: int) -> GripperLoad:
        """A gripper that carries nothing, for `count` windows."""
        zeros = torch.zeros
        return GripperLoad(
            zeros(count, dtype=torch.float64),
            zeros(count, 2, dtype=torch.float64),
            zeros(count, dtype=torch.int64),
            zeros(count, 2, dtype=torch.float64),
        )


def load_map(height: float) -> np.ndarray:
    """From a wrench to the gripper's load (fz, t_y + h f_x, -t_x + h f_y), (3, 6)."""
    return np.array([[0, 0, 1, 0, 0, 0], [height, 0, 0, 0, 1, 0], [0, height, 0, -1, 0, 0]], dtype=float)


def likely_load(
    load: Float[np.ndarray, "K 3"],
    bias: Float[np.ndarray, "K 3"],
    noise: Float[np.ndarray, "K 3"],
    trial: Int[np.ndarray, "K"],
    accelerated: Bool[np.ndarray, "K"],
    nulled: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"], Float[np.ndarray, "K 3"]]:
    """Loads of K windows with what is likely the sensor's error taken off, and the parts of mean and change kept.

    Args:
        load: as felt, N and N m.
        bias: variance of what a trial's windows err by in common.
        noise: variance of each window's own error.
        trial: which trial a window is from.
        accelerated: whether it is from an accelerated turn: an arm that swings carries loads of another size.
        nulled: what a nulled gripper carries on average over a trial, one standard deviation.
    """
    likely, kept, followed = load.copy(), np.ones_like(load), np.ones_like(load)
    for rows, changes in ((accelerated, SWUNG), (~accelerated, TURNED)):
        if rows.any():
            likely[rows], kept[rows], followed[rows] = _shrunk(
                load[rows], bias[rows], noise[rows], trial[rows], nulled, changes
            )
    return likely, kept, followed


def _shrunk(
    load: np.ndarray,
    bias: np.ndarray,
    noise: np.ndarray,
    trial: np.ndarray,
    mean_least: np.ndarray,
    change_least: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Loads with what is likely the sensor's error taken off, and the parts of mean and change that were kept.

    Both a trial's mean load and its change from window to window are drawn towards zero by how much of their scatter
    the sensor explains (empirical Bayes): a gripper that carries less than the sensor can tell is better taken to carry
    nothing. Either has to stand out by two standard errors, or it is taken to scatter as a nulled gripper's: least,
    one standard deviation.
    """
    trials, index = np.unique(trial, return_inverse=True)
    mean, together = np.eye(len(trials))[index].T, np.bincount(index)
    mean = mean / together[:, None]
    common = mean @ load
    change, free = load - common[index], max(len(load) - len(trials), 1)
    blurred, explained = noise.mean(axis=0), (mean @ bias + mean @ noise / together[:, None]).mean(axis=0)
    kept = _part((common**2).mean(axis=0), explained, len(trials), mean_least)
    followed = _part((change**2).sum(axis=0) / free, blurred, free, change_least)
    shape = load.shape
    return (
        kept * common[index] + followed * change,
        np.broadcast_to(kept, shape).copy(),
        np.broadcast_to(followed, shape).copy(),
    )


def _part(scatter: np.ndarray, error: np.ndarray, count: int, least: np.ndarray) -> np.ndarray:
    """Of what was felt `count` times, how much is real: 1 where there is no error."""
    real = np.maximum(scatter - (1 + 2 * np.sqrt(2 / count)) * error, least**2)
    return np.where(error > 0, real / np.maximum(real + error, 1e-300), 1.0)
