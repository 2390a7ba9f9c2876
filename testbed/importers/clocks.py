"""Delay of the wrench behind the pose where they come from separate streams, as accelerated turns show it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.interpolate import make_interp_spline
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import minimize_scalar
from scipy.spatial.transform import Rotation

from testbed.frames import rotation_2d
from testbed.importers.logs import LogError
from testbed.importers.phases import RATE

LONGEST_DELAY = 0.2
"""Largest delay either way that the search covers [s]."""
NO_DELAY = "not estimated, for want of an accelerated turn"
"""Provenance of separate streams whose delay is unknown."""
LARGEST_STD = 0.005
"""Standard deviation from which a delay is reported and not corrected [s]."""
MODEL_ERROR = 0.0015
"""Standard deviation of the error by the arm's lag, over turns of the library's objects; common to all turns [s]."""
_SMOOTHING = 0.045
"""Standard deviation of the kernel that smooths torque and motion [s]."""
_BLOCKS = 8
"""Number of parts of the jackknife."""
_TURNING = 0.12
"""Fraction of the largest turn rate above which the object turns."""
_END = 15
"""Samples at the ends of the motion that are left out: friction builds up there."""


class Delay(NamedTuple):
    """Time by which the stamps of the wrench are late."""

    seconds: float
    std: float
    """Standard deviation [s]; 0 if it is given."""

    @property
    def sure(self) -> bool:
        """True if the delay is known well enough to be corrected, and differs from zero beyond its error."""
        return self.std < LARGEST_STD and abs(self.seconds) > 2 * self.std

    def __str__(self) -> str:
        if not self.std:
            return f"{1e3 * self.seconds:.1f} ms late, as given; taken off"
        certain = "taken off" if self.sure else "not taken off"
        then = "too uncertain to be taken off" if self.std >= LARGEST_STD else certain
        return f"{1e3 * self.seconds:.1f} +- {1e3 * self.std:.1f} ms late, by accelerated turns; {then}"


def wrench_delay(
    torque: Float[np.ndarray, "T"], position: Float[np.ndarray, "T 3"], hand: Rotation, time: Float[np.ndarray, "T"]
) -> Delay:
    """Delay between the torque about the vertical and a turn that accelerates.

    The torque of any object is linear in angular and linear acceleration, speed and its square, and the center of the
    turn. That combination of the motion, shifted by the delay, is fitted to the torque's rate of change, in which jumps
    of the acceleration are large and slow changes of friction small. The standard deviation is that of a jackknife over
    parts of the turn.

    Args:
        torque: torque about the vertical [N m], as stamped.
        position: position of the TCP [m].
        hand: orientation of the hand, T of them.
        time: times at 100 Hz [s].

    Raises:
        LogError: less than 1 s of acceleration, or a delay beyond 0.2 s.
    """
    motion, rate = _regressors(position, hand)
    turning = np.flatnonzero(np.abs(rate) > _TURNING * np.abs(rate).max())
    inside = np.arange(turning[0] + _END, turning[-1] - _END) if len(turning) else turning
    inside = inside[(inside > LONGEST_DELAY * RATE) & (inside < len(time) - LONGEST_DELAY * RATE)]
    if len(inside) < RATE:
        raise LogError(f"delay: the turn accelerates for {len(inside) / RATE:.1f} s; allowed: 1 s or more")
    moved = make_interp_spline(time, motion, k=3)
    change = np.gradient(gaussian_filter1d(torque, _SMOOTHING * RATE), 1 / RATE)

    def fit(kept: np.ndarray) -> float:
        def misfit(delay: float) -> float:
            columns = np.column_stack([np.ones(len(kept)), moved(time[kept] - delay)])
            basis = np.linalg.qr(columns)[0]
            return float(np.square(change[kept] - basis @ (basis.T @ change[kept])).sum())

        grid = np.arange(-LONGEST_DELAY, LONGEST_DELAY + 1e-9, 1 / RATE)
        best = int(np.argmin([misfit(delay) for delay in grid]))
        if best in (0, len(grid) - 1):
            raise LogError(f"delay: the wrench is late or early by more than {LONGEST_DELAY:g} s; allowed: one clock")
        bounds = (grid[best - 1], grid[best + 1])
        found: Any = minimize_scalar(misfit, bounds=bounds, method="bounded", options={"xatol": 1e-6})
        return float(found.x)

    without = [fit(np.setdiff1d(inside, block)) for block in np.array_split(inside, _BLOCKS)]
    jackknife = (_BLOCKS - 1) * np.var(without)
    return Delay(fit(inside), float(np.sqrt(jackknife + MODEL_ERROR**2)))


def pooled_delay(delays: Sequence[Delay]) -> Delay | None:
    """Mean of the delays of several turns, weighted by the inverse variances of their own errors; None without any.

    The error of the model is common to all turns: it neither weights them nor averages out.

    Raises:
        LogError: delays that differ by more than five standard deviations: the clocks are not the same.
    """
    if not delays:
        return None
    weights = 1 / np.maximum([delay.std**2 - MODEL_ERROR**2 for delay in delays], 1e-12)
    mean = float(np.average([d.seconds for d in delays], weights=weights))
    if outliers := [d for d in delays if abs(d.seconds - mean) > 5 * d.std]:
        one, all_ = 1e3 * outliers[0].seconds, 1e3 * mean
        raise LogError(
            f"delay: {one:.1f} ms in one turn and {all_:.1f} ms in all; allowed: the same clocks in all logs"
        )
    return Delay(mean, float(np.sqrt(1 / weights.sum() + MODEL_ERROR**2)))


def _regressors(position: np.ndarray, hand: Rotation) -> tuple[np.ndarray, np.ndarray]:
    """Rates of change of the torque's regressors, shape (T, 7), and the turn rate [rad/s], shape (T,).

    Axes turn about the vertical with the hand, whichever way its own axes point.
    """

    def smooth(values: np.ndarray, order: int) -> np.ndarray:
        return gaussian_filter1d(values, _SMOOTHING * RATE, order=order, axis=0) * RATE**order

    turned = (hand * hand[len(hand) // 2].inv()).as_matrix()
    yaw = np.unwrap(np.arctan2(turned[:, 1, 0] - turned[:, 0, 1], turned[:, 0, 0] + turned[:, 1, 1]))
    rate, acceleration = smooth(yaw, 1), smooth(yaw, 2)
    into = rotation_2d(-yaw)
    velocity, linear = (np.einsum("nij,nj->ni", into, smooth(position, order)[:, :2]) for order in (1, 2))
    slow = np.where(np.abs(rate) < 0.05, 0.05, rate)[:, None]
    columns = np.column_stack([acceleration, rate, rate**2, linear, velocity / slow])
    return np.asarray(np.gradient(columns, 1 / RATE, axis=0)), rate
