"""Series over time: values between samples, and unbroken stretches of samples."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int


def interpolated(
    time: Float[np.ndarray, "N"], at: Float[np.ndarray, "T"], values: Float[np.ndarray, "T K"]
) -> Float[np.ndarray, "N K"]:
    """Columns of `values`, given at the times `at`, linearly interpolated at the times `time`; constant beyond."""
    return np.column_stack([np.interp(time, at, column) for column in values.T])


def unwrapped(poses: Float[np.ndarray, "T parts 3"]) -> Float[np.ndarray, "T parts 3"]:
    """Planar poses whose yaws do not jump by whole turns between measured samples, NaN at the others; read-only."""
    poses = poses.copy()
    for yaw in poses[..., 2].T:
        measured = ~np.isnan(yaw)
        yaw[measured] = np.unwrap(yaw[measured])
    poses.flags.writeable = False
    return poses


def runs(inside: Bool[np.ndarray, "T"]) -> list[Int[np.ndarray, "N"]]:
    """Indices of every unbroken stretch of True."""
    indices = np.flatnonzero(inside)
    return np.split(indices, np.flatnonzero(np.diff(indices) > 1) + 1) if len(indices) else []
