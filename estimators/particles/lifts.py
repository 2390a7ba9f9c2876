"""Lifts: windows, and covariance of their errors. In the air the wrench is linear in the masses, without friction.

An object held still shows M and c; one that is rocked also shows the second moments about the TCP: six numbers of the
masses, where turns on the table show four.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float
from scipy.linalg import block_diag
from torch import Tensor

from estimators.wrench.air import columns
from estimators.wrench.sensor import walk
from testbed.objects.model import GRAVITY, ObjectShape
from testbed.sensing.lift_windows import LiftWindow, lift_windows
from testbed.sensing.windows import check_trials, reduced_trials
from testbed.trajectory import Trajectory


@dataclass(frozen=True)
class LiftErrors:
    """Standard deviations of quantities assumed known in a lift, drawn once a trial unless noted otherwise."""

    grip: float = 5e-4
    """Position of the object between the pads, along x and along y, m."""
    sag: float = 1e-3
    """Height of the TCP over the object's bottom, which lies on felt and sinks between the pads, m."""
    slip: float = 1e-3
    """Creep down between the pads from the first window to the last, a random walk, m."""
    creep: float = 4e-4
    """Creep along x and along y, likewise."""
    height: float = 0.25
    """Height of the center of mass, relative to the object's; the tilts determine it."""
    inertia: float = 0.005
    """Wrench of the acceleration, relative."""
    gain: float = 3e-4
    """All wrenches, relative."""
    wrench: float = 3e-4
    """Each window's wrench, relative to the weight, and to the weight at the particles' mean distance."""

    def sizes(self, height: float) -> dict[str, Tensor]:
        """Standard deviations of the unknowns of `Air` that all windows share; `height` is that of the height, m."""
        sizes = {"place": [self.grip, self.grip, height], "moving": self.inertia, "scale": self.gain}
        return {name: torch.tensor(size, dtype=torch.float64) for name, size in sizes.items()}


def lifts_among(shape: ObjectShape, trajectories: Sequence[Trajectory]) -> dict[int, list[LiftWindow]]:
    """Windows of every lift that ended well, by its index among the trajectories.

    Raises:
        InvalidValueError: a grasp that the shape does not have, no shape, something other than trajectories, or a
            record of too few samples a second.
    """
    check_trials(shape, trajectories)
    return reduced_trials(shape, trajectories, lambda action: action.in_air, lift_windows)


def upright_sizes(shape: ObjectShape, weight: float) -> Float[Tensor, "3"]:
    """Standard deviations of second moments with height, where partly filled cells leave the height of mass unknown.

    That of sum m z^2 is its value for full cells; those of sum m x z and sum m y z assume a correlation of one half
    between height and position.

    Args:
        shape: geometry.
        weight: M, kg.
    """
    reach = float(np.sqrt(np.square(shape.particles - shape.particles.mean(axis=0)).sum(axis=1).mean()))
    leaning = weight * reach * shape.height / (2 * 12**0.5)
    return torch.tensor([weight * shape.height**2 / 12, leaning, leaning], dtype=torch.float64)


def lift_covariance(
    shape: ObjectShape,
    windows: Sequence[LiftWindow],
    slopes: Mapping[str, Float[Tensor, "K 6 n"]],
    sizes: Mapping[str, Tensor],
    errors: LiftErrors,
    weight: float,
) -> Float[np.ndarray, "R R"]:
    """Covariance of all wrenches of one trial's K windows, R = 6 K.

    Args:
        shape: geometry.
        windows: windows of one trial.
        slopes: derivatives of the wrenches in every unknown, `place` among them.
        sizes: standard deviations of the errors that all windows share.
        errors: errors of each window, and of the creep in the grip.
        weight: M, kg.
    """
    common = columns(slopes, sizes).numpy()
    # the object creeps in the grip, a random walk from the first window to the last
    middle = np.array([w.since_tare.mean() for w in windows])
    gone = np.repeat((middle - middle[0]) / max(middle[-1] - middle[0], 1e-9), 6)
    steps = slopes["place"].flatten(0, 1).numpy() * [errors.creep, errors.creep, errors.slip]
    size = errors.wrench * GRAVITY * weight
    lever = np.linalg.norm(shape.particles - shape.grasps[windows[0].grasp].position, axis=1).mean()
    each = np.diag(np.tile(np.square([size] * 3 + [size * lever] * 3), len(windows)))
    creep = steps @ steps.T * np.minimum(gone[:, None], gone)
    return _sensor_covariance(windows) + common @ common.T + each + creep


def _sensor_covariance(windows: Sequence[LiftWindow]) -> Float[np.ndarray, "R R"]:
    """Covariance of all windows' wrenches by the sensor: noise of each, shared bias of the tare, walk of the zero."""
    count, walked = len(windows), walk(torch.tensor(np.array([w.since_tare for w in windows]))).numpy()
    covariance = np.kron(np.ones((count, count)), windows[0].bias_covariance)
    covariance += np.kron(walked, windows[0].drift_covariance)
    covariance += np.asarray(block_diag(*(window.covariance for window in windows)))
    return covariance
